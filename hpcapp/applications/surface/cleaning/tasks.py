"""The tasks that clean a cloud region by region; each is a pure function of a region's points.

::

    region ── drop_repeated ──> without repeated points
    region ── count_lines ──> master ── thin_lines ──> without points that scan lines can spare
    region ── rank_region ──> master ── stray cells ── drop_cells ──> without them
    region ── drop_strays ──> without points that lie apart from their neighbours
    region ── drop_lone_lines ──> without points along wires
    region ── mend_region ──> inconsistent normals flipped
"""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface.cleaning import outlier_regions as outliers
from hpcapp.applications.surface.cleaning.lone_lines import find_lone_lines
from hpcapp.applications.surface.cleaning.outlier_regions import DroppedCells, RegionRanks
from hpcapp.applications.surface.cleaning.patterns import (
    counted_lines,
    mended_region,
    ranked_region,
    without_points,
)
from hpcapp.applications.surface.cleaning.repeated import find_repeated
from hpcapp.applications.surface.cleaning.strays import find_strays
from hpcapp.applications.surface.cloud.patterns import region_bytes
from hpcapp.applications.surface.cloud.regions import RegionPoints, Replaced
from hpcapp.applications.surface.normals.consistency import find_flipped
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.applications.surface.scale.scan_lines import (
    GapBoxes,
    LineCounts,
    count_narrow,
    find_spare,
)
from hpcapp.geometry.points import FloatArray
from hpccomponent.runtime.tasks import declare


@declare(result=without_points, limit=region_bytes(16))
def drop_repeated(points: RegionPoints) -> tuple[Replaced | None, int]:
    """Drop the points at the place of another before them (a task); return how many, too."""
    region = points.take()
    repeated = find_repeated(region.positions)
    return region.drop(repeated), int(np.count_nonzero(repeated))


@declare(result=counted_lines, limit=region_bytes(24))
def count_lines(points: RegionPoints, boxes: GapBoxes) -> LineCounts:
    """Count a region's points that lie along lines (a task); see `count_narrow`."""
    return count_narrow(points.take().positions, boxes)


@declare(result=without_points, limit=region_bytes(16))
def thin_lines(points: RegionPoints, boxes: GapBoxes) -> tuple[Replaced | None, int]:
    """Drop the points that scan lines can spare (a task); return how many, too."""
    region = points.take()
    spare = find_spare(region.positions, boxes)
    return region.drop(spare), int(np.count_nonzero(spare))


@declare(result=ranked_region, limit=region_bytes(72))
def rank_region(points: RegionPoints, low: FloatArray, spacing: float) -> RegionRanks:
    """Rank the points of a region with a margin of `outlier_regions.MARGIN` spacings (a task)."""
    region = points.take()
    return outliers.rank_region(region.positions, region.own, low, spacing)


@declare(result=without_points, limit=region_bytes(16))
def drop_cells(points: RegionPoints, cells: DroppedCells) -> tuple[Replaced | None, int]:
    """Drop the points in some cells (a task); return how many, too."""
    region = points.take()
    dropped = ~cells.find_kept(region.positions)
    return region.drop(dropped), int(np.count_nonzero(dropped))


@declare(result=without_points, limit=region_bytes(40))
def drop_strays(
    points: RegionPoints, low: FloatArray, scale: LocalScale
) -> tuple[Replaced | None, int]:
    """Drop the strays of a region with `strays.MARGIN` around it (a task); return how many, too."""
    region = points.take()
    dropped = find_strays(region.positions, region.own, low, scale, region.threads)
    return region.drop(dropped), int(np.count_nonzero(dropped))


@declare(result=without_points, limit=region_bytes(40))
def drop_lone_lines(
    points: RegionPoints, low: FloatArray, spacing: float
) -> tuple[Replaced | None, int]:
    """Drop points on lone lines, with `lone_lines.MARGIN` around (a task); return how many, too."""
    region = points.take()
    dropped = find_lone_lines(region.positions, region.own, low, spacing)
    return region.drop(dropped), int(np.count_nonzero(dropped))


@declare(result=mended_region, limit=region_bytes(40))
def mend_region(
    points: RegionPoints, low: FloatArray, spacing: float
) -> tuple[Replaced | None, int]:
    """Turn round the inconsistent normals of a region (a task); return how many, too.

    It has a margin of `consistency.MARGIN` spacings.
    """
    region = points.take()
    given = region.positions, region.normals, low, spacing, region.threads
    is_flipped = find_flipped(*given)[region.own]
    return region.flip(is_flipped), int(np.count_nonzero(is_flipped))
