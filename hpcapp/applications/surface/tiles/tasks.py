"""The tasks of a tile: what its points add to the coarse lattices, and the surface inside it.

::

    sum_tile    points ──> moments of its coarse cells                      ──> master
    solve_far   what all tiles have sampled ──> far field                   ──> master
    master      coarse lattices of all tiles ──> coarse quadrics            ──> tiles
    mesh_tile   points, halo, coarse quadrics, far field ──> fine quadrics ──> bricks ──> MeshPart

A tile is a set of whole cells of one coarse level. Its halo is what surrounds it, so that every
quadric that its bricks ask for is the one that the whole cloud would give, bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from hpcapp.applications.surface.extraction.parts import MeshPart
from hpcapp.applications.surface.extraction.summary import PartSummary, summarize_part
from hpcapp.applications.surface.field.ancestors import corners_at
from hpcapp.applications.surface.field.far_field import (
    FarFieldPart,
    crop_far_field,
    restore_far_field,
    solve_far_field,
)
from hpcapp.applications.surface.field.levels import SlabFields, fit_above
from hpcapp.applications.surface.field.pyramid import Level, Pyramid, raise_levels
from hpcapp.applications.surface.field.weights import FIELD_LEVELS
from hpcapp.applications.surface.tiles.halo import plan_gap
from hpcapp.applications.surface.tiles.patterns import (
    Exits,
    far_field,
    summed_bytes,
    summed_tile,
    surface_bytes,
    tile_surface,
)
from hpcapp.applications.surface.tiles.plan import (
    CoarseLattice,
    CoarseLevels,
    Gap,
    Samples,
    TilePlan,
)
from hpcapp.applications.surface.tiles.points import CellPoints, estimate_work, take_points
from hpcapp.applications.surface.tiles.prepared import PreparedTile, TileCache, finish, lay_corners
from hpcapp.applications.surface.tiles.slabs import grow_tile
from hpcapp.applications.surface.types.result_patterns import SMALL_BYTES
from hpcapp.geometry.lattice import ancestor_keys, unique_keys, unpack_keys
from hpcapp.geometry.points import IntArray
from hpcapp.kernels import BASIS, mark_ancestors
from hpcapp.kernels.freed_memory import leave_for_files
from hpcapp.kernels.types.field import FarField, Features, FieldLevel
from hpccomponent.runtime.background import worker_background
from hpccomponent.runtime.tasks import declare
from hpccomponent.store.places import hold_store

_NO_LEVEL = FieldLevel(
    np.empty(0, np.int64), np.empty((0, BASIS), np.float32), np.empty(0, np.float32)
)


KEPT_TILES = 3
"""So many tiles that a process has summed wait there to be meshed, some 100 bytes a point
where it reads them from a folder, and 130 where it is sent them."""

TILES = TileCache(KEPT_TILES)
"""Of this process."""


@declare(
    cost=lambda _plan, points, *_: estimate_work(points),
    result=summed_tile,
    limit=summed_bytes,
)
def sum_tile(
    plan: TilePlan,
    points: CellPoints,
    ticket: str | None = None,
    keep: tuple[str, str] | None = None,
    own: tuple[IntArray, IntArray] | None = None,
    threads: int = 1,
) -> tuple[CoarseLattice | None, Samples | tuple[str, str], int]:
    """Sum the moments of a tile's points in the cells of the coarse level (a task).

    Return the lattice, what `sample_cells` gives of the level that the far field is made of, and
    the number of finest cells with points. With `keep`, a store (see `store.places`) and a name,
    the lattice is put there, and the samples beside it, if nothing has that name: a tile that is
    summed twice must not replace what is being read. Returned are then None, and the store and the
    name of the samples.

    The points are of the tile alone; with a `ticket`, a name that nothing else has, those that
    `mesh_tile` will be given: what is prepared of them waits for it, until the process has summed
    `KEPT_TILES` more. What either task returns does not depend on it. `own` are keys of the coarse
    cells that hold the tile's own points, and how many each holds: whoever knows them holds the
    lattice against these.
    """
    del own  # it is for who declares, and checks
    prepared = PreparedTile(plan, points, plan.coarse + 1, threads)
    if ticket is not None:
        TILES.put(ticket, prepared)
        worker_background.add(partial(TILES.advance, ticket))
    finest, coarse = prepared.levels[0], prepared.levels[-1]
    # (h,): the finest cells of the tile, without those of its halo.
    held = finest.cells[prepared.groups == 0]
    below = plan.refinement.levels
    of_base = unique_keys(ancestor_keys(held, below)) if below else held
    # (c,): in which of 27 ways the tile's cells lie in each coarse one, a bit each.
    marks = mark_ancestors(of_base, plan.coarse - below, coarse.cells)
    at, vertices = np.flatnonzero(marks), corners_at(coarse.cells, marks)
    moments = coarse.points.sum(slice(0, len(coarse.cells)))[at]
    sampled = prepared.levels[plan.far]
    samples = sample_cells(sampled, np.flatnonzero(mark_ancestors(held, plan.far, sampled.cells)))
    lattice = CoarseLattice(coarse.cells[at], moments, coarse.squares[at], vertices)
    del prepared.levels[plan.coarse :]  # `mesh_tile` is told what all tiles make of them
    if keep is None:
        return lattice, samples, len(held)
    place, name = keep
    beside, store = f"{name}-far", hold_store(place)
    for one, value in ((name, lattice), (beside, samples)):
        store.put(one, value, replaces=False)
    return None, (place, beside), len(held)


def sample_cells(level: Level, rows: IntArray | None = None) -> Samples:
    """Return what the far field is made of: of some rows of a level's cells, or of all."""
    moments = level.points.sum(slice(0, len(level.cells)))
    # (c, 7): the columns of the points, of their positions and of their normals.
    sums = np.concatenate([moments[:, :4], moments[:, 35:38]], axis=1)
    return Samples(level.cells, sums) if rows is None else Samples(level.cells[rows], sums[rows])


def find_far(plan: TilePlan, samples: Samples, threads: int) -> FarField:
    """Solve for the far field by the samples of the whole cloud, sorted by key."""
    size = plan.cell_size * 2.0**plan.far
    sums = samples.sums
    # (c, 3): in cells, as sums of positions are, which count from the middle of each.
    places = unpack_keys(samples.cells) + 0.5 + sums[:, 1:4] / sums[:, :1]
    centroids, normals = plan.origin + size * places, sums[:, 4:] / sums[:, :1]
    box, nodes, missing = plan.grid.box, plan.far_nodes, plan.missing
    return solve_far_field(centroids, normals, box, size, nodes, missing, threads)


@declare(
    result=far_field,
    limit=lambda plan, *_: SMALL_BYTES + 4 * plan.far_nodes**3,
)
def solve_far(
    plan: TilePlan, samples: Sequence[Samples | tuple[str, str]], threads: int = 1
) -> FarFieldPart:
    """Solve for the far field in the plan's `far_box`, by what `sum_tile` tells (a task)."""
    found = [
        some if isinstance(some, Samples) else hold_store(some[0]).get(some[1]) for some in samples
    ]
    cells = np.concatenate([some.cells for some in found])
    sums = np.concatenate([some.sums for some in found])
    order = np.argsort(cells, kind="stable")  # which merges sorted runs
    far = find_far(plan, Samples(cells[order], sums[order]), threads)
    return crop_far_field(far, *plan.far_box)


@declare(
    cost=lambda _plan, points, *_: estimate_work(points),
    result=lambda plan, _points, _ticket, _coarse, keep=None, *_: tile_surface(plan, keep),
    limit=lambda plan, _points, _ticket, coarse, keep=None, *_: surface_bytes(plan, coarse, keep),
)
def mesh_tile(
    plan: TilePlan,
    points: CellPoints,
    ticket: str | None,
    coarse: CoarseLevels,
    keep: tuple[str, str] | None = None,
    threads: int = 1,
) -> tuple[MeshPart | None, PartSummary, Exits]:
    """Reconstruct the surface inside a tile (a task).

    `points` are of the tile, and of its halo those that belong to tiles before and after it;
    `coarse` is what lies around it, `ticket` as of `sum_tile`. With `keep`, a store (see
    `store.places`) and a name, the result is put there, and None is returned for the part.
    """
    prepared = TILES.pop(ticket)
    is_last = ticket is not None and not len(TILES)
    if prepared is None:
        prepared = PreparedTile(plan, points, plan.coarse, threads)
    kinds, corners = prepared.laid()
    if kinds is None:
        return give_part(MeshPart.empty(), np.empty(0, np.int64), keep)
    levels = prepared.levels[: plan.coarse]
    del prepared
    grown = grow_tile(_fit_fields(plan, levels, corners, coarse, threads), kinds)
    return give_part(*grown, keep, is_last)


@declare(
    cost=lambda _plan, gap, points, *_: len(gap.exits) + estimate_work(points),
    result=lambda plan, _gap, _points, _coarse, keep=None, *_: tile_surface(plan, keep),
    limit=lambda plan, _gap, _points, coarse, keep=None, *_: surface_bytes(
        plan, coarse, keep, spans_gaps=True
    ),
)
def mesh_gap(
    plan: TilePlan,
    gap: Gap,
    points: CellPoints,
    coarse: CoarseLevels,
    keep: tuple[str, str] | None = None,
    threads: int = 1,
) -> tuple[MeshPart | None, PartSummary, Exits]:
    """Follow the surface from where it left all tiles, as over a hole (a task).

    `points` are all that lie around the gap's exits, and `coarse` what lies around its box. The
    rest is as of `mesh_tile`.
    """
    taken = take_points(points, plan)
    others = np.concatenate([taken.seed_bricks(plan.grid, 0), gap.held])
    low = plan.origin + plan.coarse_size * unpack_keys(gap.missing)
    there = plan.grid, gap.box, gap.exits, others
    kinds = plan_gap(*there, low, plan.coarse_size, plan.reach)
    levels, corners = [], [_NO_LEVEL.keys]
    if len(taken.finest.cells):
        levels = raise_levels(taken.finest, plan.coarse, threads)
        corners = finish(lay_corners(plan, taken.finest.cells, kinds))
    del taken  # the points leave memory with their level
    return give_part(*grow_tile(_fit_fields(plan, levels, corners, coarse, threads), kinds), keep)


def _fit_fields(
    plan: TilePlan, levels: list[Level], corners: list[IntArray], coarse: CoarseLevels, threads: int
) -> SlabFields:
    """Fit the fine levels but the finest one, which is fitted slab by slab.

    A function of its own, so that nobody else holds what is made here: see `grow_tile`.
    """
    far = restore_far_field(coarse.far)
    in_field = plan.refinement.levels + FIELD_LEVELS
    # Where there are no points all around, the fine levels have no vertices.
    fine = tuple(_NO_LEVEL for _ in range(1, min(plan.coarse, in_field)))
    features: tuple[Features, ...] = ()
    parents = None
    lattice = plan.origin, plan.cell_size
    pyramid = Pyramid(*lattice, levels, corners, 0, plan.height, plan.refinement)
    if levels:
        fine, features, parents = fit_above(pyramid, plan.weights, coarse.parents, far, threads)
    above = fine + coarse.levels
    return SlabFields(pyramid, plan.weights, parents, above, features, far, plan.grid, threads)


def give_part(
    part: MeshPart, exits: IntArray, keep: tuple[str, str] | None, is_last: bool = False
) -> tuple[MeshPart | None, PartSummary, Exits]:
    """Return a part with its summary, or put it where it is kept.

    Of the last tile that was prepared here, what it has left goes before that.
    """
    summary = summarize_part(part)
    if keep is None:
        return part, summary, exits
    place, name = keep
    if is_last:
        leave_for_files()
    hold_store(place).put(name, (part, summary, exits))
    return None, summary, exits
