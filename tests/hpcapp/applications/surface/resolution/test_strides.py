"""Strides against the spacing of the points that they follow."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.cloud.measure import find_scale
from hpcapp.applications.surface.field.far_field import FEWEST_NODES, far_step
from hpcapp.applications.surface.field.local_noise import LocalNoise
from hpcapp.applications.surface.field.refinement import Refinement
from hpcapp.applications.surface.resolution.strides import choose_strides
from hpcapp.geometry.lattice import NEIGHBOURS, step_keys, unpack_keys
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.kernels import seed_bricks
from hpcapp.kernels.types.grid import BRICK, BrickStrides, Grid


def sheet(low: float, high: float, spacing: float) -> FloatArray:
    x, y = np.meshgrid(np.arange(low, high, spacing), np.arange(0.0, 4.0, spacing))
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.5 * spacing)], axis=1)


def uneven() -> FloatArray:
    """Points 0.01 apart where x is below 1, 0.04 apart to 3, and 0.16 apart beyond."""
    return np.concatenate([sheet(0.0, 1.0, 0.01), sheet(1.0, 3.0, 0.04), sheet(3.0, 9.0, 0.16)])


def stride(
    positions: FloatArray, step: float, finest: float, levels: int
) -> tuple[Grid, IntArray, BrickStrides | None]:
    low = positions.min(axis=0) - 32 * step
    bricks = np.ceil((np.ptp(positions, axis=0) + 64 * step) / (BRICK * step)).astype(int)
    grid = Grid(low, step, (int(bricks[0]), int(bricks[1]), int(bricks[2])))
    refinement = Refinement(levels, 1.25, find_scale(positions), low, finest, LocalNoise.none())
    seeds = seed_bricks(grid, positions)
    return grid, seeds, choose_strides(grid, seeds, refinement)


def test_steps_are_as_large_as_the_spacing_at_most_and_not_much_smaller() -> None:
    grid, seeds, strides = stride(uneven(), 0.01, 0.0125, 3)
    assert strides is not None
    x = grid.origin[0] + BRICK * grid.step * unpack_keys(seeds)[:, 0]
    steps = grid.step * 2.0 ** strides.at(seeds)
    for low, high, spacing in ((0.1, 0.8, 0.01), (1.3, 2.6, 0.04), (4.0, 8.5, 0.16)):
        inside = steps[(x > low) & (x < high)]
        most = min(1.2 * spacing, 8 * grid.step)
        assert inside.max() <= most
        assert np.median(inside) > 0.49 * most


def test_beside_the_points_bricks_are_as_fine_as_with_points() -> None:
    grid, seeds, strides = stride(uneven(), 0.01, 0.0125, 3)
    assert strides is not None
    middles = grid.origin + BRICK * grid.step * (unpack_keys(seeds) + 0.5)
    most = np.maximum(grid.step, 1.2 * find_scale(uneven()).at(middles))
    for step in NEIGHBOURS:
        assert (grid.step * 2.0 ** strides.at(step_keys(seeds, step)) <= most).all()


@pytest.mark.parametrize("step", [0.005, 0.01, 0.02])
def test_without_points_cells_are_those_of_the_far_field(step: float) -> None:
    grid, _, strides = stride(uneven(), step, 1.25 * step, 3)
    assert strides is not None
    far, sparsest = far_step(*grid.box, FEWEST_NODES), strides.exponents.max()
    assert strides.rest >= sparsest
    assert strides.rest == sparsest or step * 2.0**strides.rest <= far


@pytest.mark.parametrize("step", [0.04, 0.01])
def test_an_even_cloud_has_the_step_that_is_asked_for(step: float) -> None:
    _, _, strides = stride(sheet(0.0, 6.0, 0.04), step, 0.06, 0)
    assert strides is None


def test_a_finer_grid_than_the_points_ask_for_is_finest_where_they_are_densest() -> None:
    grid, seeds, strides = stride(uneven(), 0.0025, 0.0125, 3)
    assert strides is not None
    assert strides.at(seeds).min() == 0
    dense = grid.origin[0] + BRICK * grid.step * unpack_keys(seeds)[:, 0] < 0.8
    assert strides.at(seeds)[dense].max() <= 1
