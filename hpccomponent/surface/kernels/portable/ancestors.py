"""Which cells of a coarse level hold some of the finest, in numpy."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.types.lattice import find_keys, pack_places, unpack_keys
from hpccomponent.surface.types.points import IntArray

__all__ = ["mark_ancestors"]


def mark_ancestors(cells: IntArray, depth: int, ancestors: IntArray) -> NDArray[np.uint32]:
    """Tell which cells of a level are ancestors of some of the finest, and where in them these lie.

    Parameters
    ----------
    cells : ndarray of int64, shape (c,)
        Sorted keys of finest cells.
    depth : int
        The level.
    ancestors : ndarray of int64, shape (a,)
        Sorted keys of cells of that level.

    Returns
    -------
    ndarray of uint32, shape (a,)
        Bit x + 3 y + 9 z is set where one of the cells lies, along each axis, first (0), between
        (1) or last (2) among the finest in the ancestor; 0 for what is the ancestor of none.
    """
    places = unpack_keys(cells)
    within, last = places & ((1 << depth) - 1), (1 << depth) - 1
    ways = np.where(within == 0, 0, np.where(within == last, 2, 1))
    bits = np.uint32(1) << (ways @ np.array([1, 3, 9])).astype(np.uint32)
    rows = find_keys(ancestors, pack_places(places >> depth))
    marks = np.zeros(len(ancestors) + 1, np.uint32)
    np.bitwise_or.at(marks, rows, bits)
    return marks[:-1]
