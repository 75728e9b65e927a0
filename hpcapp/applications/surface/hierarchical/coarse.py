"""What the master computes itself: the coarse levels of all tiles together."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

import numpy as np

from hpcapp.applications.surface.cloud.arranged import CloudMeasures
from hpcapp.applications.surface.cloud.measure import SAMPLED_BOX
from hpcapp.applications.surface.field.cell_points import PartMoments
from hpcapp.applications.surface.field.far_field import (
    FEWEST_NODES,
    crop_far_field,
    far_step,
    restore_far_field,
)
from hpcapp.applications.surface.field.levels import find_trust
from hpcapp.applications.surface.field.pyramid import (
    Level,
    Parents,
    Pyramid,
    VertexQuadrics,
    fit_levels,
    lay_vertices,
    raise_levels,
)
from hpcapp.applications.surface.tiles.halo import halo_steps, mark_near
from hpcapp.applications.surface.tiles.plan import CoarseLattice, CoarseLevels, Samples, TilePlan
from hpcapp.applications.surface.tiles.tasks import solve_far
from hpcapp.geometry.lattice import (
    ancestor_keys,
    cells_of,
    find_keys,
    find_within,
    lay_lattice,
    number_keys,
    pack_places,
    unique_keys,
    unpack_keys,
)
from hpcapp.geometry.points import FloatArray, IntArray, PointCloud
from hpcapp.kernels.types.field import FarField, FieldLevel
from hpcapp.kernels.types.grid import BRICK, Grid
from hpcapp.workforce import Workforce, begin_batch
from hpccomponent.dataclass import dataclass

Quadrics = TypeVar("Quadrics", Parents, FieldLevel)

_MOST_NODES = 256
_BLURRED = 4.0  # standard deviations of the noise: shape that is smaller is not told from it
_FOLD = 3.0  # steps of the coarser far field: how near sheets lie that it confuses
_CANCELLED = 0.5  # length of a mean normal
_FOLDED = 0.03  # share of the points from which on a finer far field pays
_HARDLY_FAR = 2.0**-4  # steps of the far field: see `Coarse.anchored`
_HARDLY = {"coefficients": 2.0**-8, "support": 2.0**-5, "variances": 2.0**-5, "trust": 2.0**-5}
_FAR_CELLS = 0.5  # steps of the far field, which samples no smaller cells than these


@dataclass(frozen=True, slots=True, eq=False)
class Coarse:
    """The levels that the master has fitted, of the whole cloud.

    `parents` are what the level of the tiles' cells offers to the next finer one, `levels` those
    that the field is made of: that level first, if any.
    """

    plan: TilePlan
    parents: Parents
    levels: tuple[FieldLevel, ...]
    far: FarField

    def around(self, cells: IntArray) -> CoarseLevels:
        """Return what a tile must know, from the keys of its coarse cells, (c,).

        It is of their surroundings, as far as the tile's quadrics reach.
        """
        plan = self.plan
        reach = halo_steps(plan.grid) * plan.step
        size = plan.cell_size * 2.0**plan.coarse
        wide = int(np.ceil((reach + BRICK * plan.step + 3.0 * size) / size))
        rows = _find_around(self.parents.keys, cells, wide)
        above = self.parents
        parents = Parents(
            above.keys[rows], above.coefficients[rows], above.support[rows], above.variances[rows]
        )
        trust = self.levels[0].trust[rows] if self.levels else None
        levels = []
        for depth, level in enumerate(self.levels[1:], start=1):
            coarser = unique_keys(ancestor_keys(cells, depth))
            rows = _find_around(level.keys, coarser, int(np.ceil(reach / (size * 2**depth))) + 1)
            levels.append(FieldLevel(level.keys[rows], level.coefficients[rows], level.trust[rows]))
        places = unpack_keys(cells)
        margin = reach + 2.0 * size
        low = plan.origin + size * places.min(axis=0) - margin
        high = plan.origin + size * (places.max(axis=0) + 1) + margin
        return CoarseLevels(parents, trust, tuple(levels), crop_far_field(self.far, low, high))

    def within(self, low: FloatArray, high: FloatArray) -> CoarseLevels:
        """Return what must be known to evaluate in a box, and a brick and a rim beyond it.

        `low` and `high` (3,) are in length units of the input.
        """
        plan, above = self.plan, self.parents
        size = plan.cell_size * 2.0**plan.coarse
        margin = (halo_steps(plan.grid) + BRICK) * plan.step

        def find(keys: IntArray, edge: float) -> IntArray:
            """Return the rows of a level's corners there."""
            far = margin + 3.0 * edge
            ends = np.floor((np.stack([low - far, high + far]) - plan.origin) / edge)
            return find_within(keys, *ends.astype(np.int64))

        rows = find(above.keys, size)
        parents = Parents(
            above.keys[rows], above.coefficients[rows], above.support[rows], above.variances[rows]
        )
        trust = self.levels[0].trust[rows] if self.levels else None
        coarser = []
        for depth, level in enumerate(self.levels[1:], start=1):
            rows = find(level.keys, size * 2**depth)
            kept = FieldLevel(level.keys[rows], level.coefficients[rows], level.trust[rows])
            coarser.append(kept)
        far = crop_far_field(self.far, low - margin - 3.0 * size, high + margin + 3.0 * size)
        return CoarseLevels(parents, trust, tuple(coarser), far)

    def anchored(self, known: CoarseLevels) -> Coarse:
        """Return the same with what is `known` of an earlier job wherever that is hardly another.

        A point that is added changes all of it in the last digits, and each tile is named by all
        that it is told. Hardly another is a value of the far field that is `_HARDLY_FAR` off, and a
        quadric of which nothing is more than `_HARDLY` off, in cells, and of 1 or of what it was.
        """
        far, before = self.far, restore_far_field(known.far)
        if far.values.shape == before.values.shape:
            is_near = np.abs(far.values - before.values) <= _HARDLY_FAR * far.step
            far = replace(far, values=np.where(is_near, before.values, far.values))
        of_level = known.levels if known.trust is not None else known.coarser
        levels = tuple(anchor_quadrics(*of) for of in zip(self.levels, of_level, strict=True))
        return replace(
            self, parents=anchor_quadrics(self.parents, known.parents), levels=levels, far=far
        )

    def whole(self) -> CoarseLevels:
        """Return all of it."""
        low = self.far.origin
        high = low + self.far.step * len(self.far.values)
        far = crop_far_field(self.far, low, high)
        trust = self.levels[0].trust if self.levels else None
        return CoarseLevels(self.parents, trust, self.levels[1:], far)


def anchor_quadrics(found: Quadrics, known: Quadrics) -> Quadrics:
    """Return some quadrics, those of the same vertices that are hardly others as they are known."""
    rows = find_keys(known.keys, found.keys)
    columns = [name for name in found.__dataclass_fields__ if name != "keys"]
    is_near = rows < len(known.keys)
    rows = np.where(is_near, rows, 0)
    for name in columns if len(known.keys) else ():
        new, old = getattr(found, name), getattr(known, name)[rows]
        most = _HARDLY[name] * np.maximum(1.0, np.abs(old))
        is_near &= (np.abs(new - old) <= most).reshape(len(rows), -1).all(axis=1)
    kept: dict[str, Any] = {}
    for name in columns:
        kept[name] = getattr(found, name).copy()
        kept[name][is_near] = getattr(known, name)[rows[is_near]]
    return replace(found, **kept)


def choose_nodes(
    box: tuple[FloatArray, FloatArray], cell_size: float, noise: float, measured: CloudMeasures
) -> int:
    """Choose how fine a far field is: no finer than what the points resolve, and than it pays.

    Where sheets lie back to back within a few steps, as drapery and thin walls do, a finer one
    keeps them apart. Elsewhere it tells nothing that a coarse one does not. `box` has the low and
    the high corner, (3,), of what it covers; the noise is the standard deviation of positions along
    normals. A cloud whose sample has too small boxes to tell is taken for folded.
    """
    step = far_step(*box, FEWEST_NODES)
    if max(cell_size, _BLURRED * noise) >= step:
        return FEWEST_NODES
    edge = _FOLD * step
    tells = SAMPLED_BOX * measured.spacing >= edge
    return FEWEST_NODES if tells and _find_folded(measured.sample, edge) < _FOLDED else _MOST_NODES


def _find_folded(sample: PointCloud, edge: float) -> float:
    """Return the share of some points that lie in cubes where normals cancel each other."""
    assert sample.normals is not None  # noqa: S101 - they were measured
    corner = lay_lattice(sample.positions.min(axis=0), edge)
    places = np.floor(cells_of(sample.positions, corner, edge)).astype(np.int64)
    cubes, number = number_keys(pack_places(places))
    counts = np.bincount(number)
    sums = [np.bincount(number, normals, len(cubes)) for normals in sample.normals.T]
    lengths = np.sqrt(sum(of * of for of in sums))
    return float(counts[lengths < _CANCELLED * counts].sum() / len(number))


def far_level(grid: Grid, nodes: int, cell_size: float, base: int, height: int) -> int:
    """Return the finest level whose cells a far field of so many `nodes` along a side may sample.

    It is from `base`, whose cells are as large as the points of the whole cloud ask for, to
    `height` - 1. Cells count, not points: a scan's uneven density is left alone where all cells
    have some. They must not be so small that most are empty; `cell_size` is that of the finest.
    """
    level = base
    least = _FAR_CELLS * far_step(*grid.box, nodes)
    while level < height - 1 and cell_size * 2.0**level < least:
        level += 1
    return level


def fit_coarse(
    plan: TilePlan,
    lattices: list[CoarseLattice],
    samples: list[Samples | tuple[str, str]],
    workforce: Workforce,
    threads: int,
) -> Coarse:
    """Put the coarse cells of all tiles together, and fit the levels from there up.

    A worker solves for the far field meanwhile. `lattices` and `samples` are what `tiles.sum_tile`
    gave of each tile, in any order; the first is emptied: most of it is needed but once.
    """
    task = plan, samples, threads if workforce.in_process else 1
    with begin_batch(workforce, solve_far, task) as solved:
        pyramid, quadrics, parents = _fit(plan, lattices, threads)
        far = restore_far_field(solved())
    return Coarse(plan, parents, find_trust(pyramid, quadrics, far, threads), far)


def _fit(
    plan: TilePlan, lattices: list[CoarseLattice], threads: int
) -> tuple[Pyramid, list[VertexQuadrics], Parents]:
    """Fit the levels from the tiles' one up."""
    keys = [lattice.cells for lattice in lattices]
    moments = [lattice.moments for lattice in lattices]
    squares = [lattice.squares for lattice in lattices]
    corners = [lattice.vertices for lattice in lattices]
    lattices.clear()
    cells, order, rows = _sort(keys)
    level = Level(cells, PartMoments(moments, rows), np.concatenate(squares)[order])
    vertices = unique_keys(np.concatenate(corners))
    height = plan.height - plan.coarse
    levels = raise_levels(level, height, threads)
    laid = lay_vertices(vertices, height)
    lattice = plan.origin, plan.cell_size
    whole = plan.height, plan.refinement
    pyramid = Pyramid(*lattice, levels, laid, plan.coarse, *whole)
    quadrics, parents = fit_levels(pyramid, plan.weights, None, threads)
    moments.clear()  # no level has them any more
    assert parents is not None  # noqa: S101 - tiles have finer levels
    return pyramid, quadrics, parents


def _sort(parts: list[IntArray]) -> tuple[IntArray, IntArray, list[IntArray]]:
    """Return the keys of all parts in their order, this, and where those of each part stand."""
    keys = np.concatenate(parts)
    order = np.argsort(keys, kind="stable")  # which merges sorted runs
    rows = np.empty_like(order)
    rows[order] = np.arange(len(order))
    return keys[order], order, np.split(rows, np.cumsum([len(part) for part in parts])[:-1])


def _find_around(keys: IntArray, cells: IntArray, wide: int) -> IntArray:
    """Return the rows of the corners that lie within so many cells of some cells."""
    found: IntArray = np.flatnonzero(mark_near(keys, cells, wide, wide + 1))
    return found
