from __future__ import annotations

import numpy as np
import pytest

from hpccomponent.surface.fitting.far_field import solve_far_field
from hpccomponent.surface.kernels.portable.coarse_grid import sample_grid
from hpccomponent.surface.types.field import FarField
from hpccomponent.surface.types.points import FloatArray

RADIUS = 3.0
BOX = (np.full(3, -3.2), np.full(3, 3.2))


def sphere(count: int, seed: int = 0) -> FloatArray:
    directions = np.random.default_rng(seed).normal(size=(count, 3))
    values: FloatArray = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return values


def distances_at(far: FarField, points: FloatArray) -> FloatArray:
    return sample_grid(far.values.astype(np.float64), (points - far.origin) / far.step)


@pytest.fixture(scope="module")
def normals() -> FloatArray:
    return sphere(4000)


@pytest.fixture(scope="module")
def far(normals: FloatArray) -> FarField:
    return solve_far_field(RADIUS * normals, normals, BOX, 0.1)


def test_the_box_is_covered_and_values_are_shared_as_float32(far: FarField) -> None:
    assert far.values.dtype == np.float32
    assert (far.origin < BOX[0]).all()
    assert (far.origin + far.step * (len(far.values) - 1) > BOX[1]).all()


def test_the_sign_is_right_everywhere_but_beside_the_surface(far: FarField) -> None:
    points = np.random.default_rng(1).uniform(-3.2, 3.2, (20_000, 3))
    distances = np.linalg.norm(points, axis=1) - RADIUS
    clear = np.abs(distances) > 2 * far.step
    assert (np.sign(distances_at(far, points)) == np.sign(distances))[clear].all()


def test_beside_the_surface_it_is_a_distance_within_a_third_of_a_step(
    far: FarField, normals: FloatArray
) -> None:
    for height in (-0.5, 0.0, 0.5):
        points = (RADIUS + height * far.step) * normals
        assert np.abs(distances_at(far, points) / far.step - height).mean() < 0.33


def test_nothing_is_larger_than_a_step_and_a_half(far: FarField) -> None:
    assert np.abs(far.values).max() <= np.float32(1.5 * far.step)


def test_a_hole_is_closed_smoothly(normals: FloatArray) -> None:
    kept = normals[normals[:, 2] < 0.8]
    far = solve_far_field(RADIUS * kept, kept, BOX, 0.1)
    axis = np.outer(np.linspace(0.5, 3.2, 200), [0.0, 0.0, 1.0])
    signs = distances_at(far, axis) > 0
    assert not signs[0]
    assert signs[-1]
    assert np.diff(signs).sum() == 1, "the ray through the hole leaves the object once"


def test_sampling_reproduces_linear_functions() -> None:
    x, y, z = np.indices((128, 128, 128), dtype=np.float64)
    places = np.random.default_rng(2).uniform(1, 126, (50, 3))
    np.testing.assert_allclose(sample_grid(x - 2 * y + 3 * z, places), places @ [1, -2, 3])
