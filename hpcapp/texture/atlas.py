"""A mesh cut into charts that lie side by side in a square."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.faces import cross_edges
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray
from hpccomponent.dataclass import dataclass

_GAP = 4
"""Texels between charts: what is seen from so far away that four texels are one pixel still
takes none of the neighbour's."""


@dataclass(frozen=True, slots=True, eq=False)
class Atlas:
    """Where a mesh lies in a square.

    Parameters
    ----------
    sources : ndarray of int64, shape (w,)
        The vertex of the mesh that each vertex of the atlas is.
    faces : ndarray of int64, shape (f, 3)
        Those of the mesh, in their order, by the vertices of the atlas.
    places : ndarray of float64, shape (w, 2)
        Right and down, 0 to 1.
    charts : int
    """

    sources: IntArray
    faces: IntArray
    places: FloatArray
    charts: int


def unwrap(mesh: Mesh, pixels: int) -> Atlas:
    """Cut a mesh into charts, and pack them into so many pixels a side."""
    import xatlas

    atlas = xatlas.Atlas()
    atlas.add_mesh(_scale(mesh), mesh.faces.astype(np.uint32))
    packing = xatlas.PackOptions()
    packing.resolution, packing.padding, packing.bilinear = pixels, _GAP, True
    atlas.generate(xatlas.ChartOptions(), packing)
    sources, faces, places = atlas[0]
    # The square that it has filled may be a little larger than asked for, and no square.
    sides = np.array([atlas.width, atlas.height], np.float64)
    return Atlas(
        sources.astype(np.int64),
        faces.astype(np.int64).reshape(-1, 3),
        places * (sides / sides.max()),
        atlas.chart_count,
    )


def _scale(mesh: Mesh) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    """Return the vertices in single precision, in the root of the mean area of a face.

    The limits below which xatlas takes a triangle for none are lengths.
    """
    cross = cross_edges(mesh.vertices[mesh.faces])
    unit = np.sqrt(np.sqrt((cross * cross).sum(axis=1)).mean()) or 1.0
    middle = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
    scaled: np.ndarray[tuple[int, int], np.dtype[np.float32]]
    scaled = ((mesh.vertices - middle) / unit).astype(np.float32)
    return scaled
