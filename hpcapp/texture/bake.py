"""The colours and normals of a fine surface in the texels of a light mesh.

::

    light mesh ─> atlas ─> texels ─> places on the mesh ─┬─> photographs of them ─> colours
                                                         ├─> points near them ─> the others
                                                         └─> fine vertices near them ─> normals

Some texels at a time: memory is that of the pictures, and of the fine vertices, of which no more
are taken than there are texels.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from math import ceil

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from hpcapp.geometry.faces import cross_edges
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, ByteArray, FloatArray
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream
from hpcapp.io.meshes.texture import Texture
from hpcapp.texture.atlas import Atlas, unwrap
from hpcapp.texture.photos.painting import FindColours, Painted, paint
from hpcapp.texture.request import Photo
from hpcapp.texture.tangents import find_tangents, normalise
from hpcapp.texture.texels import cover
from hpcapp.wording import say_count, say_number, say_share
from hpccomponent.dataclass import dataclass

_NEAR = 5
"""Fine vertices around a place, of which the farthest weighs nothing: more blur, fewer show the
triangles."""
_DETAIL = 1.0 / 3.0
"""Of the spacing of the points: what lies closer together shows nothing more, as colours are means
of eight points and normals of five vertices."""
_FILLED = 0.5
"""Least share of a picture that charts fill: real scans have 0.52 and more."""
_MOST_STEP = 4  # texels: the gap between charts
_STEEPEST = 0.1  # cosine between the two surfaces: a map holds no normals that look inwards


@dataclass(frozen=True, slots=True, eq=False)
class Baked:
    """A mesh with its texture, and how well it fills it.

    Parameters
    ----------
    mesh : MeshStream
        Vertices on the rims of charts are there more than once.
    charts : int
    filled : float
        Share of the texels that lie on the mesh, 0 to 1.
    texel : float
        Side of one, in length units of the mesh.
    photos : int
        Photographs that were looked at.
    seen : float
        Share of the texels on the mesh that they show, 0 to 1.
    """

    mesh: MeshStream
    charts: int
    filled: float
    texel: float
    photos: int = 0
    seen: float = 0.0

    @property
    def pixels(self) -> int:
        """Along a side of the pictures."""
        assert self.mesh.texture is not None  # noqa: S101 - it was baked
        return len(self.mesh.texture.normals)

    def describe(self, spacing: float | None = None) -> str:
        """Say how large a texel is, beside the spacing of the points where it is known."""
        charts = say_count(self.charts, "chart")
        beside = "" if spacing is None else f"; points are {say_number(spacing)} apart"
        return (
            f"texture: {charts} on {say_share(self.filled)} of {self.pixels:,} x {self.pixels:,} "
            f"texels, each {say_number(self.texel)} wide{beside}"
        )

    def describe_photos(self, others: str | None) -> str:
        """Say what photographs have shown, and whose colours the rest has; None of the nearest."""
        count, share = say_count(self.photos, "photograph"), say_share(self.seen)
        rest = "the nearest colours" if others is None else f"the colours of the {others}"
        return f"texture: {share} of it is seen in {count}; the rest takes {rest}"

    def to_json(self) -> dict[str, float]:
        """Return what the report says of it."""
        sizes = {"filled": self.filled, "texel": self.texel}
        shown = {"photographs": self.photos, "seen": self.seen} if self.photos else {}
        return {"pixels": self.pixels, "charts": self.charts, **sizes, **shown}


class FineNormals:
    """The normals of a fine surface that has some, as a function of the place.

    So many of its vertices are kept in memory, with some 100 bytes each; the values do not depend
    on the threads.
    """

    def __init__(self, fine: MeshStream, most: int, threads: int) -> None:
        places, normals = [np.empty((0, 3))], [np.empty((0, 3))]
        step, start = ceil(fine.vertex_count / most), 0
        for block in fine.vertices():
            some = slice(-start % step, None, step)
            if block.normals is not None:
                places.append(block.positions[some].copy())
                normals.append(block.normals[some].copy())
            start += len(block)
        self._normals = np.concatenate(normals)
        self._threads = threads
        self._tree = cKDTree(np.concatenate(places), compact_nodes=False, balanced_tree=False)

    def find(self, places: FloatArray, around: FloatArray) -> FloatArray:
        """Return unit normals at places, shape (n, 3).

        Those of the light surface there tell sides: fine vertices that look away from them are of
        another one.
        """
        most = min(_NEAR, self._tree.n)
        far, near = self._tree.query(places, np.arange(1, most + 1), workers=self._threads)
        last = far[:, -1:]
        shares = 1.0 - np.divide(far, last, out=np.zeros_like(far), where=last > 0.0)
        total = 1e-9 * around
        for neighbour, rows in enumerate(near.T):
            normals = self._normals[rows]
            facing = np.maximum((normals * around).sum(axis=1), 0.0)
            total += (shares[:, neighbour] * facing)[:, None] * normals
        return normalise(total)


def bake(
    light: Mesh,
    find_normals: FineNormals,
    find_colours: FindColours | None,
    pixels: int,
    photos: Sequence[Photo] = (),
    spacing: float | None = None,
    advance: Callable[[int, int], object] = lambda *_: None,
) -> Baked:
    """Give a light mesh with normals a texture of so many pixels a side.

    Its colours are those of the photographs, and where these show nothing those that are found; it
    has none where there are neither. What is found is so far apart as points of a `spacing` tell
    it. `advance` is told how much is done, and how much there is.
    """
    atlas = unwrap(light, pixels)
    mesh = _split(light, atlas)
    faces, area = len(mesh.faces), _measure_area(mesh)
    work = faces * (1 + len(photos))
    painted = None
    if photos:
        painted = paint(mesh, atlas.places, pixels, photos, lambda n: advance(n * faces, work))
        find_colours = find_colours or painted.find_nearest(mesh, atlas.places)
    step = choose_step(np.sqrt(area) / pixels, pixels, spacing)
    tangents, pictures, filled = _find(
        mesh, atlas, pixels // step, find_normals, find_colours,
        None if painted is None else _find_unseen(painted.is_seen, pixels, step),
        lambda n: advance(work - faces + n, work),
    )  # fmt: skip
    normals, *colours = (_enlarge(picture, step) for picture in pictures)
    if painted is not None:
        colours = [_overlay(painted, colours[0], mesh, atlas)]
    texture = Texture(
        atlas.places, tangents, colours[0] if colours else None, normals, atlas.sources
    )
    textured = replace(as_stream(mesh), texture=texture)
    texel = float(np.sqrt(area / max(filled, 1e-9))) / pixels
    if painted is None:
        return Baked(textured, atlas.charts, filled, texel)
    seen = min(1.0, float(painted.is_seen.mean()) / max(filled, 1e-9))
    return Baked(textured, atlas.charts, filled, texel, painted.photos, seen)


def choose_step(least: float, pixels: int, spacing: float | None) -> int:
    """Return how many texels along each side share what points and fine vertices tell.

    A texel is so large at least: as where the picture is filled.
    """
    step = 1
    while (
        spacing is not None
        and 2 * step <= _MOST_STEP
        and pixels % (2 * step) == 0
        and 2 * step * least / np.sqrt(_FILLED) <= _DETAIL * spacing
    ):
        step *= 2
    return step


def _find_unseen(is_seen: BoolArray, pixels: int, step: int) -> BoolArray:
    """Tell which texels of a picture that is smaller by the step hold one that nobody sees."""
    side = pixels // step
    unseen: BoolArray = ~is_seen.reshape(side, step, side, step).all(axis=(1, 3)).ravel()
    return unseen


def _find(
    mesh: Mesh,
    atlas: Atlas,
    side: int,
    find_normals: FineNormals,
    find_colours: FindColours | None,
    is_wanted: BoolArray | None,
    advance: Callable[[int], object],
) -> tuple[FloatArray, list[ByteArray], float]:
    """Return tangents, the pictures of normals and colours, and which share of these is filled.

    They have a side of so many texels, of which colours are found where they are wanted.
    """
    assert mesh.normals is not None  # noqa: S101 - it is asked for
    tangents = find_tangents(mesh.vertices, mesh.faces, mesh.normals, atlas.places)
    pictures = [np.zeros((side * side, 3), np.uint8) for _ in range(1 + (find_colours is not None))]
    is_empty = np.ones(side * side, np.bool_)
    for texels in cover(atlas.places, atlas.faces, side):
        places = texels.blend(mesh.vertices, mesh.faces)
        around = normalise(texels.blend(mesh.normals, mesh.faces))
        right = texels.blend(tangents, mesh.faces)
        pictures[0][texels.cells] = _encode(find_normals.find(places, around), right, around)
        if find_colours is not None:
            rows = slice(None) if is_wanted is None else np.flatnonzero(is_wanted[texels.cells])
            pictures[1][texels.cells[rows]] = find_colours(places[rows])
        is_empty[texels.cells] = False
        advance(int(texels.faces[-1]) + 1)
    _fill(pictures, is_empty.reshape(side, side))
    return tangents, [p.reshape(side, side, 3) for p in pictures], 1.0 - float(is_empty.mean())


def _enlarge(picture: ByteArray, step: int) -> ByteArray:
    """Return a picture larger by a step, with blends between its texels."""
    if step == 1:
        return picture
    from PIL import Image

    side = step * len(picture)
    resized = Image.fromarray(picture).resize((side, side), Image.Resampling.BILINEAR)
    return np.asarray(resized)


def _overlay(painted: Painted, others: ByteArray, mesh: Mesh, atlas: Atlas) -> ByteArray:
    """Return what photographs show, on a picture (p, p, 3) of what the other texels have."""
    colours = np.where(painted.is_seen[:, None], painted.colours, others.reshape(-1, 3))
    is_empty = np.ones(len(colours), np.bool_)
    for texels in cover(atlas.places, mesh.faces, len(others)):
        is_empty[texels.cells] = False
    _fill([colours], is_empty.reshape(others.shape[:2]))
    return colours.reshape(others.shape)


def _split(mesh: Mesh, atlas: Atlas) -> Mesh:
    """Return a mesh with the vertices of an atlas."""
    normals = None if mesh.normals is None else mesh.normals[atlas.sources]
    return Mesh(mesh.vertices[atlas.sources], atlas.faces, mesh.origin, normals)


def _measure_area(mesh: Mesh) -> float:
    cross = cross_edges(mesh.vertices[mesh.faces])
    return float(0.5 * np.sqrt((cross * cross).sum(axis=1)).sum())


def _encode(normals: FloatArray, right: FloatArray, around: FloatArray) -> ByteArray:
    """Return normals in the frames of texels, as a viewer makes these: of what it interpolates.

    That are the tangents (n, 4) to the right, and the normals (n, 3) of length one.
    """
    tangents = normalise(right[:, :3])
    up = normalise(np.cross(around, tangents) * np.sign(right[:, 3:]))
    # Tangent and normal are not quite upright on each other: what each has of the other is solved.
    common = (tangents * around).sum(axis=1)
    along, out = (normals * tangents).sum(axis=1), (normals * around).sum(axis=1)
    squared = np.maximum(1.0 - common * common, 1e-6)
    local = np.stack([
        (along - common * out) / squared,
        (normals * up).sum(axis=1),
        np.maximum((out - common * along) / squared, _STEEPEST),
    ], axis=1)  # fmt: skip
    return np.rint(127.5 * (normalise(local) + 1.0)).astype(np.uint8)


def _fill(pictures: list[ByteArray], is_empty: BoolArray) -> None:
    """Give texels beside the charts what the nearest one in a chart has."""
    nearest = ndimage.distance_transform_edt(is_empty, return_distances=False, return_indices=True)
    width = is_empty.shape[1]
    for first in range(0, len(is_empty), 256):
        rows = slice(first, first + 256)
        sources = nearest[0, rows].astype(np.int64) * width + nearest[1, rows]
        for picture in pictures:
            picture.reshape(*is_empty.shape, 3)[rows] = picture[sources]
