"""A cloud that is not in memory is cleaned region by region, to the same points as in memory.

::

    regions ── rank ──> judge the few ── judge ──> stray cells ──> spacing of the rest
                                                                      │
    folder <── kept points, mended normals <── turn ── regions <──────┘

Each region is read with a margin, some thirty spacings wide, and its task is a pure function of
these points. The points are read once for each of these steps, and twice or so for a spacing.
Who may import it: the job.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hpcapp.applications.surface.cleaning import Cleaned
from hpcapp.applications.surface.cloud_regions import Region, cut_regions, take_region
from hpcapp.batches import Workforce, map_batches
from hpccomponent.surface import normals as normals_module
from hpccomponent.surface import outlier_regions
from hpccomponent.surface.arranged_cloud import ArrangedCloud, Points
from hpccomponent.surface.arrangement import Arrangement
from hpccomponent.surface.disk_cloud import DiskCloud, DiskCloudWriter
from hpccomponent.surface.lattice import cells_of, find_keys, pack_places
from hpccomponent.surface.normals import turn_region
from hpccomponent.surface.outlier_regions import Judgement, judge_region, judge_sparse, rank_region
from hpccomponent.surface.outliers import EDGE, ISLAND_LEVEL
from hpccomponent.surface.points import FloatArray, IntArray, bounding_box
from hpccomponent.surface.spacing import estimate_group_spacing

__all__ = ["REGION_POINTS", "clean_regions"]

REGION_POINTS = 1 << 21
"""In a region, without its margin: some 200 bytes each."""


@dataclass(frozen=True, slots=True, eq=False)
class _Kept:
    """An arranged cloud without the points in some cells; blocks are counted with these.

    Parameters
    ----------
    whole : ArrangedCloud
    spacing : float
        Of it, from which the cells follow.
    stray_cells, island_cells : ndarray of int64, shape (s,) and (i,)
        Sorted keys, see `Judgement`; either may be empty.
    """

    whole: ArrangedCloud
    spacing: float
    stray_cells: IntArray
    island_cells: IntArray

    @property
    def arrangement(self) -> Arrangement:
        return self.whole.arrangement

    @property
    def origin(self) -> FloatArray:
        return self.whole.origin

    @property
    def keys(self) -> IntArray:
        return self.whole.keys

    @property
    def counts(self) -> IntArray:
        return self.whole.counts

    @property
    def low(self) -> FloatArray:
        return self.whole.low

    @property
    def high(self) -> FloatArray:
        return self.whole.high

    def __len__(self) -> int:
        return len(self.whole)

    def take_blocks(self, keys: IntArray) -> Points:
        return self._drop(self.whole.take_blocks(keys))

    def groups(self, points: int) -> Iterator[Points]:
        for some in self.whole.groups(points):
            yield self._drop(some)

    def _drop(self, points: Points) -> Points:
        positions, normals = points
        if not (len(self.stray_cells) + len(self.island_cells)) or not len(positions):
            return points
        places = np.floor(cells_of(positions, self.whole.low, EDGE * self.spacing))
        cells = places.astype(np.int64)
        dropped = _are_among(self.stray_cells, pack_places(cells))
        dropped |= _are_among(self.island_cells, pack_places(cells >> ISLAND_LEVEL))
        return (positions[~dropped], normals[~dropped]) if dropped.any() else points


def clean_regions(
    cloud: ArrangedCloud, folder: Path, workforce: Workforce, points: int = REGION_POINTS
) -> tuple[DiskCloud, Cleaned]:
    """Do to a cloud, wherever it lies, what `cleaning.clean_cloud` does to one in memory.

    Parameters
    ----------
    cloud : ArrangedCloud
        Ten points or more.
    folder : Path
        Where the result is put: exists, and holds no other cloud.
    workforce : Workforce
        Each region is a task: `rank_region`, `judge_region`, `turn_region`.
    points : int
        In a region; the result does not depend on it.

    Returns
    -------
    cloud : DiskCloud
        The points that remain, bit for bit those that remain in memory.
    cleaned : Cleaned

    Raises
    ------
    InputError
        All points are the same.
    OutputError
        The disk is full, or the folder cannot be written.
    """
    regions = cut_regions(cloud.keys, cloud.counts, points)
    spacing = _measure_spacing(cloud, len(cloud), cloud.low, cloud.high, points)
    judged, strays = _find_outliers(cloud, regions, spacing, workforce)
    kept = _Kept(cloud, spacing, strays, judged.island_cells)
    remaining, low = len(cloud), cloud.low
    if len(strays) or len(judged.island_cells):
        remaining, low, high = _survey(kept, points)
        spacing = _measure_spacing(kept, remaining, low, high, points)
    writer = DiskCloudWriter(folder, cloud.arrangement, cloud.origin)
    flipped = 0
    margin = normals_module.MARGIN * spacing
    for wave in _waves(kept, regions, margin, workforce):
        batches = [(r.positions, r.normals, r.own, low, spacing) for r in wave]
        for region, turned in zip(wave, map_batches(workforce, turn_region, batches), strict=True):
            own = region.normals[region.own]
            writer.add(region.positions[region.own], np.where(turned[:, None], -own, own))
            flipped += int(np.count_nonzero(turned))
    return writer.finish(), Cleaned(len(cloud) - remaining, flipped)


def _find_outliers(
    cloud: ArrangedCloud, regions: list[IntArray], spacing: float, workforce: Workforce
) -> tuple[Judgement, IntArray]:
    """Return what the master judged, and the stray cells of all ranks."""
    run = _Run(cloud, spacing, workforce)
    ranked = run.map(regions, rank_region)
    judged = judge_sparse(ranked)
    asked = [
        blocks
        for blocks, (by_rank, *_) in zip(regions, ranked, strict=True)
        if by_rank[judged.base + 1 : -1].any()
    ]
    strays = [judged.stray_cells, *run.map(asked, judge_region, judged.base)]
    return judged, np.unique(np.concatenate(strays))


@dataclass(frozen=True, slots=True, eq=False)
class _Run:
    """Runs the tasks of outliers over regions."""

    cloud: ArrangedCloud
    spacing: float
    workforce: Workforce

    def map(self, regions: list[IntArray], task: Callable[..., Any], *more: int) -> list[Any]:
        """Return what a task says of each region, given more arguments."""
        found: list[Any] = []
        margin = outlier_regions.MARGIN * self.spacing
        for wave in _waves(self.cloud, regions, margin, self.workforce):
            batches = [(r.positions, r.own, self.cloud.low, self.spacing, *more) for r in wave]
            found += map_batches(self.workforce, task, batches)
        return found


def _waves(
    cloud: ArrangedCloud, regions: list[IntArray], margin: float, workforce: Workforce
) -> Iterator[list[Region]]:
    """Yield the regions' points, as many regions at once as there are workers."""
    for first in range(0, len(regions), workforce.workers):
        wave = regions[first : first + workforce.workers]
        yield [take_region(cloud, blocks, margin) for blocks in wave]


def _measure_spacing(
    cloud: ArrangedCloud, count: int, low: FloatArray, high: FloatArray, points: int
) -> float:
    return estimate_group_spacing(
        lambda: (positions for positions, _ in cloud.groups(points)), count, low, high
    )


def _survey(cloud: ArrangedCloud, points: int) -> tuple[int, FloatArray, FloatArray]:
    """Count and bound the points."""
    count, low, high = 0, np.full(3, np.inf), np.full(3, -np.inf)
    for positions, _ in cloud.groups(points):
        if len(positions):
            least, most = bounding_box(positions)
            low, high = np.minimum(low, least), np.maximum(high, most)
            count += len(positions)
    return count, low, high


def _are_among(keys: IntArray, asked: IntArray) -> Any:
    return find_keys(keys, asked) < len(keys) if len(keys) else np.zeros(len(asked), np.bool_)
