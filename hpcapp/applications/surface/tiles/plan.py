"""What the tasks of a tile are told of the whole cloud.

They travel as records.
"""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

import numpy as np

from hpcapp.applications.surface.cloud.arrangement import Arrangement
from hpcapp.applications.surface.field.far_field import FarFieldPart
from hpcapp.applications.surface.field.pyramid import Parents
from hpcapp.applications.surface.field.refinement import Refinement
from hpcapp.applications.surface.field.weights import FIELD_LEVELS, Weights, weigh_levels
from hpcapp.applications.surface.tiles.halo import halo_steps
from hpcapp.applications.surface.types.result_patterns import CellKeys
from hpcapp.geometry.points import Float32Array, FloatArray, IntArray
from hpcapp.kernels import COLUMNS
from hpcapp.kernels.types.field import FieldLevel
from hpcapp.kernels.types.grid import BrickStrides, Grid
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.columns import Column
from hpccomponent.protocol.records import record


@record("surface.plan")
@dataclass(frozen=True, slots=True, eq=False)
class TilePlan:
    """What all tiles of a cloud have in common.

    Corner (0, 0, 0) of every lattice lies at `origin` (3,), and the finest cells are of
    `cell_size`. Of the `height` levels of the cloud, tiles are made of the cells of level `coarse`,
    which is `height` where there is but one tile; the far field, with `far_nodes` along a side, of
    those of level `far`: of tiles, no coarser than theirs. The `noise` is the standard deviation of
    the positions along the normals, in length units of the input; a point that is `tolerance`
    variances off counts half: it is not infinite only where `coarse` is 2 or more. `missing` (3,)
    is as of the cloud's `Reading`. The base of the `refinement` has the level of its number of
    levels; the tiles' one is coarser than that. For `strides` see `Grid`.
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
    far_nodes: int
    missing: FloatArray
    tolerance: float = np.inf
    refinement: Refinement = field(default_factory=Refinement.none)
    strides: BrickStrides | None = None

    @property
    def base_size(self) -> float:
        """Edge of the cells at the base of the lattice."""
        return self.cell_size * 2.0**self.refinement.levels

    @property
    def usual_step(self) -> float:
        """The step of most bricks with points."""
        return self.step * 2.0 ** (0 if self.strides is None else np.median(self.strides.exponents))

    @property
    def coarse_size(self) -> float:
        """Edge of the coarse cells."""
        return self.cell_size * 2.0**self.coarse

    @property
    def reach(self) -> float:
        """How far from a node the points may lie that its quadrics depend on.

        Vertices and parents lie up to half a coarse cell away, their points half a coarse cell
        further on, and cells whose corners exist because of points two base cells beyond. Where
        points are weighed, by quadrics of the second level, these add two of its cells.
        """
        steps = 2.0 if np.isinf(self.tolerance) else 6.0
        return self.coarse_size + steps * self.base_size

    @property
    def far_box(self) -> tuple[FloatArray, FloatArray]:
        """The box in which anything asks for the far field.

        The grid, its halo, and beyond it the corners of every level of the field, up to two of
        their cells from a point.
        """
        coarsest = max(self.coarse, self.refinement.levels + FIELD_LEVELS - 1)
        margin = halo_steps(self.grid) * self.step + 4.0 * self.cell_size * 2.0**coarsest
        low, high = self.grid.box
        return low - margin, high + margin

    @property
    def weights(self) -> list[Weights]:
        """The weights of every level's fits."""
        base = self.refinement.levels
        return weigh_levels(self.cell_size, self.height, self.noise, self.tolerance, base)

    @property
    def grid(self) -> Grid:
        """The evaluation grid."""
        return Grid(self.grid_origin, self.step, self.bricks, self.strides)

    @property
    def arrangement(self) -> Arrangement:
        """The blocks that points are packed by."""
        return Arrangement(self.block_origin, self.block_edge)


@record("surface.coarse_levels")
@dataclass(frozen=True, slots=True, eq=False)
class CoarseLevels:
    """What a tile must know of the levels that the master has fitted.

    `parents` are what the finest of them offers to the next finer level, `trust` (v,) is theirs
    (see `FieldLevel`), None where they are too coarse for the field. `coarser` is what else of them
    the field is made of, finest first.
    """

    parents: Parents
    trust: Float32Array | None
    coarser: tuple[FieldLevel, ...]
    far: FarFieldPart

    @property
    def levels(self) -> tuple[FieldLevel, ...]:
        """All that the field is made of, finest first."""
        if self.trust is None:
            return self.coarser
        return FieldLevel(self.parents.keys, self.parents.coefficients, self.trust), *self.coarser


@record("surface.gap")
@dataclass(frozen=True, slots=True, eq=False)
class Gap:
    """Where the surface left all tiles, and how far it is to be followed from there.

    `exits` (e,) are keys of the bricks to begin with. They lie in a `box` (2, 3), from the lowest
    brick of it to before the last. In the box or around it `held` (h,) are sorted keys of bricks
    that others have taken, and `missing` (c,) those of coarse cells that hold points, but not
    around the exits.
    """

    box: IntArray
    exits: IntArray
    held: IntArray
    missing: IntArray


@record("surface.coarse_lattice")
@dataclass(frozen=True, slots=True, eq=False)
class CoarseLattice:
    """What the points of a tile add to the level of whose c cells tiles are made."""

    cells: CellKeys
    moments: Annotated[FloatArray, Column("c", COLUMNS, low=(1.0, *[-np.inf] * (COLUMNS - 1)))]
    """Sums over the points in each; the first counts them."""
    squares: Annotated[FloatArray, Column("c")]
    vertices: Annotated[IntArray, Column("v", rises=True)]
    """That its points lay there (see `ancestors.corners_at`)."""


@record("surface.samples")
@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """What the far field is made of, in s cells."""

    cells: Annotated[IntArray, Column("s", rises=True)]
    sums: Annotated[FloatArray, Column("s", 7, low=(1.0, *[-np.inf] * 6))]
    """Of 1, the positions in their cell, and the normals of the points in each."""
