"""A mesh cut along the border of a region, and opened there.

::

    faces beyond a side of its box are left out ──> six planes, then the sphere, each cuts the rest
"""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import ByteArray, FloatArray, IntArray
from hpcapp.geometry.region import Region


def find_beyond(positions: FloatArray, region: Region) -> ByteArray:
    """Tell beyond which sides of a region's box points lie: a bit each, shape (n,).

    A face whose corners are all beyond the same one has nothing within.
    """
    beyond: ByteArray = np.zeros(len(positions), np.uint8)
    for axis, column in enumerate(positions.T):
        beyond |= (column < region.low[axis]).astype(np.uint8) << (2 * axis)
        beyond |= (column > region.high[axis]).astype(np.uint8) << (2 * axis + 1)
    return beyond


def clip_mesh(vertices: FloatArray, faces: IntArray, region: Region) -> tuple[FloatArray, IntArray]:
    """Cut a mesh so that it ends on the border of a region.

    Parameters
    ----------
    vertices : ndarray of float64, shape (v, 3)
    faces : ndarray of int64, shape (f, 3)
    region : Region
        In the frame of the vertices, with z in the unit of x and y.

    Returns
    -------
    vertices : ndarray of float64, shape (w, 3)
        Those that a face has: old ones in their order, then those on the border.
    faces : ndarray of int64, shape (g, 3)
        With the sides that they had.
    """
    if region.radius < np.inf:
        vertices, faces = _clip(vertices, faces, region.beyond(vertices), _Sphere(region))
    else:
        for axis in range(3):
            for sign, bound in ((-1.0, region.low[axis]), (1.0, region.high[axis])):
                level = sign * (vertices[:, axis] - bound)
                vertices, faces = _clip(vertices, faces, level, _Plane(axis, float(bound)))
    used, corners = np.unique(faces, return_inverse=True)
    return vertices[used], corners.reshape(-1, 3)


class _Plane:
    """A side of a box."""

    def __init__(self, axis: int, bound: float) -> None:
        self._axis, self._bound = axis, bound

    def cross(self, inside: FloatArray, outside: FloatArray) -> FloatArray:
        """Return where edges, shape (n, 3) each end, go through."""
        start, end = inside[:, self._axis], outside[:, self._axis]
        share = ((self._bound - start) / (end - start))[:, None]
        places: FloatArray = inside + share * (outside - inside)
        places[:, self._axis] = self._bound  # not a rounding beside it
        return places


class _Sphere:
    """The border of a ball."""

    def __init__(self, region: Region) -> None:
        self._region = region

    def cross(self, inside: FloatArray, outside: FloatArray) -> FloatArray:
        """Return where edges, shape (n, 3) each end, go through."""
        arms, along = inside - self._region.centre, outside - inside
        # |arm + t along| = r: of the two solutions, the one along the edge.
        a = np.einsum("ij,ij->i", along, along)
        b = np.einsum("ij,ij->i", arms, along)
        c = np.einsum("ij,ij->i", arms, arms) - self._region.radius**2  # at most 0
        share = np.clip((np.sqrt(np.maximum(b * b - a * c, 0.0)) - b) / a, 0.0, 1.0)
        places: FloatArray = inside + share[:, None] * along
        return places


def _clip(
    vertices: FloatArray, faces: IntArray, level: FloatArray, border: _Plane | _Sphere
) -> tuple[FloatArray, IntArray]:
    """Leave out what has a positive level; the vertices of what is left out stay."""
    outside = level > 0.0
    count = outside[faces].sum(axis=1)
    kept = faces[count == 0]
    if len(kept) == len(faces):
        return vertices, faces
    # Corners are turned, not mirrored, so that the first is the one unlike the others.
    one_in = _turn(faces[count == 2], ~outside)
    one_out = _turn(faces[count == 1], outside)
    # Each edge that crosses, from inside to outside: shape (e, 2).
    edges = np.concatenate(
        [one_in[:, [0, 1]], one_in[:, [0, 2]], one_out[:, [1, 0]], one_out[:, [2, 0]]]
    )
    distinct, which = np.unique(edges, axis=0, return_inverse=True)
    places = border.cross(vertices[distinct[:, 0]], vertices[distinct[:, 1]])
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
    return np.concatenate([vertices, places]), cut[is_face]


def _turn(faces: IntArray, is_first: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> IntArray:
    """Turn faces, with one corner each of which it is true, so that this is the first."""
    first = np.argmax(is_first[faces], axis=1)[:, None]
    turned: IntArray = np.take_along_axis(faces, (first + np.arange(3)) % 3, axis=1)
    return turned
