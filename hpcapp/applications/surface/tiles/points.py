"""The points of a tile, wherever they lie: sent with the task, or read where the cloud is."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud, Place
from hpcapp.applications.surface.cloud.arrangement import (
    PackedPoints,
    unpack_points,
    unpacking_arguments,
)
from hpcapp.applications.surface.cloud.folder.disk import open_place
from hpcapp.applications.surface.field.cell_points import SortedPoints
from hpcapp.applications.surface.field.pyramid import Level
from hpcapp.applications.surface.tiles.packed_cells import sort_tile
from hpcapp.applications.surface.tiles.plan import TilePlan
from hpcapp.geometry.lattice import cells_of, find_keys, find_overlapping, pack_places, unique_keys
from hpcapp.geometry.points import ByteArray, FloatArray, IntArray
from hpcapp.kernels.types.grid import Grid
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.records import record

_BYTES_PER_POINT = 24.0
_NO_GROUP = np.uint8(255)


@record("surface.points_there")
@dataclass(frozen=True, slots=True, eq=False)
class PointsThere:
    """Points that a task reads where the cloud is.

    `cloud` is a folder that the worker sees, or in this process the cloud itself; `groups` are the
    sorted keys of each group's coarse cells.
    """

    cloud: Place
    groups: tuple[IntArray, ...]


CellPoints = PointsThere | tuple[PackedPoints, ...]
"""Points in some groups of coarse cells, as a task is given them: where they are, or those of each
group, which are sent."""


@dataclass(frozen=True, slots=True, eq=False)
class TilePoints:
    """Points in some groups of coarse cells, sorted by the finest ones.

    `finest` has these cells and their points, within a cell in the order of the whole cloud;
    `groups` (c,) is the group of each cell.
    """

    finest: Level
    groups: ByteArray

    def seed_bricks(self, grid: Grid, group: int) -> IntArray:
        """Return the sorted keys of the bricks that hold a point of a group."""
        points = self.finest.points
        assert isinstance(points, SortedPoints)  # noqa: S101 - the finest level has points
        return points.held.seed_bricks(grid, points.offsets, self.groups == group)


def estimate_work(points: CellPoints) -> float:
    """Return how much work the points that a task is given are, for the master.

    It is their number where they, or what stands for shared values, are sent; else, since nobody
    has looked at them, that of their coarse cells, which have as much surface each. One job's tasks
    are given one form.

    Examples
    --------
    >>> estimate_work(PointsThere("/folder", (np.arange(5), np.arange(2))))
    8.0
    """
    if isinstance(points, PointsThere):
        return 1.0 + sum(map(len, points.groups))
    groups = points if isinstance(points, tuple) else (points,)
    return 1.0 + sum(_count_bytes(group) for group in groups) / _BYTES_PER_POINT


def _count_bytes(value: Any) -> int:
    """Return the bytes of packed points, or of what stands for a shared value."""
    if not isinstance(value, PackedPoints):
        return int(value.size_bytes)
    return sum(getattr(value, field.name).nbytes for field in fields(value))


def take_points(points: CellPoints, plan: TilePlan) -> TilePoints:
    """Return the points that a task has been given; there may be none."""
    if isinstance(points, PointsThere):
        cloud, cells = open_place(points.cloud), list(points.groups)
        wanted, numbers = _number_cells(cells)
        # Whole blocks: `sort_tile` leaves out what lies in no wanted cell.
        packed = _take_overlapping(cloud, wanted, plan.origin, plan.coarse_size)
    else:
        cells = [_find_cells(group, plan) for group in points]
        wanted, numbers = _number_cells(cells)
        packed = PackedPoints.from_records(
            np.concatenate([group.keys for group in points]),
            np.concatenate([group.counts for group in points]),
            np.concatenate([group.to_records() for group in points]),
        )
    lattice = plan.origin, plan.cell_size, plan.coarse
    keys, offsets, held, groups = sort_tile(plan.arrangement, packed, *lattice, wanted, numbers)
    sorted_points = SortedPoints(held, plan.origin, plan.cell_size, offsets)
    return TilePoints(Level(keys, sorted_points, np.empty(0)), groups)


def _find_cells(packed: PackedPoints, plan: TilePlan) -> IntArray:
    """Return the coarse cells that some points lie in, which hold no others."""
    if not len(packed):
        return np.empty(0, np.int64)
    given = unpacking_arguments(plan.arrangement, packed)
    return kernels.count_packed(*given, plan.origin, plan.coarse_size)[0]


def pack_cells(
    cloud: ArrangedCloud, origin: FloatArray, size: float, cells: list[IntArray]
) -> list[PackedPoints]:
    """Return the points in groups of coarse cells as they are sent: of each group, in cloud order.

    Corner (0, 0, 0) of the cells lies at `origin` (3,); `cells` are sorted keys of each group.
    """
    wanted, numbers = _number_cells(cells)
    packed = _take_overlapping(cloud, wanted, origin, size)
    positions, _ = unpack_points(cloud.arrangement, packed)
    places = np.floor(cells_of(positions, origin, size)).astype(np.int64)
    # (n,): the group of each point, none of those in other cells; and the block that it lies in
    group_of = np.append(numbers, _NO_GROUP)[find_keys(wanted, pack_places(places))]
    block_of = np.repeat(np.arange(len(packed.keys)), packed.counts)
    groups = []
    for number in range(len(cells)):
        rows = np.flatnonzero(group_of == number)
        counts = np.bincount(block_of[rows], minlength=len(packed.keys))
        held = counts > 0
        records = packed.to_records().take(rows, axis=0)
        groups.append(PackedPoints.from_records(packed.keys[held], counts[held], records))
    return groups


def _take_overlapping(
    cloud: ArrangedCloud, cells: IntArray, origin: FloatArray, size: float
) -> PackedPoints:
    """Return the points in the blocks that overlap some cells."""
    blocks = cloud.arrangement
    return cloud.take_packed(find_overlapping(cells, origin, size, blocks.origin, blocks.edge))


def _number_cells(cells: list[IntArray]) -> tuple[IntArray, ByteArray]:
    """Return the cells of some groups, sorted, and the number of each one's group."""
    wanted = unique_keys(np.concatenate(cells))
    numbers = np.empty(len(wanted), np.uint8)
    for number, group in enumerate(cells):
        numbers[find_keys(wanted, group)] = number
    return wanted, numbers
