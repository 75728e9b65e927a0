"""Clouds of known shape, sorted into cells, and the extension under test."""

from __future__ import annotations

from dataclasses import dataclass
from types import ModuleType

import numpy as np
import pytest
from directions import random_directions

from hpcapp.geometry.lattice import spread_keys
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.kernels import portable
from hpcapp.kernels.build import load_native
from hpcapp.kernels.types.field import FarField, Field, FieldLevel
from hpcapp.kernels.types.grid import Grid


@pytest.fixture(scope="session")
def native() -> ModuleType:
    extension = load_native("")
    if extension is None:
        pytest.skip("the native kernels are not installed")
    return extension


@dataclass(frozen=True)
class Cells:
    """A noisy ellipsoid with all that the kernels make of it, by the numpy versions."""

    positions: FloatArray
    normals: FloatArray
    origin: FloatArray
    cell_size: float
    cells: IntArray
    offsets: IntArray
    local: FloatArray
    sorted_normals: FloatArray
    moments: FloatArray
    touched: IntArray


def make_cells(seed: int, points: int, cell_size: float) -> Cells:
    random = np.random.default_rng(seed)
    normals = random_directions(points, random)
    positions = normals * (1.0, 0.8, 0.6) + 0.01 * random.normal(size=(points, 3))
    origin = positions.min(axis=0)
    cells, offsets, rows = portable.sort_points(positions, origin, cell_size)
    local, sorted_normals = portable.gather_points(positions, normals, rows, origin, cell_size)
    moments = portable.accumulate_moments(local, sorted_normals, offsets)
    return Cells(
        positions, normals, origin, cell_size, cells, offsets, local, sorted_normals, moments,
        spread_keys(cells, 0, 1),
    )  # fmt: skip


@pytest.fixture(scope="session")
def cloud() -> Cells:
    return make_cells(7, 3000, 0.11)


def ball_level(cell_size: float, radius: float) -> FieldLevel:
    """Quadrics that are a ball's distance, near its surface."""
    reach = int(np.ceil(1.3 / cell_size))
    axis = np.arange(-reach, reach + 1)
    places = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    centres = places * cell_size
    distance = np.linalg.norm(centres, axis=1)
    near = np.abs(distance - radius) < min(2.5 * cell_size, 0.7 * radius)
    centres, distance = centres[near], distance[near]
    normal = centres / distance[:, None]
    coefficients = np.zeros((len(centres), 10))
    coefficients[:, 0] = (distance - radius) / cell_size
    coefficients[:, 1:4] = normal
    coefficients[:, 4:7] = 0.5 * cell_size / distance[:, None] * (1.0 - normal**2)
    keys = ((places[near] + (1 << 20)) @ np.array([1 << 42, 1 << 21, 1])).astype(np.int64)
    trust = np.clip(1.5 - np.abs(distance - radius) / cell_size, 0.0, 0.9)
    return FieldLevel(keys, coefficients.astype(np.float32), trust.astype(np.float32))


def make_ball(cell_size: float, radius: float = 0.8, grid_step: float = 0.05) -> tuple[Field, Grid]:
    """A ball: exact distances in the far field, three levels that agree near the surface."""
    step, nodes = 0.12, 32
    origin = np.full(3, -0.5 * step * (nodes - 1))
    ticks = origin[0] + step * np.arange(nodes)
    x, y, z = np.meshgrid(ticks, ticks, ticks, indexing="ij")
    values = (np.sqrt(x * x + y * y + z * z) - radius).astype(np.float32)
    levels = tuple(ball_level(cell_size * 2.0**depth, radius) for depth in range(3))
    field = Field(np.zeros(3), cell_size, levels, FarField(values, origin, step))
    bricks = int(np.ceil(2.4 / (8 * grid_step)))
    return field, Grid(np.full(3, -4.0 * bricks * grid_step), grid_step, (bricks, bricks, bricks))


@pytest.fixture(scope="session")
def ball() -> tuple[Field, Grid]:
    return make_ball(0.1)


@pytest.fixture(params=[0.03, 0.1, 0.31], ids=["fine", "equal", "coarse"])
def any_ball(request: pytest.FixtureRequest) -> tuple[Field, Grid]:
    """Lattices finer and coarser than the grid's step of 0.05 (or of 0.1, on the fine one)."""
    return make_ball(request.param, grid_step=0.2 if request.param < 0.05 else 0.05)
