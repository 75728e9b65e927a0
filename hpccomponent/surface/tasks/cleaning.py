"""The tasks that clean a cloud region by region; each is a pure function of a region's points.

::

    blocks ── drop_repeated_points ──> without repeated points, where there were some
    region ── clean_blocks ── no sparse cells ── mended ──────────────────────> folder
                   │ sparse cells                                                 ^
                   └──> master ── judge_blocks ──> stray cells ── mend_blocks ────┘
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hpccomponent.runtime.tasks import declare
from hpccomponent.surface import kernels
from hpccomponent.surface.cloud import outlier_regions
from hpccomponent.surface.cloud.arrangement import PackedPoints, unpack_points
from hpccomponent.surface.cloud.disk import open_disk_cloud, write_part
from hpccomponent.surface.cloud.outlier_regions import (
    RegionRanks,
    has_sparse,
    judge_region,
    rank_region,
)
from hpccomponent.surface.cloud.regions import Region, RegionPoints, take_region
from hpccomponent.surface.cloud.repeated import find_repeated
from hpccomponent.surface.normals import consistency as normals
from hpccomponent.surface.tasks.cloud_patterns import (
    cleaned_region,
    mended_region,
    region_bytes,
    run_bytes,
    stray_cells,
    without_repeated,
)
from hpccomponent.surface.types.points import FloatArray, IntArray

Mended = tuple[PackedPoints | tuple[IntArray, IntArray] | None, int, FloatArray]
"""What `mend_blocks` returns."""

__all__ = ["MARGIN", "clean_blocks", "drop_repeated_points", "judge_blocks", "mend_blocks"]

MARGIN = max(outlier_regions.MARGIN, normals.MARGIN)
"""Spacings: as far as what decides over a point or over its normal lies."""


@declare(result=without_repeated, limit=run_bytes(16))
def drop_repeated_points(
    folder: str, blocks: IntArray, target: tuple[str, int]
) -> tuple[int, IntArray, IntArray]:
    """Write those of some blocks anew that have points at the place of another (a task).

    Parameters
    ----------
    folder : str
        Of a `DiskCloud`, which the worker sees.
    blocks : ndarray of int64, shape (k,)
        Sorted keys: all points at one place are in one block.
    target : tuple of (str, int)
        The folder, and the number of the part: see `disk.write_part`.

    Returns
    -------
    repeated : int
        Points that are left out; of each place the first stays.
    keys, counts : ndarray of int64, shape (b,)
        The blocks that were written, and the points in each.

    Raises
    ------
    OutputError
        The disk is full, or the folder cannot be written.
    """
    cloud = open_disk_cloud(Path(folder))
    packed = cloud.take_packed(blocks)
    repeated = find_repeated(unpack_points(cloud.arrangement, packed)[0])
    if not repeated.any():
        return 0, np.zeros(0, np.int64), np.zeros(0, np.int64)
    lost = np.add.reduceat(repeated, np.cumsum(packed.counts) - packed.counts, dtype=np.int64)
    is_changed = lost > 0
    rows = np.flatnonzero(np.repeat(is_changed, packed.counts) & ~repeated)
    left = PackedPoints.from_records(
        packed.keys[is_changed],
        (packed.counts - lost)[is_changed],
        packed.to_records().take(rows, axis=0),
    )
    return int(lost.sum()), *write_part(Path(target[0]), target[1], [left])


@declare(result=cleaned_region, limit=region_bytes(144))
def clean_blocks(
    points: RegionPoints,
    low: FloatArray,
    spacing: float,
    target: tuple[str, int] | None,
    sampled: tuple[float, int],
) -> tuple[RegionRanks, Mended | None]:
    """Rank the points of a region, and mend it if none of them are sparse (a task).

    Parameters
    ----------
    points : tuple
        `RegionPoints`, with a margin of `MARGIN` spacings.
    low, spacing, target, sampled
        As for `mend_blocks`.

    Returns
    -------
    ranks : tuple
        As `outlier_regions.rank_region` returns them.
    mended : tuple or None
        As `mend_blocks` returns it, if no point of the cloud is dropped; None where some of this
        region's may be.

    Raises
    ------
    OutputError
        The disk is full, or the folder cannot be written.
    """
    region = take_region(points)
    ranks = rank_region(region.positions, region.own, low, spacing)
    return ranks, None if has_sparse(ranks) else _mend(region, low, spacing, target, sampled)


@declare(result=stray_cells, limit=region_bytes(8))
def judge_blocks(points: RegionPoints, low: FloatArray, spacing: float, base: int) -> IntArray:
    """Find the stray cells of low ranks in a region (a task); see `outlier_regions.judge_region`.

    Parameters
    ----------
    points : tuple
        `RegionPoints`, with a margin of `outlier_regions.MARGIN` spacings.
    low, spacing, base
        As for `judge_region`, whose result this is.

    Returns
    -------
    ndarray of int64, shape (s,)
        Sorted keys of finest cells.
    """
    region = take_region(points)
    return judge_region(region.positions, region.own, low, spacing, base)


@declare(result=mended_region, limit=region_bytes(88))
def mend_blocks(
    points: RegionPoints,
    low: FloatArray,
    spacing: float,
    target: tuple[str, int] | None,
    sampled: tuple[float, int],
) -> Mended:
    """Turn round the wrong normals of a region, and write its points if any change (a task).

    Parameters
    ----------
    points : tuple
        `RegionPoints`, with a margin of `normals.MARGIN` spacings.
    low, spacing
        As for `normals.find_turned`.
    target : tuple of (str, int), or None
        The folder, and the number of the part: see `disk.write_part`. None where the worker
        does not see it.
    sampled : tuple of (float, int)
        The edge of boxes, and how many of them make one sampled: see `kernels.sample_boxes`.

    Returns
    -------
    packed : PackedPoints, tuple or None
        The points in its blocks, or if they were written only their keys and
        counts. None where they are what they were: nothing is written then.
    flipped : int
        Normals that were turned round.
    sample : ndarray of float64, shape (2, s, 3)
        Positions and normals of the points in the sample of boxes.

    Raises
    ------
    OutputError
        The disk is full, or the folder cannot be written.
    """
    return _mend(take_region(points), low, spacing, target, sampled)


def _mend(
    region: Region,
    low: FloatArray,
    spacing: float,
    target: tuple[str, int] | None,
    sampled: tuple[float, int],
) -> Mended:
    """Turn round the wrong normals of a region; see `mend_blocks`."""
    turned = normals.find_turned(region.positions, region.normals, low, spacing) & region.own
    rows = np.zeros(0, np.int64)
    if len(region.positions):
        rows = kernels.sample_boxes(region.positions, low, *sampled)
        rows = rows[region.own[rows]]
    signs = np.where(turned[rows], -1.0, 1.0)[:, None]
    mended = signs * region.packed.normals[region.rows[rows]]
    sample = np.stack([region.positions[rows], mended])
    flipped = int(np.count_nonzero(turned))
    if not (flipped or region.has_lost_own):
        return None, flipped, sample
    packed = region.pack_own(turned)
    if target is None:
        return packed, flipped, sample
    return write_part(Path(target[0]), target[1], [packed]), flipped, sample
