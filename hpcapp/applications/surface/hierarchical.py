"""The default method: hierarchical Hermite quadrics, blended by a partition of unity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hpcapp.applications.surface.crowding import crowd_vertices
from hpcapp.applications.surface.estimates import Scale, choose_scale
from hpcapp.applications.surface.method import Advance
from hpcapp.applications.surface.pyramid import (
    Level,
    Pyramid,
    VertexQuadrics,
    build_pyramid,
    fit_levels,
)
from hpcapp.applications.surface.weights import Weights, trust_vertices, weigh_levels
from hpcapp.batches import Workforce
from hpccomponent.errors import InputError, UsageError
from hpccomponent.surface import kernels
from hpccomponent.surface.extraction import drop_small_components
from hpccomponent.surface.far_field import FarField, far_step, solve_far_field
from hpccomponent.surface.field import BRICK, Field, FieldLevel, Grid
from hpccomponent.surface.lattice import unpack_keys
from hpccomponent.surface.mesh import Mesh
from hpccomponent.surface.points import FloatArray, IntArray, PointCloud, bounding_box

__all__ = ["MARGIN", "HierarchicalMethod", "HierarchicalPartition", "plan_grid"]

MARGIN = 4
"""Cells of the grid that stay free on each side of the cloud."""

_LEAST_GRID = 16
_FAR_CELLS = 0.5  # steps of the far field, which samples no smaller cells than these
_TRUST_ROWS = 1 << 16


@dataclass(frozen=True, slots=True, eq=False)
class HierarchicalPartition:
    """A cloud cut into cells.

    Parameters
    ----------
    cloud : PointCloud
    grid : Grid
    scale : Scale
    weights : list of Weights
        Of the fits of each level, finest first.
    pyramid : Pyramid
    far : FarField
    """

    cloud: PointCloud
    grid: Grid
    scale: Scale
    weights: list[Weights]
    pyramid: Pyramid
    far: FarField


class HierarchicalMethod:
    """Reconstruct with hierarchical Hermite quadrics.

    Parameters
    ----------
    grid : int
        Cells of the evaluation grid along its longest side, 16 or more.
    smoothness : float
        Above 1, noise is taken for larger than it is estimated: smoother. Dimensionless.
    detail : float
        Above 1, cells are smaller: more detail, less averaging. Dimensionless.
    threads : int
        How many threads the far field and the extraction take; the mesh does not depend on it.

    Raises
    ------
    UsageError
        The grid is too small, or a factor is not positive.
    """

    name = "hierarchical"

    def __init__(
        self,
        grid: int = 256,
        smoothness: float = 1.0,
        detail: float = 1.0,
        threads: int = 1,
    ) -> None:
        if grid < _LEAST_GRID:
            raise UsageError(
                f"a grid of {grid} cells is too coarse", f"ask for {_LEAST_GRID} or more"
            )
        for word, factor in (("smoothness", smoothness), ("detail", detail)):
            if not (factor > 0.0 and np.isfinite(factor)):
                raise UsageError(f"{word} is {factor}", "give a positive number; 1 is the default")
        self.grid = grid
        self.smoothness = smoothness
        self.detail = detail
        self.threads = threads

    def partition(self, cloud: PointCloud, workforce: Workforce) -> HierarchicalPartition:
        """Find spacing, noise and cell size, and sum the moments of the points in each cell.

        Parameters
        ----------
        cloud : PointCloud
            With normals.
        workforce : Workforce

        Returns
        -------
        HierarchicalPartition

        Raises
        ------
        InputError
            There are no normals, or all points are the same.
        """
        if cloud.normals is None or not len(cloud):
            raise InputError("the cloud has no points with normals", "give oriented points")
        grid = plan_grid(cloud.positions, self.grid)
        scale = choose_scale(cloud, grid.step, self.smoothness, self.detail, workforce)
        pyramid = build_pyramid(cloud, scale.cell_size, workforce)
        noise = scale.noise * self.smoothness
        weights = weigh_levels(scale.cell_size, len(pyramid.levels), noise)
        far = _solve_far_field(grid, pyramid, self.threads)
        return HierarchicalPartition(cloud, grid, scale, weights, pyramid, far)

    def fit(
        self, partition: HierarchicalPartition, workforce: Workforce, advance: Advance
    ) -> list[VertexQuadrics]:
        """Fit a quadric to every vertex of the lattices, coarse to fine, on the workers."""
        return fit_levels(partition.pyramid, partition.weights, workforce, advance)

    def extract(
        self, partition: HierarchicalPartition, quadrics: list[VertexQuadrics], advance: Advance
    ) -> Mesh:
        """Blend the quadrics over the far field and extract the surface, brick by brick.

        The list is empty afterwards: what it held is most of the memory.

        Raises
        ------
        InputError
            No node lies inside: the normals contradict one another.
        """
        grid = partition.grid
        field = assemble_field(partition, quadrics)
        quadrics.clear()  # all that is left of them is in the field
        seeds = kernels.seed_bricks(grid, partition.cloud.positions)
        vertices, faces = kernels.grow_surface(field, grid, seeds, self.threads)
        del field
        mesh = drop_small_components(Mesh(vertices, faces))
        advance(len(seeds), len(seeds))
        if not len(mesh.faces):
            raise InputError(
                "no part of the cloud encloses a volume",
                "check that the normals point out of the object, and try a finer --grid",
            )
        balanced = kernels.balance_vertices(mesh.vertices, mesh.faces)
        return Mesh(balanced, mesh.faces, partition.cloud.origin)

    def facts(self, partition: HierarchicalPartition) -> dict[str, Any]:
        """Return the estimates, and how many quadrics the finest level has."""
        return {
            "patches": len(partition.pyramid.levels[0].touched),
            "spacing": partition.scale.spacing,
            "noise": partition.scale.noise,
            "cell_size": partition.scale.cell_size,
            "lam": partition.weights[0].lam,
            "levels": len(partition.pyramid.levels),
        }


def plan_grid(positions: FloatArray, cells: int) -> Grid:
    """Lay the evaluation grid around a cloud, with four cells to spare on each side.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
        In length units of the input.
    cells : int
        Along the longest side, margins included.

    Returns
    -------
    Grid
        Centred on the cloud, each side a whole number of bricks.

    Raises
    ------
    InputError
        All points are the same.
    """
    low, high = bounding_box(positions)
    longest = float((high - low).max())
    if longest <= 0.0:
        raise InputError("all points lie at one place", "scan something with an extent")
    step = longest / (cells - 2 * MARGIN)
    sides = np.ceil((high - low) / step + 2 * MARGIN - 1e-9)
    x, y, z = (int(bricks) for bricks in np.ceil(sides / BRICK))
    half = 0.5 * BRICK * step * np.array([x, y, z])
    return Grid(0.5 * (low + high) - half, step, (x, y, z))


def assemble_field(partition: HierarchicalPartition, quadrics: list[VertexQuadrics]) -> Field:
    """Put the quadrics of some levels, their trust and the far field together.

    Parameters
    ----------
    partition : HierarchicalPartition
    quadrics : list of VertexQuadrics
        Of the finest levels, finest first.

    Returns
    -------
    Field
    """
    pyramid = partition.pyramid
    levels = []
    for depth, of_level in enumerate(quadrics):
        level = pyramid.levels[depth]
        keys = level.vertices
        crowds = (
            crowd_vertices(keys, of_level.counts, level.cells, level.squares)
            if depth
            else np.zeros(len(keys))
        )
        trust = np.empty(len(keys), np.float32)
        for start in range(0, len(keys), _TRUST_ROWS):
            rows = slice(start, start + _TRUST_ROWS)
            far = _sample_far_field(partition, keys[rows], depth)
            values, counts = of_level.coefficients[rows, 0], of_level.counts[rows]
            inherited = of_level.inherited[rows]
            trust[rows] = trust_vertices(values, far, counts, inherited, crowds[rows], depth)
        levels.append(FieldLevel(keys, of_level.coefficients, trust))
    return Field(pyramid.origin, pyramid.cell_size, tuple(levels), partition.far)


def _sample_far_field(partition: HierarchicalPartition, keys: IntArray, depth: int) -> FloatArray:
    """Return the far field, in its own steps, at some vertices of a level."""
    pyramid, far = partition.pyramid, partition.far
    origin = (pyramid.origin - far.origin) / far.step
    spacing = pyramid.cell_size * 2.0**depth / far.step
    return kernels.sample_corners(far.values, keys, origin, spacing) / far.step


def _solve_far_field(grid: Grid, pyramid: Pyramid, threads: int) -> FarField:
    """Solve for the far field of the cells of one level: centroids and mean normals.

    Each cell counts once: its area, not its points, is what a scan's uneven density leaves
    alone. So its cells must not be so small that most of them are empty where points are few.
    """
    low, high = grid.origin, grid.origin + grid.step * BRICK * np.array(grid.bricks)
    level, size = _find_level(pyramid, _FAR_CELLS * far_step(low, high))
    moments = level.points.sum(slice(0, len(level.cells)))
    places = unpack_keys(level.cells) + 0.5 + moments[:, 1:4] / moments[:, :1]
    centroids = pyramid.origin + size * places
    normals = moments[:, 35:38] / moments[:, :1]
    del moments
    return solve_far_field(centroids, normals, (low, high), size, threads)


def _find_level(pyramid: Pyramid, least: float) -> tuple[Level, float]:
    """Return the finest level whose cells are not smaller than `least`, and their size."""
    size = pyramid.cell_size
    for level in pyramid.levels[:-1]:
        if size >= least:
            return level, size
        size *= 2.0
    return pyramid.levels[-1], size
