"""What the tasks that look at a range of a file declare of their results."""

from __future__ import annotations

from typing import Any

import numpy as np

from hpcapp.applications.surface.types.result_patterns import (
    BOX,
    SMALL_BYTES,
    bounds_some,
    keys_within,
    lie_in,
)
from hpcapp.geometry.points import FloatArray
from hpcapp.geometry.validity import Reach
from hpccomponent.protocol.declared import Declared, Fixed, Where, Whole
from hpccomponent.protocol.declared_arrays import Array

_BLOCKS = 66  # along each side of an arrangement, at most: see `choose_arrangement`
_SPARE = 4  # on either side: the box is what others have told of the file, and may be a little off


def range_bytes(points: Any, *_: Any) -> int:
    """Return how large what is found in a range of a file may be."""
    return SMALL_BYTES + 64 * len(points)


def surveyed_range(points: Any, before: int, step: int) -> Declared:
    """Return the pattern of what `tasks.survey_range` finds."""
    some = Whole(0, len(points))

    def agrees(found: tuple[Any, ...]) -> bool:
        usable, non_finite, bad_normals, frame, box, sample = found
        return (
            usable + non_finite + bad_normals == len(points)
            and len(sample) == len(range(-before % step, usable, step))
            and bounds_some(frame, usable + bad_normals)
            and bounds_some(box, usable)
            and (not usable or lie_in(box, frame))
            and (not len(sample) or lie_in(sample, box))
        )

    pattern = Fixed(some, some, some, BOX, BOX, Array("<f8", "s", 3))
    return Where(pattern, agrees, "all points count, and those of the sample lie in the boxes")


def bounded_range(points: Any, _origin: FloatArray, reach: Reach) -> Declared:
    """Return the pattern of what `tasks.bound_range` finds."""
    return Where(
        Fixed(Whole(0, len(points)), BOX),
        lambda found: bounds_some(found[1], found[0]) and (not found[0] or reach.holds(*found[1])),
        "the box lies in reach",
    )


def arranged_range(points: Any, *_: Any) -> Declared:
    """Return the pattern of what `tasks.arrange_range` writes."""
    first, last = (np.full(3, place) for place in (-_SPARE, _BLOCKS + _SPARE))
    counts = Array("<i8", "b", low=1, total=(0, len(points)))
    return Fixed(keys_within("b", first, last), counts)
