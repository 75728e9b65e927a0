"""A tile's points in their cells, and the corners that its bricks ask for.

::

    points ──> cells, their moments up to the coarse level    asked for by sum_tile
                 └──> kinds of bricks ──> corners of the fine levels    by mesh_tile

The corners need nothing that the master has to find first, so they are laid a step at a time,
whenever there is time for one.
"""

from __future__ import annotations

from collections.abc import Generator
from typing import TypeVar

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.field.pyramid import lay_vertices, raise_levels
from hpcapp.applications.surface.tiles.halo import near_bricks, plan_tile
from hpcapp.applications.surface.tiles.plan import TilePlan
from hpcapp.applications.surface.tiles.points import CellPoints, TilePoints, take_points
from hpcapp.geometry.points import BoolArray, IntArray
from hpcapp.kernels.freed_memory import bound_free_memory
from hpcapp.kernels.types.grid import BrickKinds

Found = TypeVar("Found")
Corners = list[IntArray]
Laid = tuple[BrickKinds | None, Corners]


class PreparedTile:
    """What both tasks of a tile make of its points, those of its halo among them.

    `groups` (c,) are of the finest cells (see `TilePoints`). Of the levels, finest first,
    `mesh_tile` asks for those below the coarse one, `sum_tile` for that, too.
    """

    def __init__(self, plan: TilePlan, points: CellPoints, levels: int, threads: int) -> None:
        taken = take_points(points, plan)  # in memory that was touched before, if there is some
        bound_free_memory()  # what this and tiles before it have left
        self.groups = taken.groups
        self.levels = raise_levels(taken.finest, levels, threads)
        self._laid: Laid | None = None
        self._steps = _lay(plan, taken)  # without `self`, which would be a cycle

    def lay_some(self) -> bool:
        """Do the next step towards the corners; return whether there are more."""
        if self._laid is None:
            try:
                next(self._steps)
            except StopIteration as end:
                self._laid = end.value
        return self._laid is None

    def laid(self) -> Laid:
        """Do what is left of the steps; return kinds of bricks, and corners as of `lay_corners`.

        Kinds are None where the tile has no such bricks, and corners are empty then.
        """
        if self._laid is None:
            self._laid = finish(self._steps)
        return self._laid


class TileCache:
    """Prepared tiles by their tickets, `capacity` at most, the oldest given up first."""

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._tiles: dict[str, PreparedTile] = {}

    def __len__(self) -> int:
        return len(self._tiles)

    def put(self, ticket: str, tile: PreparedTile) -> None:
        """Keep a tile; where there is no room the oldest goes."""
        while len(self._tiles) >= self._capacity:
            self._tiles.pop(next(iter(self._tiles), ""), None)
        self._tiles[ticket] = tile

    def pop(self, ticket: str | None) -> PreparedTile | None:
        """Take a tile out; None where it is not here any more."""
        return None if ticket is None else self._tiles.pop(ticket, None)

    def advance(self, ticket: str) -> bool:
        """Do a step of a tile ahead of time, and tell whether there are more.

        A step that fails gives the tile up: who asks for it prepares it anew, and meets the error
        if it stays.
        """
        if ticket not in self._tiles:
            return False
        try:
            return self._tiles[ticket].lay_some()
        except BaseException:
            del self._tiles[ticket]
            raise


def _lay(plan: TilePlan, taken: TilePoints) -> Generator[str, None, Laid]:
    kinds = plan_tile(plan.grid, *(taken.seed_bricks(plan.grid, group) for group in range(3)))
    cells = taken.finest.cells
    del taken  # the points leave memory with their level
    yield "kinds"
    return kinds, [] if kinds is None else (yield from lay_corners(plan, cells, kinds))


def lay_corners(
    plan: TilePlan, cells: IntArray, kinds: BrickKinds
) -> Generator[str, None, Corners]:
    """Find the corners of each fine level that some bricks ask for, and ancestors, in steps.

    `cells` (c,) are sorted keys of the finest cells with points. Yield what was done in a step,
    return the corners of each level below the coarse one.

    A node asks for the corners around it, up to a cell of their level away, and these are there
    because of cells whose middle lies as far again, and half a cell, from them. On levels above the
    base, which have few corners, those that the coarsest asks for are laid, and those that points
    are weighed by.
    """
    weighing = 0.0 if np.isinf(plan.tolerance) else 4.0
    below = plan.refinement.levels
    height = plan.coarse - below  # from the base up
    *finer, base = plan.refinement.cells_above(cells)
    near_finer = [
        of_level[_mark_near(plan, kinds, of_level, plan.cell_size * 2.0**depth, 2.75)]
        for depth, of_level in enumerate(finer)
    ]
    is_near, is_wide = (
        _mark_near(plan, kinds, base, plan.base_size, reach)
        for reach in (2.75, 2.0**height + 0.75 + weighing)
    )
    yield "near bricks"
    near = kernels.spread_keys(base[is_near], -1, 2)
    # From the finest level to the base: corners, and the parents of those of the level before.
    *laid, near = plan.refinement.lay(near_finer, near)
    yield "corners"
    if height == 1:
        return [*laid, near]
    # Cells farther off lay no corners of the base, but the ancestors that coarser levels ask for.
    rest = kernels.spread_keys(base[is_wide & ~is_near], -1, 2)
    wide = kernels.unite_keys(kernels.parent_keys(near), kernels.parent_keys(rest))
    return [*laid, near, *lay_vertices(wide, height - 1)]


def _mark_near(
    plan: TilePlan, kinds: BrickKinds, cells: IntArray, size: float, reach: float
) -> BoolArray:
    """Tell which cells of a level lie within so many cells of bricks that may be evaluated."""
    return near_bricks(kinds, plan.grid, cells, plan.origin, size, reach * size)


def finish(steps: Generator[object, None, Found]) -> Found:
    """Do all that is left of some steps, and return what the generator does."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value  # type: ignore[no-any-return]
