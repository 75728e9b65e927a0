"""Which cells of a terrain have changed: what stands out of the noise, at every width."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import label, uniform_filter
from scipy.stats import norm

from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.terrain.errors import CONFIDENCE
from hpccomponent.dataclass import dataclass

_NARROWEST = 3
"""Cells along a window: single ones are off by ten deviations where a wall crosses them."""
_OVERLAP = 12.0
"""Windows that chance has for each that lies beside the others: of white noise on 16 to 128 cells a
change is told in 42 of 100 cases with 1, in 4 to 11 with 8 to 16 (`benchmarks/volumes.py`)."""
_GROWN = 1.0
"""Standard deviations of the volume of a ring of cells around a region that is part of it. From 0
to 1 as many volumes are right, with 3 a fifth of the foot of heaps is lost
(`benchmarks/volumes.py`)."""
_TOUCHING = np.ones((3, 3), dtype=int)


@dataclass(frozen=True, slots=True, eq=False)
class Rise:
    """How much higher cells are, (rows, columns) each; zero where nothing is common.

    Volumes and their variances are those of the common part of each cell.
    """

    volumes: FloatArray
    variances: FloatArray
    is_common: BoolArray

    def find_deviation(self, is_in: BoolArray) -> float:
        """Return the standard deviation of the volume of some cells."""
        return float(np.sqrt(self.variances[is_in].sum()))


def find_changed(rise: Rise) -> IntArray:
    """Return 1 where it was filled, -1 where it was cut, and 0 where no change is told.

    A change is told where the volume of a square window stands out of the noise, as among as many
    windows none does by chance. The narrowest windows come first, and what they tell is not in the
    wider ones: those find what is too thin for the narrow ones. A region grows ring by
    ring as long as the volume of the next ring stands out, too: the foot of a heap.
    """
    side = np.zeros(rise.volumes.shape, dtype=np.int64)
    widths = [_NARROWEST]
    while 2 * widths[-1] < max(side.shape):
        widths.append(2 * widths[-1] - 1)
    cells = np.count_nonzero(rise.is_common)
    for width in widths:
        is_free = rise.is_common & (side == 0)
        volume = _sum_windows(rise.volumes * is_free, width)
        variance = _sum_windows(rise.variances * is_free, width)
        far = _find_far(cells / width**2 * len(widths))
        is_told = is_free & (volume**2 > far**2 * variance)
        for sign in (1, -1):
            _grow(rise, side, is_told & (sign * volume > 0.0) & (side == 0), sign)
    return side


def find_least(noise: float, cells: int) -> float:
    """Return the smallest rise that is told of the narrowest windows, among so many cells."""
    return _find_far(cells / _NARROWEST**2) * noise / _NARROWEST


def _find_far(windows: float) -> float:
    """Return the standard deviations that none of so many windows is off by, at `CONFIDENCE`."""
    return float(norm.isf(0.5 * (1.0 - CONFIDENCE) / (_OVERLAP * max(windows, 1.0))))


def _grow(rise: Rise, side: IntArray, is_told: BoolArray, sign: int) -> None:
    """Give the regions that are told, and the rings around them, their side."""
    region, count = label(is_told, _TOUCHING)
    region = np.pad(region.astype(np.int64), 1)
    taken = np.pad((side != 0) | ~rise.is_common, 1, constant_values=True)
    volumes = sign * np.pad(rise.volumes, 1).ravel()
    variances = np.pad(rise.variances, 1).ravel()
    flat, is_taken = region.ravel(), taken.ravel()
    row = region.shape[1]
    around = np.array([-row - 1, -row, -row + 1, -1, 1, row - 1, row, row + 1])
    edge = np.flatnonzero(flat)
    while len(edge):
        owner = np.repeat(flat[edge], len(around))
        ring, first = np.unique((edge[:, None] + around).ravel(), return_index=True)
        is_new = (flat[ring] == 0) & ~is_taken[ring]
        ring, owner = ring[is_new], owner[first[is_new]]
        volume = np.bincount(owner, volumes[ring], count + 1)
        variance = np.bincount(owner, variances[ring], count + 1)
        is_grown = (volume > _GROWN * np.sqrt(variance))[owner]
        edge = ring[is_grown]
        flat[edge] = owner[is_grown]
    # what a wide window tells may be around its middle only
    is_whole = np.bincount(flat, volumes, count + 1) > 0.0
    is_whole[0] = False
    side[is_whole[region[1:-1, 1:-1]]] = sign


def _sum_windows(values: FloatArray, width: int) -> FloatArray:
    sums: FloatArray = uniform_filter(values, width, mode="constant") * width**2
    return sums
