"""Whether a surface stays closed, and how it is cut open where no point supports it.

::

    closed surface ── judge_support ──> share without support ── large? ──> stays closed
                                                                  │ yes
    parts ── survey_support ──> patches, seams ── join, match ──> open_part ──> open surface

All is decided from what holds for the whole cloud, so neither tiles nor workers change a bit of it.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from hpcapp.applications.surface.boundary.clearance import SupportRule
from hpcapp.applications.surface.boundary.closing import say_closing, weigh_open
from hpcapp.applications.surface.boundary.lengths import Length
from hpcapp.applications.surface.boundary.opening import OpeningSeams, OpeningSurvey
from hpcapp.applications.surface.boundary.seams import MatchedSeams, match_seams, place_foreign
from hpcapp.applications.surface.boundary.support import Support, measure_support
from hpcapp.applications.surface.boundary.tasks import (
    Near,
    judge_support,
    open_part,
    survey_support,
)
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.cloud.block_hashes import BlockHashes
from hpcapp.applications.surface.extraction.parts import MeshPart
from hpcapp.applications.surface.extraction.summary import PartSummary
from hpcapp.applications.surface.extraction.taken_bricks import TakenBricks
from hpcapp.applications.surface.methods.method import Advance
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.applications.surface.stitching.surface import Surface
from hpcapp.applications.surface.tiles.checkpoint import Checkpoint
from hpcapp.applications.surface.tiles.halo import mark_near
from hpcapp.applications.surface.tiles.patterns import surface_box
from hpcapp.applications.surface.tiles.plan import TilePlan
from hpcapp.geometry.lattice import pack_places, unique_keys, unpack_keys
from hpcapp.geometry.points import IntArray
from hpcapp.kernels.types.grid import BRICK
from hpcapp.wording import say_count
from hpcapp.workforce import Workforce, stream_batches
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError
from hpccomponent.protocol.declared import ANYTHING

log = logging.getLogger("hpcapp")

_SPACINGS, _NOISES, _STEPS = 3.0, 4.0, 1.5  # of the trim distance that is chosen
_FILL = 4.0  # times the trim distance: patches that fill holes
_CRUMB = 2.5  # times the trim distance: pieces smaller than a square of this are dropped. What
# grows around a clump of 8 to 40 strays may be larger than one of 2; it is smaller than one of 2.5.
_JUDGED_BRICKS = 20_000  # about: of larger surfaces a sample
_FACES = 2.0  # of a piece as large as the side of a cell
_STEPS_OF_PART = 3  # it is judged, surveyed and cut, or less


@dataclass(frozen=True, slots=True)
class OpeningSettings:
    """What a user asks of the borders of the surface.

    `close` is ``auto``, ``yes`` or ``no``; a length is None where it is to be chosen.
    """

    close: str = "yes"
    trim: Length | None = None
    fill_holes: Length | None = None

    @property
    def is_asked(self) -> bool:
        """Whether the surface is to be open whatever the points are."""
        return self.close == "no" or (self.close == "auto" and self.trim is not None)


@dataclass(frozen=True, slots=True)
class Closure:
    """How the borders of a surface came about.

    `trim` and `fill_holes` are in length units of the input, 0 where nothing was cut; `holes` were
    filled, and `crumbs`, small pieces, dropped. The `certainty` is the probability that it is as it
    was decided; 1 where somebody has asked for it. `unsupported` is the share of the closed surface
    that no point supports, None where nobody has looked, as is the `support` of a closed one.
    """

    is_open: bool
    reason: str
    trim: float = 0.0
    fill_holes: float = 0.0
    holes: int = 0
    crumbs: int = 0
    certainty: float = 1.0
    unsupported: float | None = None
    support: Support | None = None

    def facts(self) -> dict[str, Any]:
        """Return it for the report: JSON values."""
        decided = {
            "open": self.is_open,
            "closure": self.reason,
            "closure_certainty": self.certainty,
            "unsupported": self.unsupported,
        }
        if not self.is_open:
            return decided | ({} if self.support is None else {"support": asdict(self.support)})
        return decided | {
            "trim": self.trim,
            "fill_holes": self.fill_holes,
            "holes_filled": self.holes,
            "crumbs": self.crumbs,
        }


@dataclass(frozen=True, slots=True, eq=False)
class _ClosedParts:
    """The parts of a closed surface, and where their tasks run.

    `shared` is where workers see both the parts and the points; None where tasks run here.
    """

    surface: Surface
    cloud: ArrangedCloud
    plan: TilePlan
    workforce: Workforce
    shared: Checkpoint | None
    threads: int
    hashes: BlockHashes

    def __len__(self) -> int:
        return len(self.surface.parts)

    def taken(self, index: int) -> TakenBricks:
        """Return which of its bricks a part gives."""
        summary, bricks = self.surface.summaries[index], self.surface.plan.bricks
        rows = np.flatnonzero(bricks.is_taken[bricks.of_part(index)])
        box = np.stack(surface_box(self.plan))
        keys, strides = summary.bricks[rows], self.plan.strides
        exponents = np.zeros(len(keys), np.uint8) if strides is None else strides.at(keys)
        return TakenBricks(keys, summary.vertex_counts[rows], exponents, box)

    def part(self, index: int) -> MeshPart | tuple[Any, Any]:
        """Return a part as a task is given it."""
        if self.shared is not None:
            return self.shared.place, self.surface.parts[index]
        return self.surface.load(index)

    def near(self, bricks: IntArray, reach: float) -> Near:
        """Return the points within reach of what a part gives in bricks of some keys (k,)."""
        blocks, keys, edge = self.cloud.arrangement, self.cloud.keys, BRICK * self.plan.step
        if not len(bricks):
            return Near(self.cloud.place, keys[:0], np.zeros((2, 3)))
        # What a part names of others lies in the next cell, which is a brick at most; points
        # beyond change nothing.
        margin = reach + 2.0 * edge
        low = self.plan.grid_origin + edge * unpack_keys(bricks) - margin  # (k, 3)
        high = low + edge + 2.0 * margin
        # From which block to which each brick reaches; the widest box serves all.
        places = unpack_keys(keys)
        ends = places.min(axis=0), places.max(axis=0)
        first, last = (
            np.floor((some - blocks.origin) / blocks.edge).clip(*ends).astype(np.int64)
            for some in (low, high)
        )
        boxes = unique_keys(pack_places(first))
        is_near = mark_near(keys, boxes, 0, (last - first).max(axis=0))
        return Near(self.cloud.place, keys[is_near], np.stack([low.min(axis=0), high.max(axis=0)]))

    def run(
        self,
        task: Callable[..., Any],
        given: Callable[[int], tuple[Any, ...]],
        more: Callable[[str], tuple[Any, ...]],
        is_whole: Callable[[str], bool] = lambda _: True,
        *,
        is_returned: bool = True,
    ) -> Iterator[tuple[int, str, Any]]:
        """Run a task for each part, on the workers or right here, and yield what comes of it.

        The task is called with the part, with what is `given` of it, which decides the result, and
        with what follows from the result's name, which is yielded, too. Where jobs of other scans
        have left the result, and what lies beside it `is_whole`, that is taken; all that
        `is_returned` is left for them, the rest they find where it is kept.
        """
        names: list[str] = []
        started: list[int] = []
        found: list[tuple[int, str, Any]] = []

        def batches() -> Iterator[tuple[Any, ...]]:
            for index in range(len(self)):
                arguments = given(index)
                names.append(name := self._name(task, index, arguments))
                if (kept := self._find(name, is_whole)) is not None:
                    found.append((index, name, kept if is_returned else (None, *kept[1:])))
                    continue
                started.append(index)
                yield self.part(index), *arguments, *more(name)

        if self.shared is not None:
            made = stream_batches(self.workforce, task, batches(), 2 * self.workforce.workers)
        else:
            made = ((batch, task(*arguments)) for batch, arguments in enumerate(batches()))
        for batch, result in made:
            index = started[batch]
            if is_returned:
                self._keep(names[index], result)
            yield index, names[index], result
        yield from found

    def _name(self, task: Callable[..., Any], index: int, given: tuple[Any, ...]) -> str:
        """Return the name of what a task makes of a part; empty where the part has none."""
        checkpoint, part = self.surface.checkpoint, self.surface.parts[index]
        if checkpoint is None or not isinstance(part, str):
            return ""
        if not checkpoint.recipe:  # the part is of this job, and so is what is made of it
            return checkpoint.name_beside(part, task.__name__)
        told = (self._tell(value) for value in given)
        return checkpoint.name(task.__name__, part, *told)

    def _tell(self, value: Any) -> Any:
        """Return what tells a value from others: of points what they are, not where."""
        if isinstance(value, Near):
            return *self.hashes.of(value.blocks), value.box
        match value:
            case (str(), str(name)):  # of what is kept its name, not its place
                return name
        return value

    def _find(self, name: str, is_whole: Callable[[str], bool]) -> Any | None:
        """Return what jobs of other scans have left of a result."""
        checkpoint = self.surface.checkpoint
        if checkpoint is None or not checkpoint.recipe or not name or not is_whole(name):
            return None
        return checkpoint.find(name, ANYTHING)

    def _keep(self, name: str, result: Any) -> None:
        """Leave a result for jobs of other scans."""
        checkpoint = self.surface.checkpoint
        if checkpoint is not None and checkpoint.recipe and name:
            checkpoint.store.put(name, result)


def close_surface(
    surface: Surface,
    cloud: ArrangedCloud,
    plan: TilePlan,
    asked: OpeningSettings,
    workforce: Workforce,
    shared: Checkpoint | None,
    threads: int,
    advance: Advance,
) -> tuple[Surface, Closure]:
    """Leave a closed surface as it is, or cut it open where no point supports it.

    The parts that it holds in memory are let go where it is cut. `shared` is where workers see both
    the parts and the points; None where this process does the work. `advance` is told (steps done,
    steps in all): each part is judged, surveyed and cut, or less. Raises InputError where nothing
    is left.
    """
    if asked.close == "yes":
        return surface, Closure(False, "closed, as asked")
    if not all(isinstance(part, str) for part in surface.parts):
        shared = None  # a cloud that is one tile is made into a mesh here
    threads = threads if shared is None else 1
    parts = _ClosedParts(surface, cloud, plan, workforce, shared, threads, BlockHashes(cloud))
    scale = cloud.measured.scale
    usual = SupportRule(max(_NOISES * plan.noise, _STEPS * plan.step), _SPACINGS, scale)
    closure = Closure(True, "open, as asked")
    if not asked.is_asked:
        closure = _decide(parts, usual, advance)
    if not closure.is_open:
        advance(len(parts), len(parts))
        return surface, closure
    rule = usual if asked.trim is None else _support_by(asked.trim, scale)
    fill = (
        _multiply(rule, _FILL) if asked.fill_holes is None else _support_by(asked.fill_holes, scale)
    )
    opened, holes = _cut_parts(parts, rule, fill, advance)
    if not opened.plan.face_count:
        raise InputError(
            f"no piece of the surface within {rule.typical:g} of the points is larger than a crumb",
            f"give a longer {name_option('trim')}: some spacings of the points, as 3s",
        )
    crumbs = opened.plan.dropped
    log.info(
        "%s; trim distance %g, %s, %s dropped",
        closure.reason, rule.typical, _say_filled(holes, fill.typical), say_count(crumbs, "crumb"),
    )  # fmt: skip
    closure = replace(closure, trim=rule.typical, fill_holes=fill.typical)
    return opened, replace(closure, holes=holes, crumbs=crumbs)


def _say_filled(holes: int, size: float) -> str:
    """Say how many holes up to a size were filled."""
    return f"{say_count(holes, 'hole')} up to {size:g} filled" if size else "no holes to be filled"


def _decide(parts: _ClosedParts, rule: SupportRule, advance: Advance) -> Closure:
    """Tell whether a surface stays closed, by its share without points and by the reading."""
    reading = parts.cloud.measured.reading
    share, support = _judge_support(parts, rule, advance)
    probability = weigh_open(reading, share)
    is_open = probability > 0.5
    reason = say_closing(reading, share, is_open=is_open)
    certainty = max(probability, 1.0 - probability)
    return Closure(
        is_open, reason, certainty=certainty, unsupported=share,
        support=None if is_open else support(),
    )  # fmt: skip


def _judge_support(
    parts: _ClosedParts, rule: SupportRule, advance: Advance
) -> tuple[float, Callable[[], Support]]:
    """Return the share of a surface that no point supports, 0 to 1, and what tells more of it."""
    one_in = max(1, len(parts.surface.plan.bricks.keys) // _JUDGED_BRICKS)

    def given(index: int) -> tuple[Any, ...]:
        taken = parts.taken(index)
        return taken, parts.near(taken.sample(one_in), rule.reach), rule, one_in

    found = {}
    for index, _, judged in parts.run(judge_support, given, lambda _: (parts.threads,)):
        found[index] = judged
        advance(len(found), _STEPS_OF_PART * len(parts))
    bare, whole, places = zip(*(found[index] for index in range(len(parts))), strict=True)
    share = float(sum(bare) / max(1, sum(whole)))
    return share, lambda: measure_support(1.0 - share, np.concatenate(places), parts.cloud, rule)


def _cut_parts(
    parts: _ClosedParts, rule: SupportRule, fill: SupportRule, advance: Advance
) -> tuple[Surface, int]:
    """Cut all parts; return the open surface, and how many holes of it are filled."""
    surface, whole = parts.surface, _STEPS_OF_PART * len(parts)
    # Workers finish in any order.
    surveys: dict[int, OpeningSurvey | tuple[str, str]] = {}
    seams: dict[int, OpeningSeams] = {}
    for index, found in _survey_parts(parts, rule):
        surveys[index], seams[index] = found
        advance(len(parts) + len(seams), whole)
    matched = match_seams(surface.plan, [seams[index] for index in range(len(parts))], fill.radii)
    opened: dict[int, tuple[MeshPart | str, PartSummary]] = {}
    for index, part in _open_parts(parts, surveys, matched):
        opened[index] = part
        advance(2 * len(parts) + len(opened), whole)
    cuts, summaries = zip(*(opened[index] for index in range(len(parts))), strict=True)
    # As many faces as a square of that size has at the usual step.
    crumb = int(_FACES * (_CRUMB * rule.typical / parts.plan.usual_step) ** 2)
    opened_surface = Surface(
        [*cuts], [*summaries], surface.origin, surface.checkpoint, surface.workers, crumb
    )
    return opened_surface, matched.holes


def _survey_parts(
    parts: _ClosedParts, rule: SupportRule
) -> Iterator[tuple[int, tuple[OpeningSurvey | tuple[str, str], OpeningSeams]]]:
    """Find out part by part where the border is, and what it has at the seams.

    A survey that a worker has put away comes as the store and its name there.
    """
    surface, shared = parts.surface, parts.shared
    places = place_foreign(surface.plan)

    def given(index: int) -> tuple[Any, ...]:
        taken, rim = parts.taken(index), surface.summaries[index].rim
        return taken, places[index], rim, parts.near(taken.keys, rule.reach), rule

    if shared is None:
        run = parts.run(survey_support, given, lambda _: (None, parts.threads))
        yield from ((index, found) for index, _, found in run)
        return

    def keep(name: str) -> tuple[str, str]:
        return shared.place, shared.name_beside(name, "survey")

    def is_whole(name: str) -> bool:
        return shared.find(keep(name)[1], ANYTHING) is not None

    run = parts.run(survey_support, given, lambda name: (keep(name), parts.threads), is_whole)
    for index, name, (_, seams) in run:
        yield index, (keep(name), seams)


def _open_parts(
    parts: _ClosedParts,
    surveys: dict[int, OpeningSurvey | tuple[str, str]],
    matched: MatchedSeams,
) -> Iterator[tuple[int, tuple[MeshPart | str, PartSummary]]]:
    """Cut part by part, and keep each where its closed one was kept."""
    surface, checkpoint = parts.surface, parts.surface.checkpoint

    def given(index: int) -> tuple[Any, ...]:
        decided = matched.stays[index], matched.foreign_numbers[index], matched.seam_cuts[index]
        return parts.taken(index), surveys[index], decided

    def keep(name: str) -> tuple[tuple[str, str] | None]:
        return (None if parts.shared is None else (parts.shared.place, name),)

    for index, name, (part, summary, exits) in parts.run(open_part, given, keep, is_returned=False):
        del surveys[index]  # it is of no more use, and large
        kept: MeshPart | str = name
        if part is not None and name:
            assert checkpoint is not None  # noqa: S101 - or there would be no names
            checkpoint.store.put(name, (part, summary, exits))
        elif part is not None:
            # So that the closed and the open surface are not both in memory.
            kept, surface.parts[index] = part, MeshPart.empty()
        yield index, (kept, summary)


def _support_by(length: Length, scale: LocalScale) -> SupportRule:
    """Return the rule by a length that was asked for."""
    if length.in_spacings:
        return SupportRule(0.0, length.value, scale)
    return SupportRule(length.value, 0.0, scale)


def _multiply(rule: SupportRule, factor: float) -> SupportRule:
    """Return a rule with larger radii."""
    return SupportRule(factor * rule.least, factor * rule.spacings, rule.scale)
