"""Photographs on the texels of a mesh, one photograph at a time."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from math import isqrt

import numpy as np
from scipy.spatial import cKDTree

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, ByteArray, FloatArray
from hpcapp.texture.photos.best import BestLooks
from hpcapp.texture.photos.picture import Picture, read_picture
from hpcapp.texture.photos.view import View
from hpcapp.texture.request import Photo
from hpcapp.texture.texels import cover
from hpccomponent.dataclass import dataclass

log = logging.getLogger("hpcapp")

FindColours = Callable[[FloatArray], ByteArray]
"""Returns the colours of places on the mesh, shape (n, 3)."""

_MOST = 200_000
"""Texels that lend others their colours: one of 80 where 4,096 x 4,096 are filled."""


@dataclass(frozen=True, slots=True, eq=False)
class Painted:
    """What photographs show of a mesh.

    Parameters
    ----------
    colours : ndarray of uint8, shape (t, 3)
        Of the texels, row by row; black where no photograph sees them.
    is_seen : ndarray of bool, shape (t,)
    photos : int
        How many were read.
    """

    colours: ByteArray
    is_seen: BoolArray
    photos: int

    def find_nearest(self, mesh: Mesh, places: FloatArray) -> FindColours:
        """Return what gives places on the mesh the colours of texels near them that are seen."""
        pixels = isqrt(len(self.is_seen))
        step = max(1, int(self.is_seen.sum()) // _MOST)
        lenders, colours = [np.empty((0, 3))], [np.empty((0, 3), np.uint8)]
        for texels in cover(places, mesh.faces, pixels):
            rows = np.flatnonzero(self.is_seen[texels.cells])[::step]
            lenders.append(texels.blend(mesh.vertices, mesh.faces)[rows])
            colours.append(self.colours[texels.cells[rows]])
        tree, found = cKDTree(np.concatenate(lenders)), np.concatenate(colours)
        if not tree.n:
            return lambda others: np.zeros((len(others), 3), np.uint8)
        return lambda others: found[tree.query(others)[1]]


def paint(
    mesh: Mesh,
    places: FloatArray,
    pixels: int,
    photos: Sequence[Photo],
    advance: Callable[[int], object],
) -> Painted:
    """Return the colours of the texels of a mesh with normals.

    Its vertices lie at `places`, shape (v, 2), right and down, 0 to 1, in a picture of so many
    pixels a side. `advance` is told how many photographs are done.
    """
    looks = BestLooks(pixels * pixels, len(photos))
    texel = _measure_texel(mesh, places, pixels)
    read = 0
    for number, photo in enumerate(photos):
        advance(number)
        try:
            picture = Picture(read_picture(photo.path))
        except (OSError, SyntaxError) as error:  # the latter: of a PNG
            log.warning("warning: %s: cannot be read, and is left out: %s", photo.path, error)
            continue
        read += 1
        view = View(mesh, photo.camera, photo.lens)
        for texels in cover(places, mesh.faces[view.faces], pixels):
            found = view.look(texels)
            colours = picture.find(found.pixels, np.sqrt(found.density) * texel)
            looks.add(number, texels.cells[found.rows], found.scores, colours)
    colours, scores = looks.blend()
    return Painted(colours, scores > 0.0, read)


def _measure_texel(mesh: Mesh, places: FloatArray, pixels: int) -> float:
    """Return the side of a texel: charts have one scale."""
    corners, flat = mesh.vertices[mesh.faces], places[mesh.faces] * pixels
    edges = np.linalg.norm(np.diff(corners, axis=1), axis=2).sum()
    return float(edges / max(np.linalg.norm(np.diff(flat, axis=1), axis=2).sum(), 1e-30))
