"""Points of one cell on one sheet, whose normals agree up to their signs."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.lattice import cells_of, find_first, number_keys, pack_places
from hpcapp.geometry.points import ByteArray, Float32Array, FloatArray, IntArray
from hpcapp.kernels.constants import SHEETS

__all__ = ["group_sheets"]

_AGREE = 0.75  # |cosine| between the normals of a group and of its seed
_THICK = 0.35  # spacings between a seed's plane and a point on it
_NOISES = 2.0  # or so many standard deviations of the point, where that is more
_TIED = 1.0 + 1e-6  # by how much farther points must lie: less may be rounding


def group_sheets(
    positions: FloatArray,
    vectors: Float32Array,
    low: FloatArray,
    edge: float,
    spacing: float,
    threads: int = 1,
) -> tuple[IntArray, IntArray, IntArray, ByteArray]:
    """Group the points of each cell by the sheets that they lie on.

    `vectors` (n, 3) are what `fit_planes` has returned of the points (n, 3), one at least; a corner
    of the lattice of cells lies at `low` (3,). Return the cell of each group, and which of its
    groups it is, both (g,), sorted by both; the group of each point, (n,); and 1 where its normal
    is on the other side than the seed's of its group, (n,).

    The seed of a group is the point nearest to the middle of those of its cell that have no group
    yet; those that lie on its plane, and it on theirs, go to it. What is left by eleven groups is
    the twelfth.
    """
    del threads  # numpy runs on one
    wide = vectors.astype(np.float64)
    noise = np.sqrt(_dot(wide, wide))
    normals = wide / np.maximum(noise, 1e-300)[:, None]
    places = np.floor(cells_of(positions, low, edge)).astype(np.int64)
    keys, cell_of = number_keys(pack_places(places))
    thick = np.maximum(_THICK * spacing, _NOISES * noise)
    ranks = np.zeros(len(positions), np.int64)
    opposed = np.zeros(len(positions), np.uint8)
    # (l,): points that have no group yet, cell by cell.
    left = np.argsort(cell_of, kind="stable")
    for rank in range(SHEETS):
        seeds = _find_seeds(positions, left, cell_of)
        arms = positions[left] - positions[seeds]
        cosines = _dot(normals[left], normals[seeds])
        is_on = np.abs(_dot(arms, normals[seeds])) <= thick[left]
        is_on &= np.abs(_dot(arms, normals[left])) <= thick[left]
        is_on &= np.abs(cosines) >= _AGREE
        # A seed lies on its own plane, whatever is rounded; the last group takes all that is left.
        is_on |= (left == seeds) | (rank == SHEETS - 1)
        ranks[left[is_on]] = rank
        opposed[left[is_on]] = cosines[is_on] < 0.0
        left = left[~is_on]
        if not len(left):
            break
    names, group_of = number_keys(cell_of * SHEETS + ranks)
    return keys[names // SHEETS], names % SHEETS, group_of, opposed


def _find_seeds(positions: FloatArray, rows: IntArray, cell_of: IntArray) -> IntArray:
    """Return for each row the point of its cell nearest to the middle of the rows there.

    Of several as near, as both of two are, it is the first. Rows of a cell stand side by side.
    """
    cells = cell_of[rows]
    starts = np.flatnonzero(np.append(True, cells[1:] != cells[:-1]))
    counts = np.diff(np.append(starts, len(rows)))
    group_of = np.repeat(np.arange(len(starts)), counts)
    sums = [np.bincount(group_of, column) for column in positions[rows].T]  # row after row
    middles = np.stack(sums, axis=1) / counts[:, None]
    arms = positions[rows] - middles[group_of]
    squares = _dot(arms, arms)
    nearest = np.minimum.reduceat(squares, starts)
    # As near as the nearest but for rounding: the first of these is taken, on any processor.
    candidates = np.flatnonzero(squares <= _TIED * nearest[group_of])
    _, first = find_first(group_of[candidates])
    return rows[candidates[first]][group_of]


def _dot(first: FloatArray, second: FloatArray) -> FloatArray:
    products = first * second
    dots: FloatArray = products[:, 0] + products[:, 1] + products[:, 2]
    return dots
