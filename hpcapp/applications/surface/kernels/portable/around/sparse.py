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
    """Tell which points have few others around them.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
        In length units of the input.
    keys, offsets, rows
        The cells that `sort_points` puts them into.
    radii : ndarray of float64, shape (c,)
        How far is looked from the points of each cell: the edge of a cell at most.
    enough : int
        So many others within the radius are not few.

    Returns
    -------
    ndarray of bool, shape (n,)
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
    """Find the points nearest to some.

    Parameters
    ----------
    positions, keys, offsets, rows
        As for `find_sparse`.
    edge : float
        Of a cell, in length units of the input.
    asked : ndarray of int64, shape (m,)
        Rows of points.
    count : int
        So many are found, none of them the point itself.
    limit : float
        Farther points are not found; in length units of the input, 64 edges at most.

    Returns
    -------
    squares : ndarray of float64, shape (m, count)
        Of their distances, rising; infinite where there are no more.
    nearest : ndarray of int64, shape (m, count)
        Their rows, rising where they are equally far away; n where there are no more.
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
