"""Which groups of points lie side by side."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from hpcapp.geometry.lattice import merge_counts
from hpcapp.geometry.points import ByteArray, FloatArray, IntArray
from hpcapp.kernels.portable.around.nearest import Nearest, round_positions

__all__ = ["link_groups"]

_LINKED = 8  # neighbours that a point links its group to, and one more that is itself
_REACH = 4  # spacings: farther points are no neighbours
_ROWS_AT_ONCE = 1 << 15


def link_groups(
    positions: FloatArray,
    own: ByteArray,
    group_of: IntArray,
    low: FloatArray,
    spacing: float,
    threads: int = 1,
) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Find the groups that lie among the neighbours of points.

    Of the points (n, 3), the neighbours of those whose `own` (n,) is not 0 count; `group_of` (n,)
    is the group of each, 0 to n - 1. `low` (3,) is as for `fit_planes`.

    Returns
    -------
    first, second : ndarray of int64, shape (l,)
        Groups that touch, the lower one first; sorted by both.
    contacts : ndarray of int64, shape (l,)
        In how many neighbours, of the 8 of each point within 4 spacings. These are nearer than the
        first that is left out (see `fit_planes`).
    arms : ndarray of int64, shape (l, 3)
        From the points of the lower group to these in the other, summed; in units of 2^-19
        spacings, and exact (see `nearest`).
    """
    del threads  # numpy runs on one
    if len(group_of) and not (group_of.min() >= 0 and group_of.max() < len(group_of)):
        raise ValueError("group_of: a row is out of range")
    rows, most = np.flatnonzero(own), _LINKED + 1
    tree = cKDTree(round_positions(positions, low, spacing))
    names, sums = [np.zeros(0, np.int64)], [np.zeros((0, 4), np.int64)]
    for start in range(0, len(rows), _ROWS_AT_ONCE):
        some = rows[start : start + _ROWS_AT_ONCE]
        nearest = Nearest(tree, some, most, _REACH)
        # (s, 9): which neighbours are nearer than the first that is left out.
        is_near = np.arange(most) < nearest.count(most)[:, None]
        first = np.broadcast_to(group_of[some, None], is_near.shape)[is_near]
        second = group_of[nearest.rows[is_near]]
        differ = first != second
        first, second = first[differ], second[differ]
        # Both groups as one number, the lower one first, so that a pair has one name.
        names.append(np.minimum(first, second) * len(positions) + np.maximum(first, second))
        arms = nearest.arms[is_near][differ] * np.where(first < second, 1.0, -1.0)[:, None]
        sums.append(np.insert(arms.astype(np.int64), 0, 1, axis=1))  # (l, 4): a contact, its arm
    every, totals = merge_counts(np.concatenate(names), np.concatenate(sums))
    groups = max(len(positions), 1)
    return every // groups, every % groups, totals[:, 0], totals[:, 1:]
