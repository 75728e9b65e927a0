"""A mesh cut along the border of a part of space, and opened there.

::

    clip_mesh ──> faces beyond a side of its box are left out ──> Area.cut ──> columns are carried
                     box: six planes, one after the other; ball: its sphere    (here)
                     prism: split along its walls, by sides                    (`splitting`)
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, ByteArray, FloatArray, IntArray
from hpccomponent.dataclass import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class CutPiece:
    """A mesh that is being cut; vertices (v, 3) may be in no face of the faces (f, 3).

    Each vertex has for its source, (v,), the one of the whole mesh that it is, or that is nearest
    on the same face.
    """

    vertices: FloatArray
    faces: IntArray
    sources: IntArray


class Cutter(Protocol):
    """A part of space that cuts meshes: box, ball or prism, in their frame."""

    @property
    def low(self) -> FloatArray:
        """The least coordinates, shape (3,)."""
        ...

    @property
    def high(self) -> FloatArray:
        """The greatest, likewise."""
        ...

    def cut(self, piece: CutPiece) -> CutPiece:
        """Return what of a mesh lies in it."""
        ...


def find_beyond(positions: FloatArray, region: Cutter) -> ByteArray:
    """Tell beyond which sides of the box around a region points lie: a bit each, shape (n,).

    A face whose corners are all beyond the same one has nothing within.
    """
    beyond: ByteArray = np.zeros(len(positions), np.uint8)
    for axis, column in enumerate(positions.T):
        beyond |= (column < region.low[axis]).astype(np.uint8) << (2 * axis)
        beyond |= (column > region.high[axis]).astype(np.uint8) << (2 * axis + 1)
    return beyond


def clip_mesh(mesh: Mesh, region: Cutter) -> Mesh:
    """Cut a mesh so that it ends on the border of a region in its local frame, z in the unit of x.

    Vertices that a face has stay in their order, then come those on the border, with the columns of
    the nearest vertex on the same face. Faces keep their sides.
    """
    beyond = find_beyond(mesh.vertices, region)
    is_near = np.bitwise_and.reduce(beyond[mesh.faces], axis=1) == 0
    near = CutPiece(mesh.vertices, mesh.faces[is_near], np.arange(len(mesh.vertices)))
    piece = region.cut(near)
    used, corners = np.unique(piece.faces, return_inverse=True)
    sources = piece.sources[used]
    return replace(
        mesh,
        vertices=piece.vertices[used],
        faces=corners.reshape(-1, 3),
        normals=None if mesh.normals is None else mesh.normals[sources],
        colours=None if mesh.colours is None else mesh.colours[sources],
        attributes={name: column[sources] for name, column in mesh.attributes.items()},
    )


def clip_box(piece: CutPiece, low: FloatArray, high: FloatArray) -> CutPiece:
    """Return what of a mesh lies between two corners."""
    for axis in range(3):
        for sign, bound in ((-1.0, low[axis]), (1.0, high[axis])):
            level = sign * (piece.vertices[:, axis] - bound)
            piece = _clip(piece, level, _Plane(axis, float(bound)))
    return piece


def clip_ball(piece: CutPiece, centre: FloatArray, radius: float) -> CutPiece:
    """Return what of a mesh lies within a distance of a place."""
    level = np.linalg.norm(piece.vertices - centre, axis=1) - radius
    return _clip(piece, level, _Sphere(centre, radius))


class _Plane:
    """A side of a box."""

    def __init__(self, axis: int, bound: float) -> None:
        self._axis, self._bound = axis, bound

    def cross(self, inside: FloatArray, outside: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where edges, shape (n, 3) each end, go through, and the share that is inside."""
        start, end = inside[:, self._axis], outside[:, self._axis]
        share = (self._bound - start) / (end - start)
        places: FloatArray = inside + share[:, None] * (outside - inside)
        places[:, self._axis] = self._bound  # not a rounding beside it
        return places, share


class _Sphere:
    """The border of a ball."""

    def __init__(self, centre: FloatArray, radius: float) -> None:
        self._centre, self._radius = centre, radius

    def cross(self, inside: FloatArray, outside: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where edges, shape (n, 3) each end, go through, and the share that is inside."""
        arms, along = inside - self._centre, outside - inside
        # |arm + t along| = r: of the two solutions, the one along the edge.
        a = np.einsum("ij,ij->i", along, along)
        b = np.einsum("ij,ij->i", arms, along)
        c = np.einsum("ij,ij->i", arms, arms) - self._radius**2  # at most 0
        share = np.clip((np.sqrt(np.maximum(b * b - a * c, 0.0)) - b) / a, 0.0, 1.0)
        places: FloatArray = inside + share[:, None] * along
        return places, share


def _clip(piece: CutPiece, level: FloatArray, border: _Plane | _Sphere) -> CutPiece:
    """Leave out what has a positive level; the vertices of what is left out stay."""
    vertices, faces, outside = piece.vertices, piece.faces, level > 0.0
    count = outside[faces].sum(axis=1)
    kept = faces[count == 0]
    if len(kept) == len(faces):
        return piece
    # Corners are turned, not mirrored, so that the first is the one unlike the others.
    one_in = _turn(faces[count == 2], ~outside)
    one_out = _turn(faces[count == 1], outside)
    # Each edge that crosses, from inside to outside: shape (e, 2).
    edges = np.concatenate(
        [one_in[:, [0, 1]], one_in[:, [0, 2]], one_out[:, [1, 0]], one_out[:, [2, 0]]]
    )
    distinct, which = np.unique(edges, axis=0, return_inverse=True)
    places, shares = border.cross(vertices[distinct[:, 0]], vertices[distinct[:, 1]])
    nearest = np.where(shares < 0.5, distinct[:, 0], distinct[:, 1])
    # A vertex on the border is the crossing of its edges.
    names = np.where(
        level[distinct[:, 0]] == 0.0, distinct[:, 0], len(vertices) + np.arange(len(distinct))
    )
    first, second, third, fourth = np.split(
        names[which.reshape(-1)], np.cumsum([len(one_in), len(one_in), len(one_out)])
    )
    cut = np.concatenate(
        [
            kept,
            np.stack([one_in[:, 0], first, second], axis=1),
            np.stack([third, one_out[:, 1], one_out[:, 2]], axis=1),
            np.stack([third, one_out[:, 2], fourth], axis=1),
        ]
    )
    is_face = (cut != np.roll(cut, 1, axis=1)).all(axis=1)
    return CutPiece(
        np.concatenate([vertices, places]),
        cut[is_face],
        np.concatenate([piece.sources, piece.sources[nearest]]),
    )


def _turn(faces: IntArray, is_first: BoolArray) -> IntArray:
    """Turn faces, with one corner each of which it is true, so that this is the first."""
    first = np.argmax(is_first[faces], axis=1)[:, None]
    turned: IntArray = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    return turned
