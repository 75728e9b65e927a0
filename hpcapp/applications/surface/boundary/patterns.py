"""What the tasks that cut a surface open declare of their results."""

from __future__ import annotations

from typing import Annotated, Any

from hpcapp.applications.surface.boundary.opening import OpeningSeams
from hpcapp.applications.surface.extraction.taken_bricks import TakenBricks
from hpcapp.applications.surface.tiles.patterns import (
    MOST_FACES,
    MOST_VERTICES,
    Exits,
    are_bounds,
    part_surface,
)
from hpcapp.applications.surface.types.result_patterns import (
    LENGTH,
    SMALL_BYTES,
    lie_in,
    lie_within,
    rise_by_pairs,
)
from hpcapp.geometry.points import FloatArray, IntArray
from hpccomponent.protocol.columns import Bounds, Column, pattern_of
from hpccomponent.protocol.declared import Declared, Exactly, Fixed, Nothing, Where, Whole

BarePlaces = Annotated[FloatArray, Column("k", 3, unit=LENGTH)]
"""The vertices that no point supports."""

_CUT_VERTICES, _CUT_FACES = MOST_VERTICES + 3 * MOST_FACES, 2 * MOST_FACES  # each face may be cut
_SENT_VERTEX, _KEPT_VERTEX = 256, 64  # bytes of an open part, for each vertex of the closed one


def opened_bytes(taken: TakenBricks, keep: tuple[str, str] | None) -> int:
    """Return how large what becomes of a part that is cut open may be, in bytes."""
    each = _SENT_VERTEX if keep is None else _KEPT_VERTEX
    return SMALL_BYTES + 1024 * len(taken.keys) + each * taken.vertices


def open_surface(taken: TakenBricks, keep: tuple[str, str] | None) -> Declared:
    """Return the pattern of what `tasks.open_part` returns, or keeps in a store by a name."""
    bricks = Bounds(agrees=taken.holds, rule="bricks are the part's own")
    most = _CUT_VERTICES, _CUT_FACES
    return part_surface(bricks, Bounds().of(Exits, {"exits": 0}), taken.box, most, keep)


def judged_support(
    _part: Any, taken: TakenBricks, _near: Any, _rule: Any, one_in: int, *_: Any
) -> Declared:
    """Return the pattern of what `tasks.judge_support` counts."""
    whole = int(taken.areas(one_in).sum())
    places = Bounds(
        agrees=lambda found: len(found) <= len(taken.keys) and lie_in(found, taken.box),
        rule="places lie in the surface's box, one a brick at most",
    )
    return Fixed(Whole(0, whole), Exactly(whole), places.of(BarePlaces))


def judged_bytes(taken: TakenBricks) -> int:
    """Return how large what `tasks.judge_support` returns may be, in bytes."""
    return SMALL_BYTES + 24 * len(taken.keys)


def opening_seams(
    _part: Any, taken: TakenBricks, _places: FloatArray, rim: IntArray, *_: Any
) -> Declared:
    """Return the pattern of what `tasks.survey_support` finds."""

    def agrees(seams: OpeningSeams) -> bool:
        patches, ends = len(seams.extents), seams.edges
        return (
            lie_within(seams.foreign_labels, -1, patches)
            and lie_within(seams.rim_labels, -1, patches)
            and patches <= taken.vertices + len(seams.foreign_bricks)
            and lie_within(ends[:, [1, 3]], 0, MOST_VERTICES)
            and lie_within(ends[:, 5], 0, _CUT_VERTICES)
            and taken.holds(ends[:, 4])
            and rise_by_pairs(seams.foreign_bricks, seams.foreign_numbers)
            and are_bounds(seams.extents, taken.box)
        )

    seams = pattern_of(
        OpeningSeams,
        {"r": len(rim)},
        foreign_numbers=Bounds(high=MOST_VERTICES - 1),
        rim_numbers=Bounds(high=_CUT_VERTICES - 1),
    )
    # Only what is kept is surveyed by others.
    return Fixed(Nothing(), Where(seams, agrees, "what it names lies in its bricks and patches"))
