"""The surface of a cloud of several tiles: each by a task, and over the gaps between them.

::

    tiles ── mesh_tile ──> parts, exits ──┐
               exits that no part has ──> mesh_gap ──> parts, exits ──> ... none left

Of a cloud that is one tile see `one_tile`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from hpcapp.applications.surface.extraction.parts import MeshPart
from hpcapp.applications.surface.extraction.summary import PartSummary
from hpcapp.applications.surface.hierarchical.coarse import Coarse
from hpcapp.applications.surface.hierarchical.tiles import Tiling
from hpcapp.applications.surface.methods.method import Advance, ShowPart, show_nothing
from hpcapp.applications.surface.stitching.surface import Surface
from hpcapp.applications.surface.tiles.checkpoint import Checkpoint
from hpcapp.applications.surface.tiles.halo import widen_box
from hpcapp.applications.surface.tiles.patterns import tile_surface
from hpcapp.applications.surface.tiles.plan import CoarseLevels, Gap, TilePlan
from hpcapp.applications.surface.tiles.points import CellPoints
from hpcapp.applications.surface.tiles.tasks import mesh_gap, mesh_tile
from hpcapp.geometry.lattice import (
    find_keys,
    find_overlapping,
    find_within,
    number_keys,
    pack_places,
    unique_keys,
    unpack_keys,
)
from hpcapp.geometry.points import ByteArray, FloatArray, IntArray
from hpcapp.kernels.types.grid import BRICK
from hpcapp.workforce import Workforce, stream_batches
from hpccomponent.errors import JobError

_LEAST_EDGE = 8  # bricks of a box in which gaps are spanned
_MOST_ROUNDS = 1000  # each goes on by a coarse cell at least; a grid has no more


Found = tuple[MeshPart | None, PartSummary, IntArray]


class _Growth:
    """Runs the tasks of a job, and gathers what they give."""

    def __init__(
        self,
        workforce: Workforce,
        origin: FloatArray,
        checkpoint: Checkpoint | None,
        show_part: ShowPart,
        points: int,
    ) -> None:
        self._workforce = workforce
        self._show_part = show_part
        self._checkpoint = checkpoint
        self._exits: list[IntArray] = []
        self.surface = Surface([], [], origin, checkpoint, points=points)

    def run(
        self,
        task: Callable[..., Any],
        tiles: Iterable[tuple[str, tuple[Any, ...]]],
        count: int,
        advance: Advance,
    ) -> None:
        """Run a task for each of `count` tiles that are not there yet.

        Each has its name and what the task is called with, the plan first, made when there is room.
        """
        names: list[str] = []
        started: list[int] = []
        found: dict[int, Found] = {}

        def batches() -> Iterator[tuple[Any, ...]]:
            for index, (name, arguments) in enumerate(tiles):
                names.append(name)
                declared = tile_surface(arguments[0], None)
                kept = self._checkpoint.find(name, declared) if self._checkpoint else None
                if kept is not None:
                    found[index] = (None, *kept[1:])
                    self._show(name, None)
                    advance(len(found), count)
                    continue
                started.append(index)
                yield *arguments, self._keep(name)

        at_once = self._workforce.workers * (1 if self._workforce.in_process else 2)
        makers: dict[int, str | None] = {}
        for batch, result in stream_batches(self._workforce, task, batches(), at_once, makers):
            name = names[started[batch]]
            found[started[batch]] = self._put(name, result)
            self._show(name, found[started[batch]][0])
            advance(len(found), count)
        if task is mesh_tile:  # no gap
            self.surface.taken += count - len(started)
        workers = {started[batch]: worker for batch, worker in makers.items()}
        for index, name in enumerate(names):
            self._take(name, found[index], workers.get(index))

    def held(self) -> IntArray:
        """Return the bricks that parts have, sorted."""
        return unique_keys(np.concatenate([found.bricks for found in self.surface.summaries]))

    def left(self, held: IntArray) -> IntArray:
        """Return the bricks that the surface leaves for, and that are not among those held."""
        wanted = unique_keys(np.concatenate(self._exits))
        left: IntArray = wanted[find_keys(held, wanted) == len(held)]
        return left

    def _keep(self, name: str) -> tuple[str, str] | None:
        """Return where a worker is to put its tile, if it can."""
        checkpoint = self._checkpoint
        return (checkpoint.place, name) if checkpoint is not None and checkpoint.is_shared else None

    def _put(self, name: str, result: Found) -> Found:
        """Put a tile that came back where it is kept."""
        if self._checkpoint is None or result[0] is None:
            return result
        self._checkpoint.store.put(name, result)
        return None, *result[1:]

    def _show(self, name: str, part: MeshPart | None) -> None:
        """Announce a part, which is here or kept under its name."""
        if part is not None:
            self._show_part(lambda: part)
        elif self._checkpoint is not None:
            store = self._checkpoint.store
            self._show_part(lambda: store.get(name)[0])

    def _take(self, name: str, result: Found, worker: str | None) -> None:
        part, summary, exits = result
        self.surface.workers.append(worker)
        self.surface.parts.append(name if part is None else part)
        self.surface.summaries.append(summary)
        self._exits.append(exits)


def _name_tile(checkpoint: Checkpoint, tiling: Tiling, index: int, around: CoarseLevels) -> str:
    """Return the name of a tile: a hash of all that the task is given, of points what they are."""
    plan, groups = tiling.plan, tiling.groups(index)
    if not checkpoint.recipe:  # it lies in a folder of this input and this plan
        return checkpoint.name(plan, *groups)
    there = plan.origin, plan.coarse_size, plan.grid_origin, BRICK * plan.step
    bricks = unpack_keys(find_overlapping(groups[0], *there))
    near = _crop_plan(plan, bricks.min(axis=0), bricks.max(axis=0))
    points = tiling.identify(unique_keys(np.concatenate(groups)))
    return checkpoint.name(*near, *groups, *points, around)


def _crop_plan(
    plan: TilePlan, first: IntArray, last: IntArray
) -> tuple[TilePlan, ByteArray | None]:
    """Return what of a plan concerns a box of bricks: all, and the strides in it and around it."""
    if plan.strides is None:
        return plan, None
    far = 2 + 2 * plan.grid.rim
    x, y, z = (last - first + 1 + 2 * far).tolist()
    return replace(plan, strides=None), plan.strides.cells_within(first - far, (x, y, z))


def cut_gaps(plan: TilePlan, left: IntArray, wide: float) -> list[tuple[IntArray, IntArray]]:
    """Group the bricks that the surface leaves for by boxes, keys (e,).

    With the halo of what is evaluated in it a box is so `wide`, in length units. Returns the boxes,
    (2, 3) bricks each, and the keys of those in it.
    """
    halo = 2 * (2 + plan.grid.rim)
    edge = max(int(wide / (BRICK * plan.step)) - halo, _LEAST_EDGE)
    places = unpack_keys(left) // edge
    boxes, box_of = number_keys(pack_places(places))
    corners = edge * unpack_keys(boxes)
    most = np.array(plan.bricks)
    return [
        (np.stack([corner, np.minimum(corner + edge, most)]), left[box_of == index])
        for index, corner in enumerate(corners)
    ]


def _plan_gap(
    tiling: Tiling,
    coarse: Coarse,
    box: IntArray,
    exits: IntArray,
    held: IntArray,
    checkpoint: Checkpoint | None,
) -> tuple[str, tuple[TilePlan, Gap, CellPoints, CoarseLevels]]:
    """Return the name of what spans the gaps in a box, and what the task is called with."""
    plan, edge = coarse.plan, BRICK * coarse.plan.step
    lattices = plan.grid_origin, edge, plan.origin, plan.coarse_size
    near = tiling.near(find_overlapping(exits, *lattices))
    # Whose points matter in the box, or around it; and what of these other parts have.
    first, end = widen_box(plan.grid, box)
    beside = held[find_within(held, first, end - 1)]
    low, high = plan.grid_origin + edge * np.stack([first, end])
    ends = np.stack([low - plan.reach, high + plan.reach]) - plan.origin
    within = np.zeros(len(near), np.bool_)
    within[find_within(tiling.cells, *np.floor(ends / plan.coarse_size).astype(np.int64))] = True
    gap = Gap(box, exits, beside, tiling.cells[within & ~near])
    cells, around = tiling.cells[near], coarse.within(*(plan.grid_origin + edge * box))
    name = ""
    if checkpoint is not None and checkpoint.recipe:
        points = tiling.identify(cells)
        name = checkpoint.name(*_crop_plan(plan, box[0], box[1] - 1), gap, cells, *points, around)
    elif checkpoint is not None:
        name = checkpoint.name(plan, gap, cells)
    return name, (plan, gap, tiling.around(cells), around)


def mesh_all_tiles(
    tiling: Tiling,
    coarse: Coarse,
    workforce: Workforce,
    advance: Advance,
    origin: FloatArray,
    points: int,
    wide: float,
    checkpoint: Checkpoint | None = None,
    show_part: ShowPart = show_nothing,
) -> Surface:
    """Reconstruct the surface tile by tile on the workers, and between the tiles.

    It holds every brick that the surface reaches. `origin`, (3,), is that of the cloud's local
    frame; boxes are so `wide` in which gaps are spanned (see `cut_gaps`); without a checkpoint,
    finished tiles come back to this process. `advance` is told (tiles done, tiles in all). JobError
    where the surface still grows after more rounds than any needs.
    """
    plan = coarse.plan
    growth = _Growth(workforce, origin, checkpoint, show_part, points)

    def tiles() -> Iterator[tuple[str, tuple[Any, ...]]]:
        for index in range(len(tiling)):
            around = coarse.around(tiling.own(index))
            name = "" if checkpoint is None else _name_tile(checkpoint, tiling, index, around)
            held = tiling.tile(index)
            yield name, (plan, held, tiling.tickets[index], around)

    growth.run(mesh_tile, tiles(), len(tiling), advance)
    for _ in range(_MOST_ROUNDS):
        held = growth.held()
        left = growth.left(held)
        if not len(left):
            return growth.surface
        gaps = cut_gaps(plan, left, wide)
        growth.run(
            mesh_gap,
            (_plan_gap(tiling, coarse, *gap, held, checkpoint) for gap in gaps),
            len(gaps),
            lambda _done, _all: None,
        )
    raise JobError("the surface does not come to an end", "report this, with the point cloud")
