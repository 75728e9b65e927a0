"""Tiles: compact sets of coarse cells, equal in estimated work.

The paper's equal batches, by work instead of by count.
"""

from __future__ import annotations

import secrets
from math import log2, sqrt
from typing import Any

import numpy as np

from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.cloud.block_hashes import BlockHashes
from hpcapp.applications.surface.cloud.cutting import cut_tiles
from hpcapp.applications.surface.cloud.point_workers import PointWorkers
from hpcapp.applications.surface.tiles.halo import mark_near
from hpcapp.applications.surface.tiles.plan import TilePlan
from hpcapp.applications.surface.tiles.points import CellPoints, PointsThere, pack_cells
from hpcapp.applications.surface.tiles.tasks import KEPT_TILES
from hpcapp.geometry.lattice import (
    ancestor_keys,
    find_overlapping,
    number_keys,
    pack_places,
    unique_keys,
    unpack_keys,
)
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.kernels.types.grid import BRICK

# What a finest cell on the surface, and a cell of the grid there, take beside the points, in what a
# point takes: from scans of bunny, table and rocker arm, whose finest cells were 1 to 6.5 cells of
# the grid wide.
_CELL_WORK, _STEP_WORK = 2.0, 0.4
OUTLASTING = 5_000.0
"""Points of a tile that jobs of other scans may take: a choice, of which only the town of
``benchmarks/updates.py`` was measured. Smaller ones have more halo, of larger ones fewer stay."""


class Tiling:
    """A cloud cut into tiles, `count` of them, or fewer where there are fewer coarse cells.

    Where `workers` do not see the points, these are sent with the tasks. If memory `is_short`,
    tiles have about as many points each instead of as much work, and a worker keeps one of them
    prepared until it is meshed; else `tiles.KEPT_TILES`.

    With a `level` tiles are instead the points in each of the cells so many levels above the coarse
    one: wherever points are added, other tiles are what they were.

    `cells` (c,) are sorted keys of the coarse cells that hold points. `tickets` are of the tiles,
    where workers may keep them: each prepares its points once then (see `tiles.sum_tile`). Not
    where they are sent from a disk, which is done twice.
    """

    def __init__(
        self,
        cloud: ArrangedCloud,
        plan: TilePlan,
        count: int,
        workers: PointWorkers,
        is_short: bool,
        level: int | None = None,
    ) -> None:
        workforce, are_read = workers.workforce, workers.workers_see
        self.cells, counts = workers.count_cells(cloud, plan.origin, plan.coarse_size)
        self._cloud = cloud
        self.plan = plan
        if level is None:
            work = counts if is_short else weigh_cells(plan, counts)
            self._tile_of = cut_tiles(self.cells, work, count)
        else:
            _, self._tile_of = number_keys(ancestor_keys(self.cells, level))
        order = np.argsort(self._tile_of, kind="stable")
        ends = np.cumsum(np.bincount(self._tile_of))
        self._own: list[IntArray] = np.split(self.cells[order], ends[:-1])
        self._counts: list[IntArray] = np.split(counts[order], ends[:-1])
        self._share = workforce.share
        self._are_read = are_read
        self._shared: dict[int, Any] = {}
        self._hashes = BlockHashes(cloud)
        self._groups: dict[int, list[IntArray]] = {}
        is_once = are_read or cloud.is_here
        kept = 1 if is_short else KEPT_TILES
        most = 0 if workforce.in_process else kept * workforce.workers
        is_kept = is_once and len(self) <= most
        self.tickets = [secrets.token_hex(8) if is_kept else None for _ in range(len(self))]

    def __len__(self) -> int:
        return len(self._own)

    def own(self, index: int) -> IntArray:
        """Return the sorted keys of the coarse cells of a tile, (k,)."""
        return self._own[index]

    def counts(self, index: int) -> IntArray:
        """Return how many points each of the coarse cells of a tile holds, (k,)."""
        return self._counts[index]

    def core(self, index: int) -> CellPoints:
        """Return a tile's points for `sum_tile`, some as `Workforce.share` offers them."""
        if self.tickets[index] is not None:
            return self.tile(index)
        return self._give([self.own(index)], index)

    def groups(self, index: int) -> list[IntArray]:
        """Return the cells of a tile, and of its halo: those of tiles before and after it.

        Each of the three groups is of sorted keys.
        """
        if index not in self._groups:
            own = self.own(index)
            around = self.near(own)
            before, after = around & (self._tile_of < index), around & (self._tile_of > index)
            self._groups[index] = [own, self.cells[before], self.cells[after]]
        return self._groups[index]

    def tile(self, index: int) -> CellPoints:
        """Return the points in the `groups` of a tile, as a task is given them.

        All or some of it is as `Workforce.share` offers it.
        """
        if self.tickets[index] is None:
            return self._give(self.groups(index), index)
        if index not in self._shared:  # whoever has summed it is the first to be asked again
            self._shared[index] = self._share(self._give(self.groups(index), None))
        shared: CellPoints = self._shared[index]
        return shared

    def identify(self, cells: IntArray) -> tuple[IntArray, IntArray]:
        """Return what tells the points in some coarse cells (c,) from others.

        It is keys of the b blocks that these overlap, and a hash of each, (b, 2).
        """
        plan, blocks = self.plan, self._cloud.arrangement
        there = plan.origin, plan.coarse_size, blocks.origin, blocks.edge
        return self._hashes.of(find_overlapping(cells, *there))

    def around(self, cells: IntArray) -> CellPoints:
        """Return the points in coarse cells of sorted keys (k,), as one group."""
        return self._give([cells], None)

    def near(self, cells: IntArray) -> BoolArray:
        """Tell which of the tiling's `cells`, (c,), lie near enough around some to matter."""
        return mark_halo(self.plan, self.cells, cells)

    def _give(self, groups: list[IntArray], index: int | None) -> CellPoints:
        if self._are_read:
            return PointsThere(self._cloud.place, tuple(groups))
        plan = self.plan
        packed = pack_cells(self._cloud, plan.origin, plan.coarse_size, groups)
        if index is not None and self._cloud.is_here:
            if index not in self._shared:
                self._shared[index] = self._share(packed[0])
            packed[0] = self._shared[index]
        return tuple(packed)


def choose_level(plan: TilePlan, spacing: float) -> int:
    """Return how many levels above the coarse one are cells of about `OUTLASTING` points.

    Points of a surface lie so far apart; by the plan alone, so that it is the same for each job.
    """
    edge = spacing * sqrt(OUTLASTING)
    return max(0, round(log2(edge / plan.coarse_size)))


def weigh_cells(plan: TilePlan, counts: IntArray) -> FloatArray:
    """Estimate the work of coarse cells with so many points (c,) each, in what a point takes, (c,).

    The surface crosses a coarse cell as if it were one side of it: where points are few it asks
    for as many quadrics and nodes as where they are many.
    """
    each = _CELL_WORK + _STEP_WORK * (plan.cell_size / plan.step) ** 2
    return counts.astype(np.float64) + 4.0**plan.coarse * each


def mark_halo(plan: TilePlan, keys: IntArray, cells: IntArray) -> BoolArray:
    """Tell which coarse cells (k,) lie so near a tile's (c,) that its quadrics depend on them.

    Both are sorted keys. The tile's bricks are among those that its cells overlap; it evaluates a
    brick and a rim further at most, and from there its quadrics reach as far as the plan's `reach`.
    """
    size, edge = plan.coarse_size, BRICK * plan.step
    shift, beyond = plan.grid_origin - plan.origin, 1.0 + plan.grid.rim
    bricks = unpack_keys(find_overlapping(cells, plan.origin, size, plan.grid_origin, edge))
    # (b, 3): the first and the last cell that each brick depends on; the widest box serves all.
    first = np.floor((shift + edge * (bricks - beyond) - plan.reach) / size).astype(np.int64)
    last = np.floor((shift + edge * (bricks + 1.0 + beyond) + plan.reach) / size).astype(np.int64)
    boxes = unique_keys(pack_places(first))
    return mark_near(keys, boxes, 0, (last - first).max(axis=0))
