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
        self, task: Callable[..., Any], batch: Callable[[int], tuple[Any, ...]]
    ) -> Iterator[tuple[int, Any]]:
        """Run a task for each part, on the workers or right here."""
        indices = range(len(self))
        if self.shared is not None:
            at_once = 2 * self.workforce.workers
            yield from stream_batches(self.workforce, task, map(batch, indices), at_once)
            return
        for index in indices:
            yield index, task(*batch(index))


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
    parts = _ClosedParts(surface, cloud, plan, workforce, shared, threads if shared is None else 1)
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

    def batch(index: int) -> tuple[Any, ...]:
        taken = parts.taken(index)
        near = parts.near(taken.sample(one_in), rule.reach)
        return parts.part(index), taken, near, rule, one_in, parts.threads

    found = []
    for _, judged in parts.run(judge_support, batch):
        found.append(judged)
        advance(len(found), _STEPS_OF_PART * len(parts))
    bare, whole, places = zip(*found, strict=True)
    share = float(sum(bare) / max(1, sum(whole)))
    return share, lambda: measure_support(1.0 - share, np.concatenate(places), parts.cloud, rule)


def _cut_parts(
    parts: _ClosedParts, rule: SupportRule, fill: SupportRule, advance: Advance
) -> tuple[Surface, int]:
    """Cut all parts; return the open surface, and how many holes of it are filled."""
    surface, whole = parts.surface, _STEPS_OF_PART * len(parts)
    # Workers finish in any order.
    surveys: dict[int, OpeningSurvey] = {}
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
) -> Iterator[tuple[int, tuple[OpeningSurvey, OpeningSeams]]]:
    """Find out part by part where the border is, and what it has at the seams."""
    surface = parts.surface
    places = place_foreign(surface.plan)

    def batch(index: int) -> tuple[Any, ...]:
        taken, rim = parts.taken(index), surface.summaries[index].rim
        near = parts.near(taken.keys, rule.reach)
        return parts.part(index), taken, places[index], rim, near, rule, parts.threads

    return parts.run(survey_support, batch)


def _open_parts(
    parts: _ClosedParts, surveys: dict[int, OpeningSurvey], matched: MatchedSeams
) -> Iterator[tuple[int, tuple[MeshPart | str, PartSummary]]]:
    """Cut part by part, and keep each where its closed one was kept."""
    surface, checkpoint = parts.surface, parts.surface.checkpoint

    def batch(index: int) -> tuple[Any, ...]:
        decided = matched.stays[index], matched.foreign_numbers[index], matched.seam_cuts[index]
        keep = None
        if parts.shared is not None:
            keep = parts.shared.place, f"{surface.parts[index]}-open"
        return parts.part(index), parts.taken(index), surveys[index], decided, keep

    for index, (part, summary, exits) in parts.run(open_part, batch):
        del surveys[index]  # it is of no more use, and large
        name, kept = surface.parts[index], part
        if isinstance(name, str):
            kept = f"{name}-open"
            if part is not None and checkpoint is not None:
                checkpoint.store.put(kept, (part, summary, exits))
        else:
            # So that the closed and the open surface are not both in memory.
            surface.parts[index] = MeshPart.empty()
        yield index, (kept, summary)


def _support_by(length: Length, scale: LocalScale) -> SupportRule:
    """Return the rule by a length that was asked for."""
    if length.in_spacings:
        return SupportRule(0.0, length.value, scale)
    return SupportRule(length.value, 0.0, scale)


def _multiply(rule: SupportRule, factor: float) -> SupportRule:
    """Return a rule with larger radii."""
    return SupportRule(factor * rule.least, factor * rule.spacings, rule.scale)
