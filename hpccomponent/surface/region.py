"""The tasks of a tile: what its points add to the coarse lattices, and the surface inside it.

::

    sum_tile    points ──> moments of its coarse cells                      ──> master
    master      coarse lattices of all tiles ──> coarse quadrics, far field ──> tiles
    mesh_tile   points, halo, coarse quadrics, far field ──> fine quadrics ──> bricks ──> MeshPart

A tile is a set of whole cells of one coarse level. Its halo is what surrounds it, so that every
quadric that its bricks ask for is the one that the whole cloud would give, bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from hpccomponent.runtime.idle import idle_work
from hpccomponent.runtime.tasks import declare
from hpccomponent.store import hold_store
from hpccomponent.surface import kernels
from hpccomponent.surface.ancestors import corners_at, mark_ancestors
from hpccomponent.surface.bricks import BrickKinds
from hpccomponent.surface.cell_points import SortedPoints
from hpccomponent.surface.far_field import restore_far_field
from hpccomponent.surface.field import FieldLevel
from hpccomponent.surface.field_levels import SlabFields, fit_above
from hpccomponent.surface.hermite import BASIS
from hpccomponent.surface.lattice import unpack_keys
from hpccomponent.surface.mesh_part import MeshPart
from hpccomponent.surface.part_summary import summarize_part
from hpccomponent.surface.points import FloatArray, IntArray
from hpccomponent.surface.pyramid import (
    Level,
    Pyramid,
    lay_vertices,
    raise_levels,
    sort_level,
)
from hpccomponent.surface.reach import near_bricks, plan_gap, plan_tile
from hpccomponent.surface.slab_growth import grow_tile
from hpccomponent.surface.tile_plan import CoarseLevels, Plan, Values
from hpccomponent.surface.tile_points import CellPoints, estimate_work, take_points
from hpccomponent.surface.weights import FIELD_LEVELS

__all__ = [
    "KEPT_TILES",
    "mesh_gap",
    "mesh_tile",
    "sample_cells",
    "sum_tile",
]

_NO_LEVEL = FieldLevel(
    np.empty(0, np.int64), np.empty((0, BASIS), np.float32), np.empty(0, np.float32)
)


@dataclass(slots=True, eq=False)
class _Prepared:
    """A tile's points in their cells, up to the coarse level; `kinds` is None where it has none.

    `laid` are the corners of its fine levels (see `_lay_near`), once somebody had time for them.
    """

    kinds: BrickKinds | None
    groups: NDArray[np.uint8]
    levels: list[Level]
    laid: list[IntArray] | None = None


KEPT_TILES = 3
"""So many tiles that a process has summed wait there to be meshed, some 110 bytes a point."""

_waiting: dict[str, _Prepared] = {}
"""By their tickets, the one that was summed first before the others."""


@declare(cost=lambda _plan, points, *_: estimate_work(points))
def sum_tile(
    plan: Values, points: CellPoints, ticket: str | None = None, threads: int = 1
) -> Values:
    """Sum the moments of a tile's points in the cells of the coarse level (a task).

    Parameters
    ----------
    plan : tuple
        Of a `Plan`.
    points : tuple
        `CellPoints` of the tile alone; with a ticket, those that `mesh_tile` will be given.
    ticket : str, optional
        A name that nothing else has: what is prepared of the points waits for `mesh_tile` with
        this ticket, until the process has summed `KEPT_TILES` more. What either task returns
        does not depend on it.
    threads : int
        The result does not depend on it.

    Returns
    -------
    cells, moments, squares
        Of the `pyramid.Level`.
    vertices
        What its points lay there (see `ancestors.corners_at`).
    far_cells, far_sums
        The same of the level that the far field is made of (see `sample_cells`).
    patches : int
        The finest cells with points.
    """
    common = Plan(*plan)
    prepared = _prepare(common, points, ticket is not None, threads)
    if ticket is not None:
        while len(_waiting) >= KEPT_TILES:
            _waiting.pop(next(iter(_waiting), ""), None)
        _waiting[ticket] = prepared
        idle_work.add(partial(_lay_ahead, common, ticket))
    finest, coarse = prepared.levels[0], prepared.levels[-1]
    assert isinstance(finest.points, SortedPoints)  # noqa: S101 - the finest level has points
    starts = finest.points.rows[finest.points.offsets[:-1]]
    own = finest.cells[prepared.groups[starts] == 0]
    marks = mark_ancestors(own, common.coarse, coarse.cells)
    at, vertices = np.flatnonzero(marks), corners_at(coarse.cells, marks)
    moments = coarse.points.sum(slice(0, len(coarse.cells)))[at]
    sampled = prepared.levels[common.far]
    samples = sample_cells(sampled, np.flatnonzero(mark_ancestors(own, common.far, sampled.cells)))
    return coarse.cells[at], moments, coarse.squares[at], vertices, *samples, len(own)


def sample_cells(level: Level, rows: IntArray | None = None) -> tuple[IntArray, FloatArray]:
    """Return what the far field is made of.

    Parameters
    ----------
    level : Level
    rows : ndarray of int64, optional
        Of the level's cells; by default all.

    Returns
    -------
    cells : ndarray of int64, shape (c,)
    sums : ndarray of float64, shape (c, 7)
        Of 1, the positions and the normals of the points in each (see `moments`).
    """
    moments = level.points.sum(slice(0, len(level.cells)))
    sums = np.concatenate([moments[:, :4], moments[:, 35:38]], axis=1)
    return (level.cells, sums) if rows is None else (level.cells[rows], sums[rows])


@declare(cost=lambda _plan, points, *_: estimate_work(points))
def mesh_tile(
    plan: Values,
    points: CellPoints,
    ticket: str | None,
    coarse: Values,
    keep: tuple[str, str] | None = None,
    threads: int = 1,
) -> tuple[Values | None, Values, IntArray]:
    """Reconstruct the surface inside a tile (a task).

    Parameters
    ----------
    plan : tuple
        Of a `Plan`.
    points : tuple
        `CellPoints` of the tile, and of its halo those that belong to tiles before and after it.
    ticket : str or None
        See `sum_tile`.
    coarse : tuple
        Of the `CoarseLevels` around it.
    keep : tuple of str, optional
        A store (see `hpccomponent.store`) and a name, under which the result is put there.
    threads : int
        The result does not depend on it.

    Returns
    -------
    part : tuple or None
        Of a `MeshPart`; None where it is kept.
    summary : tuple
        Of its `PartSummary`.
    exits : ndarray of int64
        Bricks where the surface leaves the tile and there are no points (see `bricks`).
    """
    common = Plan(*plan)
    prepared = _waiting.pop(ticket, None) if ticket is not None else None
    if prepared is None:
        prepared = _prepare(common, points, True, threads)
    if prepared.kinds is None:
        return _give(MeshPart.empty(), np.empty(0, np.int64), keep)
    kinds, levels, laid = prepared.kinds, prepared.levels[: common.coarse], prepared.laid
    del prepared
    return _give(*_mesh_region(common, levels, kinds, laid, coarse, threads), keep)


@declare(cost=lambda _plan, exits, points, *_: len(exits) + estimate_work(points))
def mesh_gap(
    plan: Values,
    exits: IntArray,
    points: CellPoints,
    missing: IntArray,
    coarse: Values,
    keep: tuple[str, str] | None = None,
    threads: int = 1,
) -> tuple[Values | None, Values, IntArray]:
    """Follow the surface from where it left all tiles, as over a hole (a task).

    Parameters
    ----------
    plan : tuple
        Of a `Plan`.
    exits : ndarray of int64
        Keys of the bricks to begin with.
    points : tuple
        `CellPoints` of all that lie around them.
    missing : ndarray of int64
        Keys of the coarse cells of all other points.
    coarse : tuple
        Of all `CoarseLevels`.
    keep : tuple of str, optional
        As of `mesh_tile`.
    threads : int
        The result does not depend on it.

    Returns
    -------
    part, summary, exits
        As those of `mesh_tile`.
    """
    common = Plan(*plan)
    cloud = take_points(points, common.arrangement, common.origin, common.coarse_size).cloud
    low = common.origin + common.coarse_size * unpack_keys(missing)
    kinds = plan_gap(common.grid, exits, cloud.positions, low, common.coarse_size, common.reach)
    levels = []
    if len(cloud):
        finest = sort_level(cloud, common.origin, common.cell_size)
        levels = raise_levels(finest, common.coarse, threads)
    return _give(*_mesh_region(common, levels, kinds, None, coarse, threads), keep)


def _prepare(plan: Plan, points: CellPoints, with_kinds: bool, threads: int) -> _Prepared:
    """Put a tile's points into their cells, and sum these up to the coarse level."""
    kernels.bound_free_memory()  # what tiles before this one have left
    taken = take_points(points, plan.arrangement, plan.origin, plan.coarse_size)
    kinds = None
    if with_kinds:
        kinds = plan_tile(plan.grid, *(taken.positions(group) for group in range(3)))
    finest = sort_level(taken.cloud, plan.origin, plan.cell_size)
    return _Prepared(kinds, taken.groups, raise_levels(finest, plan.coarse + 1, threads))


def _mesh_region(
    plan: Plan,
    levels: list[Level],
    kinds: BrickKinds,
    laid: list[IntArray] | None,
    coarse: Values,
    threads: int,
) -> tuple[MeshPart, IntArray]:
    """Fit the fine levels where bricks may be evaluated, and extract the surface there."""
    coarser = CoarseLevels.from_values(coarse)
    far = restore_far_field(coarser.far)
    fine = tuple(_NO_LEVEL for _ in range(1, min(plan.coarse, FIELD_LEVELS)))
    parents, vertices = None, [_NO_LEVEL.keys]
    if levels:
        parents, vertices = coarser.parents, laid or _lay_near(plan, levels[0].cells, kinds)
    pyramid = Pyramid(plan.origin, plan.cell_size, levels, vertices, 0, plan.height)
    if levels:
        fine, parents = fit_above(pyramid, plan.weights, parents, far, threads)
    above = fine + coarser.levels
    fields = SlabFields(pyramid, plan.weights, parents, above, far, plan.grid, threads)
    return grow_tile(fields, kinds)


def _give(
    part: MeshPart, exits: IntArray, keep: tuple[str, str] | None
) -> tuple[Values | None, Values, IntArray]:
    """Return a part with its summary, or put it where it is kept."""
    values, summary = part.to_values(), summarize_part(part).to_values()
    if keep is None:
        return values, summary, exits
    place, name = keep
    hold_store(place).put(name, (values, summary, exits))
    return None, summary, exits


def _lay_ahead(plan: Plan, ticket: str) -> None:
    """Lay the corners of a tile while it waits to be meshed, as for the coarse quadrics."""
    prepared = _waiting.get(ticket)
    if prepared is not None and prepared.kinds is not None:
        prepared.laid = _lay_near(plan, prepared.levels[0].cells, prepared.kinds)


def _lay_near(plan: Plan, cells: IntArray, kinds: BrickKinds) -> list[IntArray]:
    """Return the corners of each fine level that the bricks of a tile ask for, and ancestors.

    A node asks for the corners around it, up to a cell of their level away, and these are there
    because of finest cells whose middle lies as far again, and half a finest cell, from them. On
    coarser levels, which have few corners, those that the coarsest asks for are laid, and those
    that points are weighed by.
    """
    weighing = 0.0 if np.isinf(plan.tolerance) else 4.0
    lattice = plan.origin, plan.cell_size
    is_near, is_wide = (
        near_bricks(kinds, plan.grid, cells, *lattice, plan.cell_size * reach)
        for reach in (2.75, 2.0**plan.coarse + 0.75 + weighing)
    )
    near, rest = (kernels.spread_keys(cells[some], -1, 2) for some in (is_near, is_wide & ~is_near))
    if plan.coarse == 1:
        return [near]
    wide = kernels.unite_keys(kernels.parent_keys(near), kernels.parent_keys(rest))
    return [near, *lay_vertices(wide, plan.coarse - 1)]
