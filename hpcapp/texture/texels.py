"""The texels of triangles that lie in a picture."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hpcapp.geometry.points import FloatArray, IntArray
from hpccomponent.dataclass import dataclass

_AT_ONCE = 1 << 17  # texels, about; some hundred bytes each
_FACES = 1 << 12  # whose rows are looked at at once


@dataclass(frozen=True, slots=True, eq=False)
class Texels:
    """Texels whose centres lie in triangles.

    Parameters
    ----------
    cells : ndarray of int64, shape (n,)
        Row by row from the top.
    faces : ndarray of int64, shape (n,)
        The triangle that each lies in.
    weights : ndarray of float64, shape (n, 3)
        Of the triangle's corners, with a sum of 1.
    """

    cells: IntArray
    faces: IntArray
    weights: FloatArray

    def blend(self, rows: FloatArray, faces: IntArray) -> FloatArray:
        """Return what vertices have, shape (v, k), at the texels between them, shape (n, k)."""
        corners = faces[self.faces]
        total = np.zeros((len(corners), rows.shape[1]))
        for corner in range(3):
            total += self.weights[:, corner, None] * rows.take(corners[:, corner], axis=0)
        return total


def cover(places: FloatArray, faces: IntArray, pixels: int) -> Iterator[Texels]:
    """Yield the texels of triangles, some at a time; those on a common edge are of one of two.

    Places (v, 2) are right and down, 0 to 1, in a picture of so many pixels a side.
    """
    for first in range(0, len(faces), _FACES):
        # (f, 3, 2): texels have their centres at whole numbers.
        corners = places[faces[first : first + _FACES]] * pixels - 0.5
        owners, rows, starts, lengths = _find_spans(corners, pixels)
        cuts = np.flatnonzero(np.diff(np.cumsum(lengths) // _AT_ONCE)) + 1
        for spans in np.split(np.arange(len(owners)), cuts):
            if not len(spans):
                continue
            counts = lengths[spans]
            within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
            columns = np.repeat(starts[spans], counts) + within
            lines = np.repeat(rows[spans], counts)
            own = np.repeat(owners[spans], counts)
            weights = _weigh(corners[own], columns, lines)
            yield Texels(lines * pixels + columns, own + first, weights)


def _find_spans(corners: FloatArray, pixels: int) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Return the runs of texels in triangles: whose, in which row, from where, and how many."""
    low = np.clip(np.ceil(corners[:, :, 1].min(axis=1)), 0, pixels).astype(np.int64)
    high = np.clip(np.ceil(corners[:, :, 1].max(axis=1)), 0, pixels).astype(np.int64)
    heights = high - low
    owners = np.repeat(np.arange(len(corners)), heights)
    rows = np.arange(len(owners)) - np.repeat(np.cumsum(heights) - heights - low, heights)
    left, right = np.full(len(rows), np.inf), np.full(len(rows), -np.inf)
    for corner in range(3):
        # The edge goes from its upper end to its lower one, whichever triangle asks.
        ends = corners[:, [corner, (corner + 1) % 3]]
        is_down = ends[:, 0, 1] <= ends[:, 1, 1]
        upper = np.where(is_down[:, None], ends[:, 0], ends[:, 1])[owners]
        lower = np.where(is_down[:, None], ends[:, 1], ends[:, 0])[owners]
        crosses = (upper[:, 1] <= rows) & (rows < lower[:, 1])
        fall = np.where(crosses, lower[:, 1] - upper[:, 1], 1.0)
        at = upper[:, 0] + (rows - upper[:, 1]) / fall * (lower[:, 0] - upper[:, 0])
        left = np.where(crosses, np.minimum(left, at), left)
        right = np.where(crosses, np.maximum(right, at), right)
    is_met = left <= right
    starts = np.clip(np.ceil(np.where(is_met, left, 0.0)), 0, pixels).astype(np.int64)
    stops = np.clip(np.ceil(np.where(is_met, right, 0.0)), 0, pixels).astype(np.int64)
    some = stops > starts
    return owners[some], rows[some], starts[some], (stops - starts)[some]


def _weigh(corners: FloatArray, columns: IntArray, rows: IntArray) -> FloatArray:
    """Return the weights of the corners at texels."""
    (x0, y0), (x1, y1), (x2, y2) = (corners[:, corner].T for corner in range(3))
    area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
    area[area == 0.0] = 1.0  # a line on which a texel lies: its first corner stands for it
    second = ((columns - x0) * (y2 - y0) - (x2 - x0) * (rows - y0)) / area
    third = ((x1 - x0) * (rows - y0) - (columns - x0) * (y1 - y0)) / area
    weights = np.clip(np.stack([1.0 - second - third, second, third], axis=1), 0.0, 1.0)
    shares: FloatArray = weights / weights.sum(axis=1, keepdims=True)
    return shares
