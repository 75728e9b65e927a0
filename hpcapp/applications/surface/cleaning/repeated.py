"""Points at the place of another: scans joined twice, vertices of faces that share none.

They hold nothing new, and would make a cloud seem denser than it is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpcapp.cancellation import check_cancelled
from hpcapp.geometry.points import BoolArray, FloatArray

_ROWS_AT_ONCE = 1 << 14  # what is made of them stays in the cache
_FACTORS = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)
_HALF = np.uint64(32)


def find_repeated(positions: FloatArray) -> BoolArray:
    """Tell which finite points (n, 3) are at the place of one before them, (n,).

    The first at each place is not marked, whatever normals they have. Points whose hashes differ
    are at different places. Few others have to be compared, so that it costs hardly more than
    sorting n integers.
    """
    hashes = _hash(positions)
    ordered = np.sort(hashes)
    # Hashes that several points have: only those points are compared.
    shared = ordered[1:][ordered[1:] == ordered[:-1]]
    repeated = np.zeros(len(positions), np.bool_)
    if not len(shared):
        return repeated
    rows = np.flatnonzero(np.isin(hashes, shared))
    columns = positions[rows].T
    order = np.lexsort(columns)  # stable: of equal ones the first stays first
    sorted_columns = columns[:, order]
    is_same = np.logical_and.reduce(sorted_columns[:, 1:] == sorted_columns[:, :-1])
    repeated[rows[order[1:][is_same]]] = True
    return repeated


def _hash(positions: FloatArray) -> NDArray[np.uint64]:
    """Mix the bits of coordinates, of which the last are zeros where they were rounded."""
    hashes = np.empty(len(positions), np.uint64)
    for start in range(0, len(positions), _ROWS_AT_ONCE):
        check_cancelled()
        rows = slice(start, start + _ROWS_AT_ONCE)
        bits = (positions[rows] + 0.0).view(np.uint64)  # no negative zeros
        mixed = np.zeros(len(bits), np.uint64)
        for axis in range(3):
            mixed += bits[:, axis]
            mixed *= _FACTORS[axis]
            mixed ^= mixed >> _HALF
        hashes[rows] = mixed
    return hashes
