"""The field at the nodes of bricks, and the surface in them."""

from __future__ import annotations

from typing import Any

import numpy as np

from hpccomponent.surface.kernels.case_table import case_triangles
from hpccomponent.surface.kernels.native.arrays import floats, integers, native, singles
from hpccomponent.surface.types.field import Field
from hpccomponent.surface.types.grid import BRICK, BrickKinds, Grid
from hpccomponent.surface.types.mesh import BrickMesh
from hpccomponent.surface.types.points import Float32Array, FloatArray, IntArray

__all__ = ["balance_vertices", "evaluate_bricks", "grow_surface", "seed_bricks"]


def seed_bricks(grid: Grid, positions: FloatArray) -> IntArray:
    """Return the bricks that hold a point."""
    edge = BRICK * grid.step
    result: IntArray = native.seed_bricks(
        floats(positions), floats(grid.origin), edge, integers(grid.bricks)
    )
    return result


def evaluate_bricks(field: Field, grid: Grid, places: IntArray, threads: int = 1) -> Float32Array:
    """Evaluate the implicit function at the nodes of bricks."""
    result: Float32Array = native.evaluate_bricks(
        _field_values(field), *_grid_values(grid), integers(places), threads
    )
    return result


def grow_surface(field: Field, grid: Grid, kinds: BrickKinds, threads: int = 1) -> BrickMesh:
    """Extract the surface that a tile reaches."""
    box = (integers(kinds.first), np.ascontiguousarray(kinds.kinds, np.uint8))
    values = *_grid_values(grid), *box, case_triangles(), threads
    return BrickMesh(*native.grow_surface(_field_values(field), *values))


def balance_vertices(vertices: FloatArray, faces: IntArray, step: float) -> FloatArray:
    """Move vertices so that the faces balance around the surface."""
    result: FloatArray = native.balance_vertices(floats(vertices), integers(faces), step)
    return result


def _field_values(field: Field) -> tuple[Any, ...]:
    """Return a field as the seven values that the extension takes."""
    far = field.far
    levels = tuple(
        (integers(level.keys), singles(level.coefficients), singles(level.trust))
        for level in field.levels
    )
    near = (floats(field.origin), field.cell_size, levels)
    found = field.features
    features = () if found is None else (found.keys, found.pieces, found.joints)
    return (*near, far.values, floats(far.origin), far.step, features)


def _grid_values(grid: Grid) -> tuple[Any, ...]:
    return floats(grid.origin), grid.step, integers(grid.bricks)
