"""The default method: hierarchical Hermite quadrics, blended by a partition of unity.

::

    scale ─> tiles ─> coarse sums of each tile ─> coarse quadrics, far field ─> surface in each tile
                      (workers)                   (master)         (a worker)   (workers)   ─> weld
"""

from __future__ import annotations

import logging
import secrets
from collections.abc import Iterator
from dataclasses import field, replace
from functools import partial
from typing import Any

import numpy as np

from hpcapp.applications.surface.boundary.drive import Closure, OpeningSettings, close_surface
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.cloud.point_workers import PointWorkers
from hpcapp.applications.surface.field.far_field import FEWEST_NODES
from hpcapp.applications.surface.field.pyramid import count_levels
from hpcapp.applications.surface.hierarchical.all_tiles import mesh_all_tiles
from hpcapp.applications.surface.hierarchical.coarse import (
    Coarse,
    choose_nodes,
    far_level,
    fit_coarse,
)
from hpcapp.applications.surface.hierarchical.one_tile import mesh_one_tile
from hpcapp.applications.surface.hierarchical.tiles import OUTLASTING, Tiling, choose_level
from hpcapp.applications.surface.methods.method import (
    LARGE_TILE,
    TILE_POINTS,
    TILES_EACH,
    Advance,
    ShowPart,
    show_nothing,
)
from hpcapp.applications.surface.resolution.chain import resolve
from hpcapp.applications.surface.resolution.estimates import Scale, suited_steps
from hpcapp.applications.surface.stitching.handle_groups import Mended, mend_handles
from hpcapp.applications.surface.stitching.surface import Surface
from hpcapp.applications.surface.tiles.checkpoint import Checkpoint, digest
from hpcapp.applications.surface.tiles.patterns import coarse_lattice
from hpcapp.applications.surface.tiles.plan import CoarseLattice, Samples, TilePlan
from hpcapp.applications.surface.tiles.tasks import sum_tile
from hpcapp.geometry.points import IntArray
from hpcapp.workforce import Workforce, stream_batches
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError, UsageError

log = logging.getLogger("hpcapp")

_POINTS_AT_ONCE = 2_000_000
_GAP_TILES = 16  # whose points are in a box in which gaps are spanned
_ROBUST_LEVELS = 2  # whose fits ask the points themselves, where these are weighed


def _anchor(coarse: Coarse, checkpoint: Checkpoint) -> Coarse:
    """Return coarse levels as they are known of earlier jobs, which these are for as well."""
    if not checkpoint.recipe:
        return coarse
    # Of these cells: less memory may ask for a coarser grid.
    what = f"coarse-{digest(replace(coarse.plan, strides=None))}"
    known = checkpoint.find_frame(what)
    if known is None:
        checkpoint.store.put(checkpoint.name_frame(what), coarse.whole())
        return coarse
    return coarse.anchored(known)


@dataclass(slots=True, eq=False)
class HierarchicalPartition:
    """A cloud cut into tiles; without a tiling it is one tile, made into a mesh here.

    `patches` are the finest cells with points, once they are counted; so many tiles were `taken`
    from a job of other scans. The `closure` tells how the borders of the surface came about, once
    it is there; `mended` what became of small handles and hollows, where it is closed and has
    handles or pieces.
    """

    cloud: ArrangedCloud
    scale: Scale
    plan: TilePlan
    tiling: Tiling | None
    patches: int = 0
    taken: int = 0
    closure: Closure | None = None
    mended: Mended | None = None


@dataclass(frozen=True, slots=True, eq=False)
class HierarchicalMethod:
    """Reconstruct with hierarchical Hermite quadrics; see `settings.Hierarchical` and `Resources`.

    The `grid` has so many cells along its longest side, margins included. Without `tile_points` a
    cloud in memory is one tile where tasks run in this process; without a checkpoint, finished
    tiles come back to it. By default the surface is closed.
    """

    grid: int
    smoothness: float = 1.0
    detail: float = 1.0
    threads: int = 1
    tile_points: int | None = None
    checkpoint: Checkpoint | None = None
    show_part: ShowPart = show_nothing
    opening: OpeningSettings = field(default_factory=OpeningSettings)
    uniform: bool = False

    def partition(self, cloud: ArrangedCloud, workforce: Workforce) -> HierarchicalPartition:
        """Find spacing, noise and cell size, and cut the cloud into tiles.

        InputError where there are no normals, or all points are the same.
        """
        are_read = workforce.in_process or self._find_shared(cloud) is not None
        workers = PointWorkers(workforce, are_read, _POINTS_AT_ONCE)
        found = resolve(
            cloud, self.grid, self.smoothness, self.detail,
            uniform=self.uniform, workers=workers, threads=self.threads,
        )  # fmt: skip
        scale, refinement, grid = found.scale, found.refinement, found.grid
        low, high, below = cloud.low, cloud.high, scale.levels
        noise = self.smoothness * scale.noise.whole
        height = scale.finer + count_levels(float((high - low).max()), scale.cell_size)
        height = max(height, below + 1)
        nodes = choose_nodes(grid.box, scale.finest, noise, cloud.measured)
        far = far_level(grid, nodes, scale.finest, scale.finer, height)
        count = self._count_tiles(cloud, height - below, workforce)
        tolerance = scale.tolerance if height > _ROBUST_LEVELS else np.inf
        least = below + 1 if np.isinf(tolerance) else _ROBUST_LEVELS
        # No lower for a finer far field: the master fits all from there up.
        lowest = far_level(grid, FEWEST_NODES, scale.finest, below, height)
        coarse = max(least, min(lowest, height - 1)) if count else height
        blocks = cloud.arrangement
        plan = TilePlan(
            origin=refinement.origin,
            cell_size=scale.finest,
            height=height,
            coarse=coarse,
            noise=noise,
            grid_origin=grid.origin,
            step=grid.step,
            bricks=grid.bricks,
            block_origin=blocks.origin,
            block_edge=blocks.edge,
            far=far,
            far_nodes=nodes,
            missing=np.array(cloud.measured.reading.missing),
            tolerance=tolerance,
            refinement=refinement,
            strides=grid.strides,
        )
        if not count:
            return HierarchicalPartition(cloud, scale, plan, None)
        level = choose_level(plan, scale.spacing) if self._outlasts else None
        tiling = Tiling(cloud, plan, count, workers, self.tile_points is not None, level)
        return HierarchicalPartition(cloud, scale, plan, tiling)

    def fit(
        self, partition: HierarchicalPartition, workforce: Workforce, advance: Advance
    ) -> Coarse | None:
        """Fit the coarse quadrics; None where the cloud is one tile.

        The partition's `patches` are counted here.
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
                keep = checkpoint and (checkpoint.place, checkpoint.name_sums(run, index))
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
        coarse = fit_coarse(plan, lattices, samples, workforce, self.threads)
        return coarse if self.checkpoint is None else _anchor(coarse, self.checkpoint)

    def extract(
        self,
        partition: HierarchicalPartition,
        quadrics: Coarse | None,
        workforce: Workforce,
        advance: Advance,
    ) -> Surface:
        """Fit the fine quadrics and extract the surface, tile by tile on the workers.

        Of one tile, `advance` is told its steps, and the partition's `patches` are counted here.
        InputError where no node lies inside: the normals contradict one another.
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
                self._span_gaps() * partition.scale.spacing,
                self.checkpoint,
                self.show_part,
            )
            partition.taken = surface.taken
            if self._outlasts:
                log.info("took %d of %d tiles as they were", surface.taken, len(partition.tiling))
        if not surface.plan.face_count:
            raise InputError(
                "no part of the cloud encloses a volume",
                "check that the normals point out of the object, and try a finer grid",
            )
        return surface

    def close(
        self,
        partition: HierarchicalPartition,
        surface: Surface,
        workforce: Workforce,
        advance: Advance,
    ) -> Surface:
        """Cut the surface open where no point supports it, or cut its small handles.

        The partition's `closure` and `mended` are set here.
        """
        cloud = partition.cloud
        shared = None if workforce.in_process else self._find_shared(cloud)
        surface, partition.closure = close_surface(
            surface, cloud, partition.plan, self.opening, workforce,
            shared, self.threads, advance,
        )  # fmt: skip
        topology = surface.check()
        if not partition.closure.is_open and (topology.genus or topology.components > 1):
            steps = partial(suited_steps, partition.plan.refinement)
            surface, partition.mended = mend_handles(surface, steps)
            if partition.mended.cut or partition.mended.hollows:
                log.info("%s", partition.mended.say())
        return surface

    def _span_gaps(self) -> float:
        """Return how wide boxes are in which gaps are spanned, in spacings of the points.

        A surface crosses one with as many points as a tile has. Where gaps are for jobs of other
        scans, too, they are as small as leaves what lies around them a part of the work.
        """
        points = _GAP_TILES * OUTLASTING if self._outlasts else self.tile_points or TILE_POINTS
        return float(np.sqrt(points))

    @property
    def _outlasts(self) -> bool:
        """Whether tiles are for jobs of other scans, too."""
        return self.checkpoint is not None and bool(self.checkpoint.recipe)

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

        Lengths are in length units of the input.
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
            "coarsest_step": plan.step * 2.0 ** int(strides.exponents.max() if strides else 0),
            "lam": plan.weights[partition.scale.finer].lam,
            "levels": plan.height,
            "tiles": 1 if partition.tiling is None else len(partition.tiling),
            **({"tiles_taken": partition.taken} if self._outlasts else {}),
            **({} if partition.closure is None else partition.closure.facts()),
            **({} if partition.mended is None else partition.mended.facts()),
        }
