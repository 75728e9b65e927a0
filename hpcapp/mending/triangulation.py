"""The surface of least area that triangles on the vertices of a loop can be.

Found by dynamic programming (Barequet and Sharir 1995, https://doi.org/10.1016/0167-8396(94)00011-G).
"""

from __future__ import annotations

from collections.abc import Collection
from itertools import pairwise

import numpy as np

from hpcapp.geometry.points import BoolArray, FloatArray, IntArray

_MOST = 256
"""Vertices that are looked at at once: it costs their cube."""
_TURNED = 4.0
"""How much more a triangle counts that is turned by a right angle, and by twice that if it lies on
a face: so that what the border's teeth span outweighs what a shorter lid saves."""


def triangulate(
    places: FloatArray, beside: FloatArray, taken: Collection[tuple[int, int]] = ()
) -> IntArray | None:
    """Return the triangles of least area that fill a loop.

    Parameters
    ----------
    places : ndarray of float64, shape (n, 3)
        Along the loop; three or more.
    beside : ndarray of float64, shape (n, 3)
        Unit normals of the faces on the other side of each side of the loop, from its vertex to the
        next; zeros where there are none.
    taken : collection of (int, int)
        Pairs of its vertices, the lower first, that no edge may join.

    Returns
    -------
    ndarray of int64, shape (n - 2, 3), or None
        They run along the loop. None where `taken` leaves no way. A loop of more than 256 vertices
        is cut into chains first, of which each is filled up to its chord.

    Notes
    -----
    The area of a triangle beside a face counts more, the more it is turned against that face: else
    teeth of a border would as well be filled by triangles that lie on the faces between them.

    Examples
    --------
    >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    >>> triangulate(corners, np.zeros((4, 3)), {(0, 2)}).tolist()
    [[0, 1, 3], [1, 2, 3]]
    """
    return _Filler(places, beside, set(taken)).fill(np.arange(len(places)))


class _Filler:
    """Fills what some rows of a loop, in their order, are the border of."""

    def __init__(self, places: FloatArray, beside: FloatArray, taken: set[tuple[int, int]]) -> None:
        self._places, self._beside, self._taken = places, beside, taken

    def fill(self, rows: IntArray) -> IntArray | None:
        """Return the triangles; None where there is no way."""
        if len(rows) < 3:
            return np.empty((0, 3), np.int64)
        if len(rows) <= _MOST:
            return self._find_least(rows)
        cuts = np.linspace(0, len(rows) - 1, _MOST).astype(np.int64)
        chains = [rows[first : last + 1] for first, last in pairwise(cuts)]
        if any(len(chain) > 2 and (chain[0], chain[-1]) in self._taken for chain in chains):
            return None
        parts = [self.fill(some) for some in [rows[cuts], *chains]]
        filled = [part for part in parts if part is not None]
        return np.concatenate(filled) if len(filled) == len(parts) else None

    def _find_least(self, rows: IntArray) -> IntArray | None:
        count, places = len(rows), self._places[rows]
        arms = places[:, None] - places[None]
        squares = (arms * arms).sum(axis=2)
        is_taken = self._find_taken(rows)
        after = np.roll(rows, -1)
        # (n, 3): the normals beside sides of the loop itself; chords have none.
        beside = np.where((after == (rows + 1) % len(self._places))[:, None], self._beside[rows], 0)
        # (n, n): the least area of what fills the loop from one row to a later one, and the row
        # between that is the tip of the triangle on their chord.
        least, tips = np.zeros((count, count)), np.zeros((count, count), np.int64)
        for span in range(2, count):
            first = np.arange(count - span)
            last, tip = first + span, first[:, None] + np.arange(1, span)
            one, other = squares[first[:, None], tip], squares[tip, last[:, None]]
            areas = _area(one, other, squares[first, last][:, None])
            factors = np.ones_like(areas)
            factors[:, 0] += _weigh_turn(places, first, first + 1, last, beside[first])
            factors[:, -1] += _weigh_turn(places, first, last - 1, last, beside[last - 1])
            if span == count - 1:
                for column, middle in enumerate(tip[0]):
                    factors[:, column] += _weigh_turn(places, first, middle, last, beside[last])
            sums = least[first[:, None], tip] + least[tip, last[:, None]] + factors * areas
            best = np.argmin(sums, axis=1)
            found = sums[np.arange(len(first)), best]
            least[first, last] = np.where(is_taken[first, last], np.inf, found)
            tips[first, last] = tip[np.arange(len(first)), best]
        return None if np.isinf(least[0, -1]) else rows[_collect(tips)]

    def _find_taken(self, rows: IntArray) -> BoolArray:
        """Tell which rows no edge may join, shape (n, n)."""
        index = {int(row): at for at, row in enumerate(rows)}
        is_taken = np.zeros((len(rows), len(rows)), np.bool_)
        for one, other in self._taken:
            if one in index and other in index:
                is_taken[index[one], index[other]] = True
        is_taken[0, -1] = False  # the last side of the loop
        return is_taken


def _collect(tips: IntArray) -> IntArray:
    """Return the triangles whose tips were found."""
    triangles: list[tuple[int, int, int]] = []
    waiting = [(0, len(tips) - 1)]
    while waiting:
        start, end = waiting.pop()
        if end - start >= 2:
            middle = int(tips[start, end])
            triangles.append((start, middle, end))
            waiting += [(start, middle), (middle, end)]
    return np.array(triangles)


def _weigh_turn(
    places: FloatArray, a: IntArray, b: IntArray | np.int64, c: IntArray, beside: FloatArray
) -> FloatArray:
    """Return by how much more triangles count for being turned against the faces beside them."""
    normals = np.cross(places[b] - places[a], places[c] - places[a])
    lengths = np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
    cosines = np.einsum("ij,ij->i", normals, beside) / lengths
    turned: FloatArray = _TURNED * (beside.any(axis=1) - cosines)
    return turned


def _area(one: FloatArray, other: FloatArray, third: FloatArray) -> FloatArray:
    """Return the areas of triangles by their squared sides, as Heron does."""
    squared = 4.0 * one * other - (one + other - third) ** 2
    areas: FloatArray = 0.25 * np.sqrt(np.maximum(squared, 0.0))
    return areas
