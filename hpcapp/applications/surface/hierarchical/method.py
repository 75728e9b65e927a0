"""The default method: hierarchical Hermite quadrics, blended by a partition of unity.

::

    scale ─> tiles ─> coarse sums of each tile ─> coarse quadrics, far field ─> surface in each tile
                      (workers)                   (master)         (a worker)   (workers)   ─> weld
"""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hpcapp.applications.surface.boundary.drive import (
    Closure,
    OpeningSettings,
    close_surface,
)
from hpcapp.applications.surface.checkpoint import Checkpoint
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.cloud.point_workers import PointWorkers
from hpcapp.applications.surface.field.pyramid import count_levels
from hpcapp.applications.surface.field.refinement import Refinement
from hpcapp.applications.surface.hierarchical.all_tiles import mesh_all_tiles
from hpcapp.applications.surface.hierarchical.coarse import (
    FEWEST_NODES,
    Coarse,
    choose_nodes,
    far_level,
    fit_coarse,
)
from hpcapp.applications.surface.hierarchical.estimates import Scale, choose_scale
from hpcapp.applications.surface.hierarchical.one_tile import mesh_one_tile
from hpcapp.applications.surface.hierarchical.strides import choose_strides
from hpcapp.applications.surface.hierarchical.tiles import Tiling
from hpcapp.applications.surface.method import (
    LARGE_TILE,
    MARGIN,
    TILE_POINTS,
    TILES_EACH,
    Advance,
    ShowPart,
    show_nothing,
)
from hpcapp.applications.surface.surface import Surface
from hpcapp.applications.surface.tiles.patterns import coarse_lattice
from hpcapp.applications.surface.tiles.plan import CoarseLattice, Plan, Samples
from hpcapp.applications.surface.tiles.tasks import sum_tile
from hpcapp.applications.surface.types.grid import BRICK, MOST_SHIFT, Grid
from hpcapp.geometry.lattice import lay_lattice
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.workforce import Workforce, stream_batches
from hpccomponent.errors import InputError, UsageError
from hpccomponent.option_names import name_option

_LEAST_GRID = 16
_POINTS_AT_ONCE = 2_000_000
_EXACT = 1e-3  # steps: equal sides have equally many
_ROBUST_LEVELS = 2  # whose fits ask the points themselves, where these are weighed


@dataclass(slots=True, eq=False)
class HierarchicalPartition:
    """A cloud cut into tiles.

    Parameters
    ----------
    cloud : ArrangedCloud
    scale : Scale
    plan : Plan
    tiling : Tiling or None
        None where the cloud is one tile, and made into a mesh here.
    patches : int
        Finest cells with points, once they are counted.
    closure : Closure or None
        How the borders of the surface came about, once it is there.
    """

    cloud: ArrangedCloud
    scale: Scale
    plan: Plan
    tiling: Tiling | None
    patches: int = 0
    closure: Closure | None = None


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
    tile_points : int, optional
        Of a tile at most, about; the mesh does not depend on it. By default a cloud in memory is
        one tile where tasks run in this process.
    checkpoint : Checkpoint, optional
        Where finished tiles are kept; by default they come back to this process.
    show_part : callable
        Told of each part of the mesh as it comes; see `Resources`.
    opening : OpeningSettings
        Whether, and where, the surface is cut open; by default it is closed.
    uniform : bool
        Whether the grid has one step, however uneven the points lie.

    Raises
    ------
    UsageError
        The grid is too small, or a factor is not positive.
    """

    def __init__(
        self,
        grid: int = 256,
        smoothness: float = 1.0,
        detail: float = 1.0,
        threads: int = 1,
        tile_points: int | None = None,
        checkpoint: Checkpoint | None = None,
        show_part: ShowPart = show_nothing,
        opening: OpeningSettings | None = None,
        uniform: bool = False,
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
        self.tile_points = tile_points
        self.checkpoint = checkpoint
        self.show_part = show_part
        self.opening = OpeningSettings() if opening is None else opening
        self.uniform = uniform

    def partition(self, cloud: ArrangedCloud, workforce: Workforce) -> HierarchicalPartition:
        """Find spacing, noise and cell size, and cut the cloud into tiles.

        Parameters
        ----------
        cloud : ArrangedCloud
            With normals.
        workforce : Workforce

        Raises
        ------
        InputError
            There are no normals, or all points are the same.
        """
        low, high, measured = cloud.low, cloud.high, cloud.measured
        grid = plan_grid(low, high, self.grid)
        scale = choose_scale(measured, grid.step, self.smoothness, self.detail, self.threads)
        below = scale.levels
        origin = lay_lattice(low, scale.finest)
        noise = scale.noise.scaled(self.smoothness)
        given = scale.spacings, measured.scale, origin, scale.finest, noise
        refinement = Refinement(below, *given)
        are_read = workforce.in_process or self._find_shared(cloud) is not None
        workers = PointWorkers(workforce, are_read, _POINTS_AT_ONCE)
        if below and not self.uniform:
            wide = plan_grid(low, high, self.grid, MARGIN << MOST_SHIFT)
            seeds, _ = workers.count_cells(cloud, wide.origin, BRICK * wide.step)
            if (strides := choose_strides(wide, seeds, refinement)) is not None:
                grid = replace(wide, strides=strides)
        height = scale.finer + count_levels(float((high - low).max()), scale.cell_size)
        height = max(height, below + 1)
        nodes = choose_nodes(grid.box, scale.finest, noise.whole, measured)
        far = far_level(grid, nodes, scale.finest, scale.finer, height)
        count = self._count_tiles(cloud, height - below, workforce)
        tolerance = scale.tolerance if height > _ROBUST_LEVELS else np.inf
        least = below + 1 if np.isinf(tolerance) else _ROBUST_LEVELS
        # No lower for a finer far field: the master fits all from there up.
        lowest = far_level(grid, FEWEST_NODES, scale.finest, below, height)
        coarse = max(least, min(lowest, height - 1)) if count else height
        blocks = cloud.arrangement
        plan = Plan(
            origin, scale.finest, height, coarse, noise.whole,
            grid.origin, grid.step, grid.bricks, blocks.origin, blocks.edge, far, nodes, tolerance,
            refinement, grid.strides,
        )  # fmt: skip
        if not count:
            return HierarchicalPartition(cloud, scale, plan, None)
        tiling = Tiling(cloud, plan, count, workers, self.tile_points is not None)
        return HierarchicalPartition(cloud, scale, plan, tiling)

    def fit(
        self, partition: HierarchicalPartition, workforce: Workforce, advance: Advance
    ) -> Coarse | None:
        """Fit the coarse quadrics; nothing where the cloud is one tile.

        Parameters
        ----------
        partition : HierarchicalPartition
            Its `patches` are counted here.
        workforce : Workforce
        advance : callable
            Told (tiles done, tiles in all).
        """
        tiling, plan = partition.tiling, partition.plan
        if tiling is None:
            return None
        checkpoint = None if workforce.in_process else self._find_shared(partition.cloud)
        run = secrets.token_hex(8)  # nothing that an earlier one has left is taken

        def own(index: int) -> tuple[IntArray, IntArray]:
            return tiling.own(index), tiling.counts(index)

        def batches() -> Iterator[tuple[Any, ...]]:
            for index, ticket in enumerate(tiling.tickets):
                keep = (
                    None
                    if checkpoint is None
                    else (checkpoint.place, checkpoint.name_sums(run, index))
                )
                yield plan, tiling.core(index), ticket, keep, own(index)

        lattices: list[CoarseLattice] = []
        samples: list[Samples | tuple[str, str]] = []
        for index, found in stream_batches(workforce, sum_tile, batches(), 2 * workforce.workers):
            lattice, sampled, patches = found
            if checkpoint is not None:
                name = checkpoint.name_sums(run, index)
                lattice = checkpoint.get(name, coarse_lattice(plan, own(index)))
            assert lattice is not None  # noqa: S101 - it comes back where it is not kept
            lattices.append(lattice)
            samples.append(sampled)
            partition.patches += patches
            advance(len(lattices), len(tiling))
        return fit_coarse(plan, lattices, samples, workforce, self.threads)

    def extract(
        self,
        partition: HierarchicalPartition,
        quadrics: Coarse | None,
        workforce: Workforce,
        advance: Advance,
    ) -> Surface:
        """Fit the fine quadrics and extract the surface, tile by tile on the workers.

        Parameters
        ----------
        partition : HierarchicalPartition
            Where it is one tile, its `patches` are counted here.
        quadrics : Coarse or None
            What `fit` has returned.
        workforce : Workforce
        advance : callable
            Told (tiles done, tiles in all); of one tile, slabs.

        Returns
        -------
        Surface
            It has faces.

        Raises
        ------
        InputError
            No node lies inside: the normals contradict one another.
        """
        origin = partition.cloud.origin
        if partition.tiling is None:
            refusal = UsageError(
                f"a grid of {self.grid} cells makes one tile of all {len(partition.cloud)} points: "
                f"they do not fit into {name_option('max_memory')}",
                "ask for a finer grid, or allow more",
            )
            points = partition.cloud.take_all(self.tile_points or np.inf, refusal)
            surface, partition.patches = mesh_one_tile(
                points, partition.plan, self.threads, advance, self.show_part
            )
        else:
            assert quadrics is not None  # noqa: S101 - tiles have coarse quadrics
            surface = mesh_all_tiles(
                partition.tiling,
                quadrics,
                workforce,
                advance,
                origin,
                len(partition.cloud),
                self.checkpoint,
                self.show_part,
            )
        if not surface.plan.face_count:
            raise InputError(
                "no part of the cloud encloses a volume",
                "check that the normals point out of the object, and try a finer grid",
            )
        cloud = partition.cloud
        shared = None if workforce.in_process else self._find_shared(cloud)
        surface, partition.closure = close_surface(
            surface, cloud, partition.plan, self.opening, workforce,
            shared, self.threads, advance,
        )  # fmt: skip
        return surface

    def _find_shared(self, cloud: ArrangedCloud) -> Checkpoint | None:
        """Return the folder that workers read the points from, if they do."""
        is_shared = self.checkpoint is not None and self.checkpoint.holds_files
        return self.checkpoint if is_shared and not cloud.is_here else None

    def _count_tiles(self, cloud: ArrangedCloud, height: int, workforce: Workforce) -> int:
        """Return into how many tiles a cloud is cut; 0 where it is made into a mesh right here."""
        needed = -(-len(cloud) // (self.tile_points or TILE_POINTS))
        is_one = self.checkpoint is None and (needed == 1 or self.tile_points is None)
        if height == 1 or (cloud.is_here and workforce.in_process and is_one):
            return 0  # of one level none is left that tiles could be made of
        if workforce.in_process:
            return needed
        workers = workforce.workers
        each = min(TILES_EACH, workforce.batches_per_worker, len(cloud) // (workers * LARGE_TILE))
        return workers * max(1, each, -(-needed // workers))  # all of them, equally often

    def facts(self, partition: HierarchicalPartition) -> dict[str, Any]:
        """Return the estimates, and how many cells of the finest level hold points.

        Parameters
        ----------
        partition : HierarchicalPartition
            After `extract`.

        Returns
        -------
        dict of str to object
            Lengths in length units of the input.
        """
        plan, strides = partition.plan, partition.plan.strides
        return {
            "patches": partition.patches,
            "spacing": partition.scale.spacing,
            "spacing_range": list(plan.refinement.scale.range),
            "noise": partition.scale.noise.usual,
            "noise_range": list(partition.scale.noise.range),
            "cell_size": partition.scale.cell_size,
            "refined_levels": plan.refinement.levels,
            "step": plan.step,
            "coarsest_step": plan.step * 2.0 ** (0 if strides is None else strides.exponents.max()),
            "lam": plan.weights[partition.scale.finer].lam,
            "levels": plan.height,
            "tiles": 1 if partition.tiling is None else len(partition.tiling),
            **({} if partition.closure is None else partition.closure.facts()),
        }


def plan_grid(low: FloatArray, high: FloatArray, cells: int, margin: int = MARGIN) -> Grid:
    """Lay the evaluation grid around a cloud.

    Parameters
    ----------
    low, high : ndarray of float64, shape (3,)
        Corners of the box around all points, in length units of the input.
    cells : int
        Along the longest side, with about four to spare at each end.
    margin : int
        So many are in fact to spare. Where strides differ, a cell may be as large as a brick.

    Returns
    -------
    Grid
        Centred on the cloud but for a part of a step: flat sides lie on no nodes. Each side is a
        whole number of bricks.

    Raises
    ------
    InputError
        All points are the same.
    """
    longest = float((high - low).max())
    if longest <= 0.0:
        raise InputError("all points lie at one place", "scan something with an extent")
    step = longest / (cells - 2 * MARGIN)
    sides = np.ceil((high - low) / step + 2 * margin - _EXACT)
    x, y, z = (int(bricks) for bricks in np.ceil(sides / BRICK))
    half = 0.5 * BRICK * step * np.array([x, y, z])
    return Grid(lay_lattice(0.5 * (low + high) - half, step), step, (x, y, z))
