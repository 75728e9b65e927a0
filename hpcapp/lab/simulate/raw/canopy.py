"""Crowns of trees, which let a pulse through in parts."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpccomponent.dataclass import dataclass

_CELL = 0.5  # metres of the maps of tops and bases
_STEP = 0.4  # metres of the way through the crowns
_FREE_PATH = 4.0  # metres within crowns to the next return, in the mean
_TRANSMITTED = 0.7  # share of the pulses that go on after a return
_MOST_RETURNS = 4  # of crowns; the surface behind them gives one more
_RAYS_AT_ONCE = 1 << 13


@dataclass(frozen=True, slots=True)
class Crown:
    """An upright ellipsoid: its middle and radius in the plane, its lowest and highest point."""

    x: float
    y: float
    radius: float
    base: float
    top: float


class Canopy:
    """What pulses meet within crowns.

    Where crowns overlap, what lies between them counts as crown. The extent is that of the scene
    along x and y, from 0, in metres.
    """

    def __init__(self, crowns: list[Crown], extent: float) -> None:
        count = int(np.ceil(extent / _CELL)) + 1
        y, x = np.mgrid[:count, :count] * _CELL
        self._tops, self._bases = np.full(x.shape, -np.inf), np.full(x.shape, np.inf)
        for crown in crowns:
            square = ((x - crown.x) ** 2 + (y - crown.y) ** 2) / crown.radius**2
            middle, half = 0.5 * (crown.top + crown.base), 0.5 * (crown.top - crown.base)
            # (c, c): half the crown's height at each cell, negative infinity where there is none
            rise = np.where(square < 1.0, half * np.sqrt(np.maximum(1.0 - square, 0.0)), -np.inf)
            self._tops = np.maximum(self._tops, middle + rise)
            self._bases = np.minimum(self._bases, middle - rise)
        self._low, self.top = min(c.base for c in crowns), max(c.top for c in crowns)

    def strike(
        self,
        origins: FloatArray,
        directions: FloatArray,
        reach: FloatArray,
        rng: np.random.Generator,
    ) -> tuple[IntArray, FloatArray, BoolArray]:
        """Draw the returns of pulses (n, 3) within the crowns, as far as each reaches (n,).

        Return the pulse of each return (m,), its distance from the pulse's origin (m,), and whether
        something of each pulse is left behind the crowns (n,).
        """
        shape = (len(origins), _MOST_RETURNS)
        # (n, 4): metres of crown before each return, and whether the pulse goes on after it
        depths = np.cumsum(rng.exponential(_FREE_PATH, shape), axis=1)
        survives = rng.random(shape) < _TRANSMITTED
        # (n, 4): whether it gets as far as each return
        arrives = np.cumprod(
            np.column_stack([np.ones(len(origins), bool), survives[:, :-1]]), axis=1
        )
        distances = np.full(shape, np.inf)
        for start in range(0, len(origins), _RAYS_AT_ONCE):
            rows = slice(start, start + _RAYS_AT_ONCE)
            distances[rows] = self._pass_through(
                origins[rows], directions[rows], reach[rows], depths[rows]
            )
        is_met = np.isfinite(distances)
        pulses, which = np.nonzero(is_met & (arrives > 0))
        return pulses, distances[pulses, which], (survives | ~is_met).all(axis=1)

    def _pass_through(
        self, origins: FloatArray, directions: FloatArray, reach: FloatArray, depths: FloatArray
    ) -> FloatArray:
        """Return how far each ray goes until it has passed so much crown; infinite if never."""
        z, slope = origins[:, 2], directions[:, 2]
        slope = np.where(np.abs(slope) < 1e-9, 1e-9, slope)
        ends = np.stack([(self._low - z) / slope, (self.top - z) / slope])
        # (n,): where a ray comes between the lowest and the highest crown, and where it leaves
        begin, end = np.maximum(ends.min(axis=0), 0.0), np.minimum(ends.max(axis=0), reach)
        longest = np.sqrt(2.0) * _CELL * len(self._tops) + self.top - self._low
        count = int(np.ceil(np.clip((end - begin).max(initial=0.0), 0.0, longest) / _STEP))
        found = np.full(depths.shape, np.inf)
        if not count:
            return found
        # (n, s): places along the rays, and whether they are in a crown
        places = begin[:, None] + _STEP * (np.arange(count) + 1.0)
        x, y, z = (origins[:, axis, None] + places * directions[:, axis, None] for axis in range(3))
        row, column = (np.rint(each / _CELL).astype(np.int64) for each in (y, x))
        last = len(self._tops) - 1
        is_inside = (row >= 0) & (row <= last) & (column >= 0) & (column <= last)
        cell = np.clip(row, 0, last), np.clip(column, 0, last)
        is_inside &= (z < self._tops[cell]) & (z > self._bases[cell]) & (places < end[:, None])
        passed = _STEP * np.cumsum(is_inside, axis=1)
        for number in range(depths.shape[1]):
            depth = depths[:, number]
            step = (passed < depth[:, None]).sum(axis=1)
            rows = np.flatnonzero(step < count)
            at = step[rows]
            found[rows, number] = places[rows, at] - (passed[rows, at] - depth[rows])
        return found
