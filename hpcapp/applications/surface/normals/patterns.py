"""What the tasks that give a cloud normals declare of their results."""

from __future__ import annotations

from typing import Annotated

from hpcapp.applications.surface.cloud.patterns import AssignedPoints
from hpcapp.applications.surface.cloud.regions import StoredBlocks
from hpcapp.applications.surface.normals.facets import Facets
from hpcapp.applications.surface.normals.patches import CELL, LINKED, MARGIN, Links, Patches, Sides
from hpcapp.applications.surface.types.result_patterns import (
    UNIT,
    are_units,
    cells_in,
    lie_within,
    rise_by_pairs,
)
from hpcapp.geometry.points import Float32Array, FloatArray, IntArray
from hpccomponent.protocol.columns import ANY, Bounds, Column, pattern_of
from hpccomponent.protocol.declared import Declared, Fixed, Where, Whole

CONFIDENCE_BINS = 100
"""Of the histogram of confidences."""

Confidences = Annotated[IntArray, Column(CONFIDENCE_BINS, low=0)]
"""How many points have a confidence of 0 to 0.01, 0.01 to 0.02 ..."""

Sureness = Annotated[Float32Array, Column("m", low=0.0, high=1.0)]
"""How sure the sides of a region's own points are."""

_MOST_NOISE = 24.0  # spacings: twice as far as the neighbours that it is told by
_ROUNDED = 1.0 + 1e-6  # what is a mean may lie as much further out


def estimated_region(
    points: StoredBlocks, _low: FloatArray, spacing: float, _keeps: bool
) -> Declared:
    """Return the pattern of what `tasks.estimate_region` returns."""
    own = AssignedPoints.of(points)
    return Fixed(own.replaced(points.target, _MOST_NOISE * spacing, is_all=True))


def turned_region(
    points: StoredBlocks, _low: FloatArray, _spacing: float, _sides: Sides, tells: bool
) -> Declared:
    """Return the pattern of what `tasks.turn_region` returns."""
    own = AssignedPoints.of(points)
    replaced = own.replaced(points.target, UNIT, are_units, is_all=True)
    sureness = ANY.of(Sureness, {"m": own.points if tells else 0})
    return Fixed(replaced, Whole(0, own.points), Bounds(total=own.total).of(Confidences), sureness)


def grouped_region(points: StoredBlocks, low: FloatArray, spacing: float) -> Declared:
    """Return the pattern of what `tasks.group_region` finds."""
    own, reach = AssignedPoints.of(points), 1.01 * MARGIN * spacing
    # Patches that the region's are linked to lie in its margin.
    box = own.box[0] - reach, own.box[1] + reach
    patches = pattern_of(
        Patches,
        keys=cells_in(box, low, CELL * spacing),
        centres=Bounds(*box),
        noise=Bounds(high=_MOST_NOISE * spacing * _ROUNDED),
    )
    contacts = Bounds(total=(0, (LINKED + 1) * own.points))
    return Where(
        Fixed(patches, pattern_of(Links, contacts=contacts)),
        _are_linked,
        "patches and links are in their order, and these between those",
    )


def summed_region(points: StoredBlocks, low: FloatArray, edge: float) -> Declared:
    """Return the pattern of what `tasks.sum_region` returns."""
    own = AssignedPoints.of(points)
    found = pattern_of(Facets, keys=cells_in(own.box, low, edge))
    return Where(
        found,
        lambda facets: float(facets.sums[:, :, 0].sum()) == own.points,
        "all points are counted, each once",
    )


def _are_linked(found: tuple[Patches, Links]) -> bool:
    patches, links = found
    return (
        rise_by_pairs(patches.keys, patches.ranks)
        and rise_by_pairs(links.first, links.second)
        and lie_within(links.second, 0, len(patches))
        and bool((links.first < links.second).all())
    )
