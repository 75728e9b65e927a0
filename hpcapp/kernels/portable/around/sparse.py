"""How crowded it is around points, and which points are nearest to them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.lattice import NEIGHBOURS, find_keys, step_keys
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray

__all__ = ["find_nearest", "find_sparse"]

_CHUNK = 1 << 12
_SPARE = 8  # more neighbours than are asked for, some of which may be as far as the last


def find_sparse(
    positions: FloatArray,
    keys: IntArray,
    offsets: IntArray,
    rows: NDArray[np.uint32],
    radii: FloatArray,
    enough: int,
    threads: int = 1,
) -> BoolArray:
    """Tell which points (n, 3) have fewer than `enough` others around them, (n,).

    `sort_points` has put them into the cells `keys`, `offsets`, `rows`. Around those of each cell,
    others count within `radii` (c,), the edge of a cell at most.
    """
    del threads  # numpy runs on one
    counts = np.diff(offsets)
    cell_of = np.empty(len(positions), np.int64)
    cell_of[rows] = np.repeat(np.arange(len(keys)), counts)
    sparse = np.empty(len(positions), np.bool_)
    ends = np.append(offsets, offsets[-1])
    for start in range(0, len(positions), _CHUNK):
        cells = cell_of[start : start + _CHUNK]
        held = np.full(len(cells), -1)  # the point itself
        squares = radii[cells] ** 2
        for step in NEIGHBOURS:
            others = find_keys(keys, step_keys(keys[cells], step))
            number = ends[others + 1] - ends[others]
            # (p,): pairs of a point of the chunk and one in that cell
            point = np.repeat(np.arange(len(cells)), number)
            within = np.arange(len(point)) - np.repeat(np.cumsum(number) - number, number)
            other = rows[np.repeat(ends[others], number) + within]
            is_near = _square(positions[start + point] - positions[other]) <= squares[point]
            held += np.bincount(point[is_near], minlength=len(cells))
        sparse[start : start + _CHUNK] = held < enough
    return sparse


def find_nearest(
    positions: FloatArray,
    keys: IntArray,
    offsets: IntArray,
    rows: NDArray[np.uint32],
    edge: float,
    asked: IntArray,
    count: int,
    limit: float,
    threads: int = 1,
) -> tuple[FloatArray, IntArray]:
    """Find so many points nearest to those of the rows `asked` (m,), none of them the point itself.

    The points and their cells, of that edge, are as for `find_sparse`. Those farther than `limit`,
    a length of 64 edges at most, are not found. Return the squares of their distances, rising,
    infinite where there are no more, and their rows, rising where they are equally far away, n
    where there are no more; both (m, count).
    """
    from scipy.spatial import cKDTree  # a heavy module: the native build does without it

    del keys, offsets, rows, edge, threads
    tree = cKDTree(positions)
    squares, nearest = np.empty((len(asked), count)), np.empty((len(asked), count), np.int64)
    pending, wanted = np.arange(len(asked)), count + _SPARE
    while len(pending):
        wanted = min(wanted, len(positions))
        tied = [np.empty(0, np.int64)]
        for start in range(0, len(pending), _CHUNK):
            some = pending[start : start + _CHUNK]
            _, near = tree.query(positions[asked[some]], np.arange(1, wanted + 1))
            apart = _square(positions[near] - positions[asked[some], None])
            apart[(near == asked[some, None]) | (apart > limit * limit)] = np.inf
            near = np.where(np.isinf(apart), len(positions), near)
            order = np.lexsort((near, apart), axis=1)
            apart, near = (np.take_along_axis(column, order, axis=1) for column in (apart, near))
            short = np.full((len(some), max(0, count - wanted)), np.inf)
            squares[some] = np.hstack([apart, short])[:, :count]
            nearest[some] = np.hstack([near, np.where(np.isinf(short), len(positions), 0)])[
                :, :count
            ]
            # Where the last ones are equally far away, others may be, too.
            last = apart[:, -2] if wanted > 1 else apart[:, -1]
            is_tied = np.isfinite(last) & (squares[some, -1] >= last)
            tied.append(some[is_tied])
        pending = np.concatenate(tied) if wanted < len(positions) else np.empty(0, np.int64)
        wanted *= 2
    return squares, nearest


def _square(arms: FloatArray) -> FloatArray:
    squares: FloatArray = arms[..., 0] ** 2 + arms[..., 1] ** 2 + arms[..., 2] ** 2
    return squares
