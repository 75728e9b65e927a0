"""What the tasks that clean a cloud declare of their results."""

from __future__ import annotations

from typing import Any

import numpy as np

from hpcapp.applications.surface.cleaning.outlier_regions import LOCAL_RANK
from hpcapp.applications.surface.cleaning.outliers import EDGE, ISLAND_LEVEL
from hpcapp.applications.surface.cloud.patterns import UNIT, AssignedPoints
from hpcapp.applications.surface.cloud.regions import StoredBlocks
from hpcapp.applications.surface.scale.local_scale import HALVINGS
from hpcapp.applications.surface.types.result_patterns import are_units
from hpcapp.geometry.points import FloatArray
from hpccomponent.protocol.declared import Declared, Either, Fixed, Nothing, Where, Whole
from hpccomponent.protocol.declared_arrays import Array


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
    cells = own.cells("c", own.arrangement.origin, own.arrangement.edge * 2.0**-HALVINGS)
    counts = (Array("<i8", "c", low=low, total=(0, own.points)) for low in (1, 0))
    return Where(
        Fixed(cells, *counts),
        lambda counted: bool((counted[2] <= counted[1]).all()),
        "those along lines are among all",
    )


def ranked_region(points: StoredBlocks, low: FloatArray, spacing: float) -> Declared:
    """Return the pattern of what `tasks.rank_region` returns."""
    own, size = AssignedPoints.of(points), EDGE * spacing

    def agrees(ranks: tuple[Any, ...]) -> bool:
        by_rank, sparse_ranks, sparse_counts = ranks[0], ranks[4], ranks[5]
        sparse = np.bincount(sparse_ranks, sparse_counts, LOCAL_RANK + 2)
        return np.array_equal(sparse[LOCAL_RANK:], by_rank[LOCAL_RANK:])

    by_rank = Array("<i8", LOCAL_RANK + 2, low=0, total=own.total)
    counts = Array("<i8", "coarse", low=1, total=own.total)
    coarse = own.cells("coarse", low, size * 2.0**ISLAND_LEVEL)
    sparse_ranks = Array("<i8", "sparse", low=LOCAL_RANK, high=LOCAL_RANK + 1)
    sparse_counts = Array("<i8", "sparse", low=1, total=(0, own.points))
    sparse = own.cells("sparse", low, size), sparse_ranks, sparse_counts
    return Where(
        Fixed(by_rank, coarse, counts, *sparse),
        agrees,
        "sparse cells have the points of high ranks",
    )


def stray_cells(points: StoredBlocks, low: FloatArray, spacing: float, _base: int) -> Declared:
    """Return the pattern of what `tasks.judge_region` finds."""
    own = AssignedPoints.of(points)
    return Where(
        own.cells("s", low, EDGE * spacing),
        lambda cells: len(cells) <= own.points,
        "each cell holds a point",
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
