"""What the tasks that give a cloud normals declare of their results."""

from __future__ import annotations

from hpcapp.applications.surface.cloud.patterns import UNIT, AssignedPoints
from hpcapp.applications.surface.cloud.regions import StoredBlocks
from hpcapp.applications.surface.kernels import SHEETS
from hpcapp.applications.surface.normals.patches import (
    CELL,
    LINKED,
    MARGIN,
    Links,
    Patches,
    Sides,
)
from hpcapp.applications.surface.types.result_patterns import (
    are_units,
    cells_in,
    lie_within,
    rise_by_pairs,
)
from hpcapp.geometry.points import FloatArray
from hpccomponent.protocol.declared import Declared, Fixed, Record, Where, Whole
from hpccomponent.protocol.declared_arrays import Array

CONFIDENCE_BINS = 100
"""Of the histogram of confidences."""

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
    bins = Array("<i8", CONFIDENCE_BINS, low=0, total=own.total)
    told = Array("<f4", own.points if tells else 0, low=0.0, high=1.0)
    return Fixed(replaced, Whole(0, own.points), bins, told)


def grouped_region(points: StoredBlocks, low: FloatArray, spacing: float) -> Declared:
    """Return the pattern of what `tasks.group_region` finds."""
    own, reach = AssignedPoints.of(points), 1.01 * MARGIN * spacing
    # Patches that the region's are linked to lie in its margin.
    box = own.box[0] - reach, own.box[1] + reach
    patches = Record(
        Patches,
        keys=cells_in("p", box, low, CELL * spacing, rises=False),
        ranks=Array("<i8", "p", low=0, high=SHEETS - 1),
        counts=Array("<i8", "p", low=1),
        centres=Array("<f8", "p", 3, low=box[0], high=box[1]),
        normals=Array("<f8", "p", 3, low=-UNIT, high=UNIT),
        noise=Array("<f8", "p", low=0.0, high=_MOST_NOISE * spacing * _ROUNDED),
    )
    contacts = Array("<i8", "l", low=1, total=(0, (LINKED + 1) * own.points))
    ends = Array("<i8", "l", low=0)
    return Where(
        Fixed(patches, Record(Links, first=ends, second=ends, contacts=contacts)),
        _are_linked,
        "patches and links are in their order, and these between those",
    )


def _are_linked(found: tuple[Patches, Links]) -> bool:
    patches, links = found
    return (
        rise_by_pairs(patches.keys, patches.ranks)
        and rise_by_pairs(links.first, links.second)
        and lie_within(links.second, 0, len(patches))
        and bool((links.first < links.second).all())
    )
