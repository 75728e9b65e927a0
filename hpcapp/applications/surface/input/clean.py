"""How a cloud is cleaned: far, repeated and outlying points dropped, wrong normals turned round.

::

    drop_far ── drop_repeated ── (normals) ── rank, judge ── outliers dropped ── normals mended
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hpcapp.applications.surface.cloud_pass import CloudPass, PassT
from hpcapp.applications.surface.input.measure import measure_spacing
from hpccomponent.surface.cloud import outlier_regions
from hpccomponent.surface.cloud.outlier_regions import DroppedCells
from hpccomponent.surface.cloud.validity import Reach
from hpccomponent.surface.kernels import bound_points
from hpccomponent.surface.normals import consistency
from hpccomponent.surface.tasks import cleaning as tasks
from hpccomponent.surface.types.lattice import unique_keys
from hpccomponent.surface.types.points import FloatArray, PointCloud

__all__ = [
    "Cleaned",
    "EvenSample",
    "clean_cloud",
    "drop_far",
    "drop_repeated",
    "even_step",
    "find_reach",
]

_SAMPLE = 20_000
_CORE = (0.02, 0.98)  # quantiles of each coordinate
_CORES = 100.0  # longest sides of the core: beyond them lie markers, not measurements


@dataclass(frozen=True, slots=True)
class Cleaned:
    """What was found wrong with a cloud.

    Parameters
    ----------
    outliers : int
        Points that were dropped.
    flipped : int
        Normals that were turned round.
    repeated : int
        Points at the place of another that were dropped.
    """

    outliers: int
    flipped: int
    repeated: int = 0


def drop_far(cloud: PointCloud) -> PointCloud:
    """Drop points farther from the middle of a cloud than a hundred times its core.

    Parameters
    ----------
    cloud : PointCloud
        Finite positions.

    Returns
    -------
    PointCloud
        In their order; the input itself where none lies so far.

    Notes
    -----
    A scanner's marker for "no echo" may lie where no lattice of the cloud's spacing reaches.
    """
    if not len(cloud):
        return cloud
    sample = EvenSample()
    sample.add(cloud.positions)
    reach = find_reach(sample.positions)
    if reach.holds(*bound_points(cloud.positions)):
        return cloud
    return cloud.take(reach.find_near(cloud.positions))


def drop_repeated(cloud_pass: PassT) -> tuple[PassT, int]:
    """Drop the points at the place of another, and return how many they were.

    The first point of each place stays.
    """
    cloud_pass, counts = cloud_pass.rewrite(tasks.drop_repeated)
    return cloud_pass, sum(count for (count,) in counts)


def even_step(points: int) -> int:
    """Return the power of two of which every so many-th point of a cloud is in an even sample.

    Parameters
    ----------
    points : int
        Of the cloud.

    Returns
    -------
    int
        1 where all points are in the sample.
    """
    step = 1
    while points > _SAMPLE * step:
        step *= 2
    return step


class EvenSample:
    """Every so many-th point of a cloud, of which there may be more to come.

    The step is the power of two that leaves at most `_SAMPLE` points, so that it is the same
    whether the cloud comes as a whole or in parts.
    """

    def __init__(self) -> None:
        self._positions = np.zeros((0, 3))
        self._step = 1
        self._seen = 0

    @property
    def positions(self) -> FloatArray:
        """Shape (s, 3), in length units of the input; at most `_SAMPLE`."""
        return self._positions

    def add(self, positions: FloatArray) -> None:
        """Take the next points of the cloud, of shape (n, 3).

        Parameters
        ----------
        positions : ndarray of float64, shape (n, 3)
            In length units of the input, in the order of the cloud.
        """
        step = even_step(self._seen + len(positions))
        self._positions, self._step = self._positions[:: step // self._step], step
        taken = positions[-self._seen % self._step :: self._step]
        self._positions = np.concatenate([self._positions, taken])
        self._seen += len(positions)


def find_reach(sample: FloatArray) -> Reach:
    """Find how far from the middle of a cloud points may lie: a hundred times its core.

    Parameters
    ----------
    sample : ndarray of float64, shape (s, 3)
        See `EvenSample`; at least one point.

    Returns
    -------
    Reach
    """
    low, high = np.sort(sample, axis=0)[np.rint(np.multiply(_CORE, len(sample) - 1)).astype(int)]
    distance = _CORES * float((high - low).max())
    return Reach(0.5 * (low + high), distance if distance > 0.0 else np.inf)


def clean_cloud(cloud_pass: PassT, spacing: float) -> tuple[PassT, Cleaned, float]:
    """Drop the points that belong to no surface and turn round the normals that point inwards.

    Parameters
    ----------
    cloud_pass : CloudPass
        Through ten points or more with unit normals. Far ones must have been dropped: see
        `drop_far`.
    spacing : float
        In length units of the input.

    Returns
    -------
    cloud_pass : CloudPass
        Through the points that remain, in their order.
    cleaned : Cleaned
    spacing : float
        Of these.
    """
    outliers = 0
    if (cells := _find_outliers(cloud_pass, spacing)) is not None:
        cloud_pass, counts = cloud_pass.rewrite(tasks.drop_cells, cells)
        outliers = sum(count for (count,) in counts)
        spacing = measure_spacing(cloud_pass)
    margin = consistency.MARGIN * spacing
    cloud_pass, counts = cloud_pass.rewrite(
        tasks.mend_region, cloud_pass.cloud.low, spacing, margin=margin
    )
    return cloud_pass, Cleaned(outliers, sum(count for (count,) in counts)), spacing


def _find_outliers(cloud_pass: CloudPass, spacing: float) -> DroppedCells | None:
    """Return the cells whose points lie apart from every surface; None where there are none."""
    low, margin = cloud_pass.cloud.low, outlier_regions.MARGIN * spacing
    ranks = cloud_pass.each(tasks.rank_region, low, spacing, margin=margin)
    judged = outlier_regions.judge_sparse(ranks)
    strays = [judged.stray_cells]
    if any(by_rank[judged.base + 1 : -1].any() for by_rank, *_ in ranks):
        strays += cloud_pass.each(tasks.judge_region, low, spacing, judged.base, margin=margin)
    cells = unique_keys(np.concatenate(strays))
    if not (len(cells) or len(judged.island_cells)):
        return None
    return DroppedCells(low, spacing, cells, judged.island_cells)
