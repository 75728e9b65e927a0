"""A mesh split where it is cut: along vertical walls, and finely along a sphere.

Each face lies on one side of the walls then. Seen from above, these are segments, which meet at
their ends only::

    corners within a face split it in three ──> corners on an edge split it ──> segments split the
    edges that they cross, one segment of a face at a time

All is decided by edge, so that both faces of an edge get the same vertex, and vertical faces need
no rule of their own.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.geometry.regions.clipping import CutPiece

_SAME = 1e-9
"""What is nearer, in the largest coordinate, is one place: rounding is some 1e-16 of that."""

_STEP = 1 / 16
"""Of a radius, the longest edge across a sphere: a chord of it is 1/2000 of the radius inside."""

_Events = tuple[IntArray, IntArray, FloatArray]
"""Which edges are split, by which wall or corner, and at which share of their length."""


def refine_at_sphere(piece: CutPiece, centre: FloatArray, radius: float) -> CutPiece:
    """Halve the long edges of the faces that a sphere goes through: some have no end within."""

    def find(ends: FloatArray, same: float) -> _Events:
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        gaps = np.abs(np.linalg.norm(ends.mean(axis=1) - centre, axis=1) - radius)
        # All of a face is nearer to the middle of its longest edge than that is long.
        edges = np.flatnonzero((lengths > same) & (gaps <= lengths))
        return edges, np.argsort(np.argsort(-lengths[edges])), np.full(len(edges), 0.5)

    while (split := _split_edges(piece, find, _STEP * radius)) is not None:
        piece = split
    return piece


class Walls:
    """Vertical walls: segments (s, 2, 2) seen from above, in the frame of the mesh."""

    def __init__(self, segments: FloatArray, shapely: Any) -> None:
        self._segments, self._shapely = segments, shapely
        self._tree = shapely.STRtree(shapely.linestrings(segments))
        self._corners = np.unique(segments.reshape(-1, 2), axis=0)
        self._corner_tree = shapely.STRtree(shapely.points(self._corners))

    def split(self, piece: CutPiece) -> CutPiece:
        """Split the faces that walls go through; they come last."""
        same = _SAME * max(np.abs(self._segments).max(), np.abs(piece.vertices).max(initial=0.0))
        boxes = self._box(piece.vertices[piece.faces], 2.0 * same)
        is_near = np.zeros(len(piece.faces), np.bool_)
        is_near[self._tree.query(boxes, predicate="intersects")[0]] = True
        used, corners = np.unique(piece.faces[is_near], return_inverse=True)
        near = CutPiece(piece.vertices[used], corners.reshape(-1, 3), used)
        for _ in self._corners:
            if (split := self._split_faces(near, same)) is None:
                break
            near = split
        for find, rounds in ((self._find_corners, self._corners), (self._cross, self._segments)):
            for _ in range(len(rounds) + 1):
                if (split := _split_edges(near, find, same)) is None:
                    break
                near = split
        names = np.concatenate(
            [used, len(piece.vertices) + np.arange(len(near.vertices) - len(used))]
        )
        faces = np.concatenate([piece.faces[~is_near], names[near.faces]])
        return CutPiece(
            np.concatenate([piece.vertices, near.vertices[len(used) :]]),
            faces,
            np.concatenate([piece.sources, piece.sources[near.sources[len(used) :]]]),
        )

    def _box(self, places: FloatArray, margin: float) -> Any:
        """Return the boxes around places of shape (n, k, 3), seen from above."""
        low, high = places[:, :, :2].min(axis=1) - margin, places[:, :, :2].max(axis=1) + margin
        return self._shapely.box(low[:, 0], low[:, 1], high[:, 0], high[:, 1])

    def _split_faces(self, piece: CutPiece, same: float) -> CutPiece | None:
        """Split in three each face that has a corner within."""
        triangles = piece.vertices[piece.faces]
        faces, corners = self._corner_tree.query(self._box(triangles, 0.0))
        places = self._corners[corners]
        flat = triangles[faces][:, :, :2]
        # (n, 3): how far inside the edge that begins at each vertex the corner lies.
        sides = [_measure_side(places, flat[:, i], flat[:, (i + 1) % 3]) for i in range(3)]
        depths = np.stack([side for side, _ in sides], axis=1)
        is_within = (depths > same).all(axis=1) | (depths < -same).all(axis=1)
        faces, first = np.unique(faces[is_within], return_index=True)
        if not len(faces):
            return None
        # The weight of a vertex is the area beyond the edge that is opposite of it.
        areas = depths * np.stack([length for _, length in sides], axis=1)
        weights = np.roll(areas[is_within][first], -1, axis=1)
        weights /= weights.sum(axis=1, keepdims=True)
        made = np.einsum("nk,nkd->nd", weights, triangles[faces])
        made[:, :2] = places[is_within][first]
        middle = len(piece.vertices) + np.arange(len(faces))
        a, b, c = piece.faces[faces].T
        parts = [np.stack([*pair, middle], axis=1) for pair in ((a, b), (b, c), (c, a))]
        nearest = piece.faces[faces, weights.argmax(axis=1)]
        return CutPiece(
            np.concatenate([piece.vertices, made]),
            np.concatenate([np.delete(piece.faces, faces, axis=0), *parts]),
            np.concatenate([piece.sources, piece.sources[nearest]]),
        )

    def _find_corners(self, ends: FloatArray, same: float) -> _Events:
        """Find the corners that lie on edges of shape (e, 2, 3), between their ends."""
        edges, corners = self._corner_tree.query(self._box(ends, same))
        start, end, place = ends[edges, 0, :2], ends[edges, 1, :2], self._corners[corners]
        side, length = _measure_side(place, start, end)
        along = np.einsum("nk,nk->n", place - start, end - start)
        shares = along / np.where(length > 0.0, length, 1.0) ** 2
        arms = place[:, None] - ends[edges, :, :2]
        rest = np.linalg.norm(arms, axis=2).min(axis=1)
        is_on = (np.abs(side) <= same) & (rest > same) & (shares > 0.0) & (shares < 1.0)
        return edges[is_on], corners[is_on], shares[is_on]

    def _cross(self, ends: FloatArray, same: float) -> _Events:
        """Find the segments that cross edges of shape (e, 2, 3)."""
        edges, walls = self._tree.query(self._box(ends, 0.0))
        start, end = ends[edges, 0, :2], ends[edges, 1, :2]
        a, b = self._segments[walls, 0], self._segments[walls, 1]
        before, length = _measure_side(start, a, b)
        after, _ = _measure_side(end, a, b)
        is_through = (np.minimum(before, after) < -same) & (np.maximum(before, after) > same)
        shares = before / np.where(is_through, before - after, 1.0)
        places = start + shares[:, None] * (end - start)
        along = np.einsum("nk,nk->n", places - a, b - a) / length
        is_through &= (along >= -same) & (along <= length + same)
        return edges[is_through], walls[is_through], shares[is_through]


def _measure_side(
    places: FloatArray, start: FloatArray, end: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return how far places lie to the left of lines, and how long those are."""
    along = end - start
    length = np.linalg.norm(along, axis=1)
    arms = places - start
    cross = along[:, 0] * arms[:, 1] - along[:, 1] * arms[:, 0]
    return cross / np.where(length > 0.0, length, 1.0), length


def _split_edges(
    piece: CutPiece, find: Callable[[FloatArray, float], _Events], same: float
) -> CutPiece | None:
    """Split edges once each, at the first wall or corner that is found; None where none is."""
    edges = np.sort(piece.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    distinct, which = np.unique(edges, axis=0, return_inverse=True)
    found, walls, shares = find(piece.vertices[distinct], same)
    if not len(found):
        return None
    order = np.lexsort((walls, found))
    split, first = np.unique(found[order], return_index=True)
    shares, rank = shares[order][first], np.full(len(distinct), np.iinfo(np.int64).max)
    rank[split] = walls[order][first]
    middle = np.full(len(distinct), -1)
    middle[split] = len(piece.vertices) + np.arange(len(split))
    start, end = distinct[split].T
    made = piece.vertices[start] + shares[:, None] * (piece.vertices[end] - piece.vertices[start])
    nearest = np.where(shares < 0.5, start, end)
    sides = which.reshape(-1, 3)
    return CutPiece(
        np.concatenate([piece.vertices, made]),
        _share_faces(piece.faces, middle[sides], rank[sides]),
        np.concatenate([piece.sources, piece.sources[nearest]]),
    )


def _share_faces(faces: IntArray, middles: IntArray, ranks: IntArray) -> IntArray:
    """Share out faces among the vertices on their edges.

    The wall of the first rank becomes an edge of the shares. As the walls of a face do not cross,
    and each takes its turn, there are no more turns than a face has walls. Middles (f, 3) are on
    the edges that begin at each vertex, -1 where one has none; ranks (f, 3) are of the walls that
    cross there.
    """
    count = (middles >= 0).sum(axis=1)
    # Faces are turned, so that the wall of the first rank crosses the edge from a to b at m; all
    # walls of that rank leave by the edge of m at n, that of m at k, or by c.
    turn = (ranks.argmin(axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(faces, turn, axis=1).T
    m, n, k = np.take_along_axis(middles, turn, axis=1).T
    rows = [
        (count == 0, ((a, b, c),)),
        ((count > 0) & (k < 0), ((a, m, c),)),
        ((count > 0) & (k >= 0), ((a, m, k), (m, c, k))),
        ((count > 0) & (n < 0), ((m, b, c),)),
        ((count > 0) & (n >= 0), ((m, b, n), (m, n, c))),
    ]
    return np.concatenate(
        [np.stack(corners, axis=1)[chosen] for chosen, parts in rows for corners in parts]
    )
