"""The tasks that cut a closed surface open where no point supports it, part by part.

::

    judge_support    some vertices of a part, points ──> those that none supports    ──> master
    survey_support   part, points ──> patches, cuts                                  ──> master
    open_part        part, what the master has decided ──> open part, its summary
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hpcapp.applications.surface.boundary.clearance import SupportRule, find_bare, measure_clearance
from hpcapp.applications.surface.boundary.opening import (
    OpeningSeams,
    OpeningSurvey,
    cut_opening,
    drop_copies,
    survey_opening,
)
from hpcapp.applications.surface.boundary.patterns import (
    BarePlaces,
    judged_bytes,
    judged_support,
    open_surface,
    opened_bytes,
    opening_seams,
)
from hpcapp.applications.surface.cloud.arranged import Place
from hpcapp.applications.surface.cloud.cutting import cut_even
from hpcapp.applications.surface.cloud.folder.disk import open_place
from hpcapp.applications.surface.extraction.part_places import starts_of
from hpcapp.applications.surface.extraction.parts import MeshPart
from hpcapp.applications.surface.extraction.summary import PartSummary
from hpcapp.applications.surface.extraction.taken_bricks import TakenBricks
from hpcapp.applications.surface.tiles.patterns import Exits
from hpcapp.applications.surface.tiles.tasks import give_part
from hpcapp.geometry.lattice import find_keys
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray, PointCloud
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.records import record
from hpccomponent.runtime.tasks import declare
from hpccomponent.store.places import hold_store

_POINTS_AT_ONCE = 1 << 19  # with what a search makes of them, 80 MB

Part = MeshPart | tuple[str, str]
"""A part, or a store (see `store.places`) and the name under which it is there."""


@record("surface.near_points")
@dataclass(frozen=True, slots=True, eq=False)
class Near:
    """Points that a task reads where the cloud is: a folder that it sees, or the cloud itself.

    `blocks` are sorted keys of the cloud's; the points that matter lie in a `box` (2, 3), in length
    units of the input.
    """

    cloud: Place
    blocks: IntArray
    box: FloatArray

    def read(self) -> PointCloud:
        """Return the points."""
        return self._take(self.blocks)

    def read_pieces(self) -> Iterator[PointCloud]:
        """Yield the points, block after block, about `_POINTS_AT_ONCE` at a time."""
        cloud = open_place(self.cloud)
        counts = np.append(cloud.counts, 0)[find_keys(cloud.keys, self.blocks)]
        for run in (
            cut_even(counts, -(-int(counts.sum()) // _POINTS_AT_ONCE)) if len(counts) else ()
        ):
            yield self._take(self.blocks[run])

    def _take(self, blocks: IntArray) -> PointCloud:
        return PointCloud(*open_place(self.cloud).take_within(blocks, *self.box))


@declare(result=judged_support, limit=lambda _part, taken, *_: judged_bytes(taken))
def judge_support(
    part: Part, taken: TakenBricks, near: Near, rule: SupportRule, one_in: int, threads: int = 1
) -> tuple[int, int, BarePlaces]:
    """Tell how much of a part no point supports, by a vertex of some of its bricks (a task).

    One in so many bricks is looked at; `near` has all points within the rule's reach of them.
    Returns the areas without support and of all (see `TakenBricks.areas`), and the bare places.
    """
    held = _hold(part)
    areas = np.zeros(len(held.vertex_counts), np.int64)
    areas[taken.mark(held)] = taken.areas(one_in)
    first = starts_of(held.vertex_counts)[:-1][areas > 0]
    places = held.vertices[first]
    bare = find_bare(places, near.read_pieces(), rule, threads)
    return int(areas[areas > 0][bare].sum()), int(areas.sum()), places[bare]


@declare(result=opening_seams, limit=lambda _part, taken, *_: opened_bytes(taken, None))
def survey_support(
    part: Part,
    taken: TakenBricks,
    places: FloatArray,
    rim: IntArray,
    near: Near,
    rule: SupportRule,
    keep: tuple[str, str] | None = None,
    threads: int = 1,
) -> tuple[OpeningSurvey | None, OpeningSeams]:
    """Find where the points' support of a part ends (a task).

    `places` (g, 3) are where its foreign vertices are, `rim` (r,) rows of its vertices that other
    parts may name, and `near` has all points within the rule's reach of the vertices. With `keep`,
    a store and a name, the survey is put there; it is None here.
    """
    held = _hold(part)
    is_taken = taken.mark(held)
    own = np.append(np.repeat(is_taken, held.vertex_counts), False)
    # (r,): rows among the vertices that the part gives; -1 for those that another one does.
    rows = np.where(own[rim], np.cumsum(own)[rim] - 1, -1)
    held, places = drop_copies(held, is_taken, places)
    all_places = np.concatenate([held.vertices, places])
    clearances = measure_clearance(all_places, near.read(), rule, threads)
    survey, seams = survey_opening(held, places, clearances, rows)
    if keep is None:
        return survey, seams
    place, name = keep
    hold_store(place).put(name, survey)
    return None, seams


@declare(
    result=lambda _part, taken, _survey, _decided, keep=None: open_surface(taken, keep),
    limit=lambda _part, taken, _survey, _decided, keep=None: opened_bytes(taken, keep),
)
def open_part(
    part: Part,
    taken: TakenBricks,
    survey: OpeningSurvey | tuple[str, str],
    decided: tuple[BoolArray, IntArray, IntArray],
    keep: tuple[str, str] | None = None,
) -> tuple[MeshPart | None, PartSummary, Exits]:
    """Cut a part open (a task); it is returned as `mesh_tile` does, without exits.

    The survey is itself, or a store and its name there. `decided` are which patches stay, numbers
    of foreign vertices, and names of the cuts through edges with one face (see `cut_opening`). With
    `keep`, a store and a name, the result is put there.
    """
    if isinstance(survey, tuple):
        survey = _take_survey(*survey)
    # The survey knows where the foreign vertices of what is left are: those of the part need not.
    held = _hold(part)
    held, _ = drop_copies(held, taken.mark(held), np.zeros((len(held.foreign_bricks), 3)))
    return give_part(cut_opening(held, survey, *decided), np.empty(0, np.int64), keep)


def _take_survey(place: str, name: str) -> OpeningSurvey:
    kept: OpeningSurvey = hold_store(place).get(name)
    return kept


def _hold(part: Part) -> MeshPart:
    if isinstance(part, MeshPart):
        return part
    place, name = part
    held: MeshPart = hold_store(place).get(name)[0]
    return held
