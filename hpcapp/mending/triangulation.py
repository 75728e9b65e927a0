"""The surface of least area that triangles on the vertices of a loop can be.

Found by dynamic programming (Barequet and Sharir 1995, https://doi.org/10.1016/0167-8396(94)00011-G).
"""

from __future__ import annotations

from collections.abc import Collection
from itertools import pairwise

import numpy as np

from hpcapp.geometry.points import FloatArray, IntArray

_MOST = 256
"""Vertices that are looked at at once: it costs their cube."""


def triangulate(places: FloatArray, taken: Collection[tuple[int, int]] = ()) -> IntArray | None:
    """Return the triangles of least area that fill a loop.

    Parameters
    ----------
    places : ndarray of float64, shape (n, 3)
        Along the loop; three or more.
    taken : collection of (int, int)
        Pairs of its vertices, the lower first, that no edge may join.

    Returns
    -------
    ndarray of int64, shape (n - 2, 3), or None
        They run along the loop. None where `taken` leaves no way. A loop of more than 256 vertices
        is cut into chains first, of which each is filled up to its chord.

    Examples
    --------
    >>> corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    >>> triangulate(corners, {(0, 2)}).tolist()
    [[0, 1, 3], [1, 2, 3]]
    """
    return _fill(places, np.arange(len(places)), set(taken))


def _fill(places: FloatArray, rows: IntArray, taken: set[tuple[int, int]]) -> IntArray | None:
    """Fill what some rows of the loop, in their order, are the border of."""
    if len(rows) < 3:
        return np.empty((0, 3), np.int64)
    if len(rows) <= _MOST:
        return _find_least(places, rows, taken)
    cuts = np.linspace(0, len(rows) - 1, _MOST).astype(np.int64)
    chains = [rows[first : last + 1] for first, last in pairwise(cuts)]
    if any(len(chain) > 2 and (chain[0], chain[-1]) in taken for chain in chains):
        return None
    parts = [_fill(places, chain, taken) for chain in [rows[cuts], *chains]]
    filled = [part for part in parts if part is not None]
    return np.concatenate(filled) if len(filled) == len(parts) else None


def _find_least(places: FloatArray, rows: IntArray, taken: set[tuple[int, int]]) -> IntArray | None:
    count = len(rows)
    arms = places[rows][:, None] - places[rows][None]
    squares = (arms * arms).sum(axis=2)
    index = {int(row): at for at, row in enumerate(rows)}
    is_taken = np.zeros((count, count), np.bool_)
    for one, other in taken:
        if one in index and other in index:
            is_taken[index[one], index[other]] = True
    is_taken[0, -1] = False  # the last side of the loop
    # (n, n): the least area of what fills the loop from one row to a later one, and the row between
    # that is the tip of the triangle on their chord.
    least, tips = np.zeros((count, count)), np.zeros((count, count), np.int64)
    for span in range(2, count):
        first = np.arange(count - span)[:, None]
        last, tip = first + span, first + np.arange(1, span)
        sums = least[first, tip] + least[tip, last]
        sums += _area(squares[first, tip], squares[tip, last], squares[first, last])
        best = np.argmin(sums, axis=1)
        least[first[:, 0], last[:, 0]] = np.where(
            is_taken[first[:, 0], last[:, 0]], np.inf, sums[first[:, 0], best]
        )
        tips[first[:, 0], last[:, 0]] = tip[first[:, 0], best]
    if np.isinf(least[0, -1]):
        return None
    triangles, waiting = [], [(0, count - 1)]
    while waiting:
        start, end = waiting.pop()
        if end - start >= 2:
            middle = int(tips[start, end])
            triangles.append((start, middle, end))
            waiting += [(start, middle), (middle, end)]
    return rows[np.array(triangles)]


def _area(one: FloatArray, other: FloatArray, third: FloatArray) -> FloatArray:
    """Return the areas of triangles by their squared sides, as Heron does."""
    squared = 4.0 * one * other - (one + other - third) ** 2
    areas: FloatArray = 0.25 * np.sqrt(np.maximum(squared, 0.0))
    return areas
