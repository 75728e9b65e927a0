"""What the tasks that look at a range of a file declare of their results."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from hpcapp.applications.surface.types.result_patterns import (
    CORNERS,
    LENGTH,
    SMALL_BYTES,
    CellCounts,
    CellKeys,
    Corners,
    bounds_some,
    keys_within,
    lie_in,
)
from hpcapp.geometry.points import FloatArray
from hpcapp.geometry.validity import Reach
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.columns import Bounds, Column, pattern_of
from hpccomponent.protocol.declared import Declared, Fixed, Where, Whole
from hpccomponent.protocol.records import record

_BLOCKS = 66  # along each side of an arrangement, at most: see `choose_arrangement`
_SPARE = 4  # on either side: the box is what others have told of the file, and may be a little off


@record("surface.range_survey")
@dataclass(frozen=True, slots=True, eq=False)
class RangeSurvey:
    """How many points of each kind are in a range of a file, and where; s in the sample."""

    usable: int
    non_finite: int
    bad_normals: int
    frame: Corners
    """Around the points with finite positions."""
    box: Corners
    """Around the usable ones."""
    sample: Annotated[FloatArray, Column("s", 3, unit=LENGTH)]
    """Every so many-th usable point of the file."""


def range_bytes(points: Any, *_: Any) -> int:
    """Return how large what is found in a range of a file may be."""
    return SMALL_BYTES + 64 * len(points)


def surveyed_range(points: Any, before: int, step: int) -> Declared:
    """Return the pattern of what `tasks.survey_range` finds."""
    some = Whole(0, len(points))

    def agrees(found: RangeSurvey) -> bool:
        usable = found.usable
        return (
            points.counts_all(usable + found.non_finite + found.bad_normals)
            and len(found.sample) == len(range(-before % step, usable, step))
            and bounds_some(found.frame, usable + found.bad_normals)
            and bounds_some(found.box, usable)
            and (not usable or lie_in(found.box, found.frame))
            and (not len(found.sample) or lie_in(found.sample, found.box))
        )

    pattern = pattern_of(RangeSurvey, usable=some, non_finite=some, bad_normals=some)
    return Where(pattern, agrees, "all points count, and those of the sample lie in the boxes")


def bounded_range(points: Any, _origin: FloatArray, reach: Reach) -> Declared:
    """Return the pattern of what `tasks.bound_range` finds."""
    return Where(
        Fixed(Whole(0, len(points)), CORNERS),
        lambda found: bounds_some(found[1], found[0]) and (not found[0] or reach.holds(*found[1])),
        "the box lies in reach",
    )


def arranged_range(points: Any, *_: Any) -> Declared:
    """Return the pattern of what `tasks.arrange_range` writes."""
    first, last = (np.full(3, place) for place in (-_SPARE, _BLOCKS + _SPARE))
    counts = Bounds(total=(0, len(points))).of(CellCounts)
    return Fixed(keys_within(first, last).of(CellKeys), counts)
