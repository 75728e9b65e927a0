"""The tasks of a tile: what its points add to the coarse lattices, and the surface inside it.

::

    sum_tile    points ──> moments of its coarse cells                      ──> master
    master      coarse lattices of all tiles ──> coarse quadrics, far field ──> tiles
    mesh_tile   points, halo, coarse quadrics, far field ──> fine quadrics ──> bricks ──> MeshPart

A tile is a set of whole cells of one coarse level. Its halo is what surrounds it, so that every
quadric that its bricks ask for is the one that the whole cloud would give, bit for bit.

Arguments and results are values that travel; the classes here give them names on both ends.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from hpccomponent.store import open_store
from hpccomponent.surface import kernels
from hpccomponent.surface.arrangement import Arrangement
from hpccomponent.surface.bricks import BrickKinds
from hpccomponent.surface.crowding import crowd_vertices
from hpccomponent.surface.far_field import FarField, FarFieldPart, restore_far_field
from hpccomponent.surface.field import Field, FieldLevel, Grid
from hpccomponent.surface.hermite import BASIS
from hpccomponent.surface.lattice import unpack_keys
from hpccomponent.surface.mesh_part import MeshPart, cut_part
from hpccomponent.surface.part_summary import summarize_part
from hpccomponent.surface.points import FloatArray, IntArray, PointCloud
from hpccomponent.surface.pyramid import (
    Level,
    Parents,
    Pyramid,
    VertexQuadrics,
    corners_at,
    fit_levels,
    raise_levels,
    sort_level,
)
from hpccomponent.surface.reach import near_bricks, plan_gap, plan_tile
from hpccomponent.surface.tile_points import CellPoints, take_points
from hpccomponent.surface.weights import FIELD_LEVELS, trust_vertices, weigh_levels

__all__ = [
    "CoarseLevels",
    "Plan",
    "Values",
    "find_trust",
    "mesh_gap",
    "mesh_tile",
    "sample_cells",
    "sum_tile",
]

_TRUST_ROWS = 1 << 16
_NO_LEVEL = FieldLevel(
    np.empty(0, np.int64), np.empty((0, BASIS), np.float32), np.empty(0, np.float32)
)

Values = tuple[Any, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """What all tiles of a cloud have in common.

    Parameters
    ----------
    origin : ndarray of float64, shape (3,)
        Where corner (0, 0, 0) of every lattice lies.
    cell_size : float
        Edge of the finest cells, in length units of the input.
    height : int
        How many levels the cloud has.
    coarse : int
        The level of whose cells tiles are made; `height` where there is but one tile.
    noise : float
        Standard deviation of the positions along the normals, in length units of the input.
    grid_origin : ndarray of float64, shape (3,)
    step : float
    bricks : tuple of int
        See `field.Grid`.
    block_origin : ndarray of float64, shape (3,)
    block_edge : float
        See `arrangement.Arrangement`.
    far : int
        The level whose cells the far field is made of.
    """

    origin: FloatArray
    cell_size: float
    height: int
    coarse: int
    noise: float
    grid_origin: FloatArray
    step: float
    bricks: tuple[int, int, int]
    block_origin: FloatArray
    block_edge: float
    far: int

    def to_values(self) -> Values:
        """Return what a task may be given."""
        return tuple(getattr(self, field.name) for field in fields(self))

    @property
    def coarse_size(self) -> float:
        """Edge of the coarse cells, in length units of the input."""
        return self.cell_size * 2.0**self.coarse

    @property
    def grid(self) -> Grid:
        """The evaluation grid."""
        return Grid(self.grid_origin, self.step, self.bricks)

    @property
    def arrangement(self) -> Arrangement:
        """The blocks that points are packed by."""
        return Arrangement(self.block_origin, self.block_edge)


@dataclass(frozen=True, slots=True, eq=False)
class CoarseLevels:
    """What a tile must know of the levels that the master has fitted.

    Parameters
    ----------
    parents : Parents
        What the finest of them offers to the next finer level.
    levels : tuple of FieldLevel
        Those of them that the field is made of, finest first.
    far : FarFieldPart
        The far field.
    """

    parents: Parents
    levels: tuple[FieldLevel, ...]
    far: FarFieldPart

    def to_values(self) -> Values:
        """Return what a task may be given."""
        above = self.parents
        return (
            (above.keys, above.coefficients, above.support, above.variances),
            tuple((level.keys, level.coefficients, level.trust) for level in self.levels),
            self.far.to_values(),
        )

    @classmethod
    def from_values(cls, values: Values) -> CoarseLevels:
        """Return what `to_values` took apart."""
        parents, levels, far = values
        return cls(
            Parents(*parents), tuple(FieldLevel(*level) for level in levels), FarFieldPart(*far)
        )


def sum_tile(plan: Values, points: CellPoints, threads: int = 1) -> Values:
    """Sum the moments of a tile's points in the cells of the coarse level (a task).

    Parameters
    ----------
    plan : tuple
        Of a `Plan`.
    points : tuple
        `CellPoints` of the tile alone.
    threads : int
        The result does not depend on it.

    Returns
    -------
    cells, moments, squares
        Of the `pyramid.Level`.
    vertices
        What its points lay there (see `pyramid.corners_at`).
    far_cells, far_sums
        The same of the level that the far field is made of (see `sample_cells`).
    patches : int
        The finest cells with points.
    """
    common = Plan(*plan)
    (cloud,) = _take(points, common)
    finest = sort_level(cloud, common.origin, common.cell_size)
    levels = raise_levels(finest, common.coarse + 1, threads)
    coarse = levels[-1]
    moments = coarse.points.sum(slice(0, len(coarse.cells)))
    vertices = corners_at(finest.cells, common.coarse)
    samples = sample_cells(levels[min(common.far, common.coarse)])
    return coarse.cells, moments, coarse.squares, vertices, *samples, len(finest.cells)


def sample_cells(level: Level) -> tuple[IntArray, FloatArray]:
    """Return what the far field is made of.

    Parameters
    ----------
    level : Level

    Returns
    -------
    cells : ndarray of int64, shape (c,)
    sums : ndarray of float64, shape (c, 7)
        Of 1, the positions and the normals of the points in each (see `moments`).
    """
    moments = level.points.sum(slice(0, len(level.cells)))
    return level.cells, np.concatenate([moments[:, :4], moments[:, 35:38]], axis=1)


def mesh_tile(
    plan: Values,
    points: CellPoints,
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
    clouds = _take(points, common)
    kinds = plan_tile(common.grid, *(cloud.positions for cloud in clouds))
    if kinds is None:
        return _give(MeshPart.empty(), np.empty(0, np.int64), keep)
    return _give(*_mesh_region(common, _join(clouds), kinds, coarse, threads), keep)


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
    (cloud,) = _take(points, common)
    low = common.origin + common.coarse_size * unpack_keys(missing)
    reach = common.coarse_size + 2.0 * common.cell_size
    kinds = plan_gap(common.grid, exits, cloud.positions, low, common.coarse_size, reach)
    return _give(*_mesh_region(common, cloud, kinds, coarse, threads), keep)


def find_trust(
    pyramid: Pyramid, quadrics: list[VertexQuadrics], far: FarField
) -> tuple[FieldLevel, ...]:
    """Tell how far each quadric of some levels is to be trusted (see `weights`).

    Parameters
    ----------
    pyramid : Pyramid
    quadrics : list of VertexQuadrics
        Of its finest levels.
    far : FarField

    Returns
    -------
    tuple of FieldLevel
    """
    found = []
    for index, of_level in enumerate(quadrics):
        level, keys, depth = pyramid.levels[index], pyramid.vertices[index], pyramid.first + index
        crowds = (
            crowd_vertices(keys, of_level.counts, level.cells, level.squares)
            if depth
            else np.zeros(len(keys))
        )
        trust = np.empty(len(keys), np.float32)
        origin = (pyramid.origin - far.origin) / far.step
        spacing = pyramid.cell_size * 2.0**depth / far.step
        for start in range(0, len(keys), _TRUST_ROWS):
            rows = slice(start, start + _TRUST_ROWS)
            distances = kernels.sample_corners(far.values, keys[rows], origin, spacing) / far.step
            trust[rows] = trust_vertices(
                of_level.coefficients[rows, 0], distances, of_level.counts[rows],
                of_level.inherited[rows], crowds[rows], depth,
            )  # fmt: skip
        found.append(FieldLevel(keys, of_level.coefficients, trust))
    return tuple(found)


def _mesh_region(
    plan: Plan, cloud: PointCloud, kinds: BrickKinds, coarse: Values, threads: int
) -> tuple[MeshPart, IntArray]:
    """Fit the fine levels where bricks may be evaluated, and extract the surface there."""
    above = CoarseLevels.from_values(coarse)
    far = restore_far_field(above.far)
    levels = tuple(_NO_LEVEL for _ in range(min(plan.coarse, FIELD_LEVELS)))
    if len(cloud):
        finest = sort_level(cloud, plan.origin, plan.cell_size)
        vertices = _lay_near(finest.cells, plan, kinds)
        raised = raise_levels(finest, plan.coarse, threads)
        pyramid = Pyramid(plan.origin, plan.cell_size, raised, vertices, 0, plan.height)
        weights = weigh_levels(plan.cell_size, plan.height, plan.noise)
        quadrics, _ = fit_levels(pyramid, weights, above.parents, threads)
        levels = find_trust(pyramid, quadrics, far)
    field = Field(plan.origin, plan.cell_size, levels + above.levels, far)
    mesh = kernels.grow_surface(field, plan.grid, kinds, threads)
    balanced = kernels.balance_vertices(mesh.vertices, mesh.faces, plan.step)
    part = cut_part(replace(mesh, vertices=balanced), kinds)
    return part, mesh.exits


def _give(
    part: MeshPart, exits: IntArray, keep: tuple[str, str] | None
) -> tuple[Values | None, Values, IntArray]:
    """Return a part with its summary, or put it where it is kept."""
    values, summary = part.to_values(), summarize_part(part).to_values()
    if keep is None:
        return values, summary, exits
    place, name = keep
    open_store(place).put(name, (values, summary, exits))
    return None, summary, exits


def _lay_near(cells: IntArray, plan: Plan, kinds: BrickKinds) -> list[IntArray]:
    """Return the corners of each fine level that the bricks of a tile ask for, and ancestors.

    A node asks for the corners around it, up to a cell of their level away, and these are there
    because of finest cells whose middle lies as far again, and half a finest cell, from them.
    """
    places = plan.origin + plan.cell_size * (unpack_keys(cells) + 0.5)
    laid: list[IntArray] = []
    for depth in range(plan.coarse):
        reach = plan.cell_size * (2.0 ** (depth + 1) + 0.75)
        corners = corners_at(cells[near_bricks(kinds, plan.grid, places, reach)], depth)
        parents = kernels.parent_keys(laid[-1]) if laid else corners
        laid.append(kernels.unite_keys(corners, parents))
    return laid


def _take(points: CellPoints, plan: Plan) -> list[PointCloud]:
    """Return the points that a task has been given."""
    return take_points(points, plan.arrangement, plan.origin, plan.coarse_size)


def _join(clouds: list[PointCloud]) -> PointCloud:
    """Return the points of some clouds with normals, one after the other."""
    normals = [cloud.normals for cloud in clouds if cloud.normals is not None]
    return PointCloud(
        np.concatenate([cloud.positions for cloud in clouds]), np.concatenate(normals)
    )
