"""The nearest neighbours of points, in whole numbers.

Positions are rounded to units of 2^-19 spacings. Within the 12 spacings that are looked at, squared
distances and sums of products are whole numbers below 2^53, which float64 holds: they are the same
in any order and on any processor.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from hpcapp.geometry.lattice import number_keys, pack_places
from hpcapp.geometry.points import FloatArray, IntArray

UNITS = 1 << 19
"""In a spacing."""

_CELL = 5  # spacings
_ROUNDED = 4.0  # units: by less than these, distances may differ by rounding alone


def round_positions(positions: FloatArray, low: FloatArray, spacing: float) -> FloatArray:
    """Return positions (n, 3) in units from the lowest corner (3,), rounded."""
    units: FloatArray = np.rint((positions - low) / (spacing / UNITS))
    return units


def cells_of_units(units: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the keys of the cells of 5 spacings that hold points, and the row of each's cell."""
    return number_keys(pack_places(np.floor(units / (_CELL * UNITS)).astype(np.int64)))


class Nearest:
    """The neighbours of points, each itself among them, by distance.

    The tree holds all points, in units; `rows` (m,) are those whose neighbours, `most` of
    them at most, are wanted. Points farther than `reach` spacings are no neighbours.
    """

    def __init__(self, tree: cKDTree, rows: IntArray, most: int, reach: int) -> None:
        units = tree.data
        bound = float(reach * UNITS)
        far, near = tree.query(units[rows], most + 1, distance_upper_bound=bound)
        self._far = far
        # Where there are fewer, the point itself stands in; `count` does not count it there.
        self.rows: IntArray = np.where(np.isfinite(far), near, rows[:, None])[:, :-1]  # (m, most)
        self.arms: FloatArray = units[self.rows] - units[rows, None]  # (m, most, 3)

    def count(self, most: int) -> IntArray:
        """Return how many neighbours of each are nearer than the first beyond so many."""
        nearer: IntArray = np.count_nonzero(self._far < self._far[:, most, None] - _ROUNDED, axis=1)
        return nearer
