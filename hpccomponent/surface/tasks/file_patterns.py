"""What the tasks that look at a range of a file declare of their results."""

from __future__ import annotations

from typing import Any

import numpy as np

from hpccomponent.protocol.declared import Array, Declared, EachOf, Fixed, Where, Whole
from hpccomponent.surface.cloud.arrangement import Arrangement
from hpccomponent.surface.cloud.validity import Reach
from hpccomponent.surface.tasks.result_patterns import (
    BOX,
    SMALL_BYTES,
    bounds_some,
    cells_in,
    is_share,
    keys_within,
    lie_in,
    sampled_boxes,
)
from hpccomponent.surface.types.points import FloatArray

__all__ = ["arranged_range", "bounded_range", "range_bytes", "surveyed_range"]

_BLOCKS = 66  # along each side of an arrangement, at most: see `choose_arrangement`
_SPARE = 4  # on either side: the box is what others have told of the file, and may be a little off


def range_bytes(points: Any, *_: Any) -> int:
    """Return how large what is found in a range of a file may be."""
    return SMALL_BYTES + 64 * len(points)


def surveyed_range(points: Any, before: int, step: int) -> Declared:
    """Return the pattern of what `file_ranges.survey_range` finds."""
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
    """Return the pattern of what `file_ranges.bound_range` finds."""
    return Where(
        Fixed(Whole(0, len(points)), BOX),
        lambda found: bounds_some(found[1], found[0]) and (not found[0] or reach.holds(*found[1])),
        "the box lies in reach",
    )


def arranged_range(
    points: Any,
    _origin: FloatArray,
    _reach: Reach | None,
    arrangement: Arrangement,
    _target: tuple[str, int],
    boxes: tuple[FloatArray, tuple[float, ...], int],
) -> Declared:
    """Return the pattern of what `file_ranges.arrange_range` writes."""
    (low, edges, one_in), most = boxes, len(points)
    first, last = (np.full(3, place) for place in (-_SPARE, _BLOCKS + _SPARE))
    box = np.stack([arrangement.origin + arrangement.edge * place for place in (first, last + 1)])
    counted = [sampled_boxes(most, cells_in("c", box, low, edge)) for edge in edges]
    counts = Array("<i8", "b", low=1, total=(0, most))
    return Where(
        Fixed(keys_within("b", first, last), counts, EachOf(counted)),
        lambda found: all(is_share(int(found[1].sum()), one_in, n) for n, _ in found[2]),
        "the boxes hold points of the blocks",
    )
