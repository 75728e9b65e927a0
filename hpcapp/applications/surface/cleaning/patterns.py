"""What the tasks that clean a cloud declare of their results."""

from __future__ import annotations

from typing import Any

import numpy as np

from hpcapp.applications.surface.cleaning.outlier_regions import LOCAL_RANK, RegionRanks
from hpcapp.applications.surface.cleaning.outliers import EDGE, ISLAND_LEVEL
from hpcapp.applications.surface.cloud.patterns import AssignedPoints
from hpcapp.applications.surface.cloud.regions import StoredBlocks
from hpcapp.applications.surface.scale.local_scale import HALVINGS
from hpcapp.applications.surface.scale.scan_lines import LineCounts
from hpcapp.applications.surface.types.result_patterns import UNIT, are_units
from hpcapp.geometry.points import FloatArray
from hpccomponent.protocol.columns import Bounds, pattern_of
from hpccomponent.protocol.declared import Declared, Either, Fixed, Nothing, Where, Whole


def without_points(points: StoredBlocks, *_: Any) -> Declared:
    """Return the pattern of what tasks write that drop points."""
    own = AssignedPoints.of(points)
    rest = Either(Nothing(), own.without_some(points.target))
    return Where(
        Fixed(rest, Whole(0, own.points)),
        lambda result: own.lacks(*result),
        "blocks lack the points that are dropped",
    )


def counted_lines(points: StoredBlocks, *_: Any) -> Declared:
    """Return the pattern of what `tasks.count_lines` counts."""
    own = AssignedPoints.of(points)
    cells = own.cells(own.arrangement.origin, own.arrangement.edge * 2.0**-HALVINGS)
    some = Bounds(total=(0, own.points))
    return Where(
        pattern_of(LineCounts, keys=cells, points=some, narrow=some),
        lambda counted: bool((counted.narrow <= counted.points).all()),
        "those along lines are among all",
    )


def ranked_region(points: StoredBlocks, low: FloatArray, spacing: float) -> Declared:
    """Return the pattern of what `tasks.rank_region` returns."""
    own, size = AssignedPoints.of(points), EDGE * spacing

    def agrees(found: RegionRanks) -> bool:
        sparse = np.bincount(found.sparse_ranks, found.sparse_counts, LOCAL_RANK + 2)
        is_whole = np.array_equal(sparse[LOCAL_RANK:], found.by_rank[LOCAL_RANK:])
        return is_whole and len(found.stray_keys) <= own.points

    ranks = pattern_of(
        RegionRanks,
        by_rank=Bounds(total=own.total),
        coarse_keys=own.cells(low, size * 2.0**ISLAND_LEVEL),
        coarse_counts=Bounds(total=own.total),
        sparse_keys=own.cells(low, size),
        sparse_counts=Bounds(total=(0, own.points)),
        stray_keys=own.cells(low, size),
    )
    return Where(
        ranks, agrees, "sparse cells have the points of high ranks, each stray one a point"
    )


def mended_region(points: StoredBlocks, *_: Any) -> Declared:
    """Return the pattern of what `tasks.mend_region` returns."""
    own = AssignedPoints.of(points)
    replaced = own.replaced(points.target, UNIT, are_units)
    return Where(
        Fixed(Either(Nothing(), replaced), Whole(0, own.points)),
        lambda result: (result[0] is None) == (result[1] == 0),
        "points are written where something of them has changed",
    )
