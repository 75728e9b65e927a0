"""The noise of a cloud, from place to place: a small field over dyadic cells.

::

    residuals of fits in cells of 1, 2, 4, 8 ──> quartiles over pools of vertices ──> map_noise

A pool of vertices tells the noise by the smallest cells that it does not fill: where it does, the
cell cuts its tails off. What the next larger cells leave beyond that is detail. Where a pool has
too few vertices, the next larger one tells.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.field.weights import SAME_NOISE, tell_noise
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.geometry.lattice import ancestor_keys, unique_keys
from hpcapp.geometry.points import FloatArray, IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.records import record

SHARE = 0.15
"""Standard deviations of the noise across a cell, at most, that it tells: of a spot of .8 spacings
.3 tells a tenth less, and .07 the same."""
QUARTILE = 0.25
"""Of the variances, that counts: edges and thin parts, which no quadric fits, are above it."""
_FEWEST = 8  # vertices of a pool
_SMALLEST, _LARGEST = 2, 9  # doublings of the finest cells that make pools
_EDGE_GROWTH = 4.0  # of what edges leave in cells of double the size
_UNTOLD = 0.2  # spacings: below that the residuals of clean scans scatter, by relief and chance


@record("surface.local_noise")
@dataclass(frozen=True, slots=True, eq=False)
class LocalNoise:
    """How far points lie off their surface, from place to place.

    `whole` is the standard deviation over the whole cloud, in length units of the input; deviations
    up to `untold` cannot be told from relief. The spacings of `places` are the deviations.
    """

    whole: float
    untold: float
    places: LocalScale

    @classmethod
    def none(cls) -> LocalNoise:
        """Return that of points without noise."""
        return cls(0.0, 0.0, LocalScale.uniform(0.0))

    @property
    def usual(self) -> float:
        """The deviation that half of the points have, or less."""
        return self.places.quantile(0.5)

    @property
    def range(self) -> tuple[float, float]:
        """The deviation that one point in twenty has, or less; and the one that it has, or more."""
        return self.places.quantile(0.05), self.places.quantile(0.95)

    def scaled(self, factor: float) -> LocalNoise:
        """Return so many times the noise."""
        spacing, spacings = factor * self.places.spacing, factor * self.places.spacings
        places = replace(self.places, spacing=spacing, spacings=spacings)
        return LocalNoise(factor * self.whole, factor * self.untold, places)

    def variances_at(self, places: FloatArray) -> FloatArray:
        """Return the variances (n,) of the points around places (n, 3), in squared length units.

        They are the whole cloud's at least.
        """
        local = self.places.at(places) ** 2
        variances: FloatArray = np.maximum(local - self.untold**2, self.whole**2)
        return variances


@dataclass(frozen=True, slots=True, eq=False)
class Residuals:
    """What fits leave over in cells of one size, at v vertices with enough points.

    `keys` (v,) are of the vertices; `variances` (v,) are RSS / (n - 10), in squared length units.
    """

    keys: IntArray
    variances: FloatArray


def map_noise(
    whole: float,
    spacing: float,
    origin: FloatArray,
    cell_size: float,
    residuals: Sequence[Residuals],
) -> LocalNoise:
    """Map the standard deviations that residuals tell.

    `whole` is the deviation over the whole cloud, `origin` (3,) a corner of a cell of any size,
    `cell_size` the edge of the finest cells; `residuals` are in these, and in cells of twice, four
    times their edge and so on.
    """
    levels, keys, counts, deviations = [], [], [], []
    for pool in range(_SMALLEST, _LARGEST + 1):
        # (v,), (c,): the pool of each vertex, and all pools of this size.
        members = ancestor_keys(residuals[0].keys, pool)
        cells = unique_keys(members)
        variances = _pool_variances(cells, pool, cell_size, residuals[: pool + 1])
        noisy = np.flatnonzero(variances > 0.0)  # where all of it is detail, nothing is told
        levels.append(np.full(len(noisy), pool - _SMALLEST))
        keys.append(cells[noisy])
        counts.append(np.bincount(kernels.find_keys(cells, members), minlength=len(cells))[noisy])
        deviations.append(np.sqrt(variances[noisy]))
    edge = cell_size * 2.0**_SMALLEST
    columns = map(np.concatenate, (levels, keys, counts, deviations))
    return LocalNoise(whole, _UNTOLD * spacing, LocalScale(whole, origin, edge, *columns))


def _pool_variances(
    cells: IntArray, pool: int, cell_size: float, residuals: Sequence[Residuals]
) -> FloatArray:
    """Return the noise in each pool, NaN where there are too few vertices."""
    # (l, c): by cells of each size
    quartiles = np.stack(
        [
            _take_quartiles(cells, ancestor_keys(some.keys, pool - level), some.variances)
            for level, some in enumerate(residuals)
        ]
    )
    # (l,): the largest variance that cells of each size do not cut off.
    limits = (SHARE * cell_size * 2.0 ** np.arange(len(residuals))) ** 2
    is_whole = quartiles <= limits[:, None]  # NaN is not
    # (c,): the largest cells that the pool has enough vertices of; then the smallest that hold all
    # of the noise, or those.
    coarsest = len(residuals) - 1 - np.isfinite(quartiles)[::-1].argmax(axis=0)
    level = np.where(is_whole.any(axis=0), is_whole.argmax(axis=0), coarsest)
    # (3, c): by this size, and by those around it
    around = np.clip(level + np.array([[-1], [0], [1]]), 0, len(residuals) - 1)
    finer, own, coarser = np.take_along_axis(quartiles, around, axis=0)
    # Where no larger cells tell what is detail, the smaller ones do.
    beyond = np.maximum(0.0, own - SAME_NOISE * finer) / (1.0 - SAME_NOISE / _EDGE_GROWTH)
    by_finer = np.where(level > 0, np.maximum(0.0, own - beyond), np.nan)
    variances: FloatArray = np.where(level < coarsest, tell_noise(own, coarser), by_finer)
    return variances


def _take_quartiles(cells: IntArray, keys: IntArray, variances: FloatArray) -> FloatArray:
    """Return the lower quartile of what lies in each of some cells, NaN where that is little."""
    rows = kernels.find_keys(cells, keys)
    # Pool by pool, the variances of each rising; those of no pool are last.
    order = np.lexsort((variances, rows))
    counts = np.bincount(rows, minlength=len(cells))[: len(cells)]
    quartiles = np.full(len(cells), np.nan)
    rich = counts >= _FEWEST
    nth = (QUARTILE * (counts[rich] - 1)).astype(np.int64)
    quartiles[rich] = variances[order[np.cumsum(counts)[rich] - counts[rich] + nth]]
    return quartiles
