from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.cloud.measured import measure_points
from hpcapp.applications.surface.cloud.spacing import estimate_spacing
from hpcapp.applications.surface.hierarchical.estimates import choose_scale
from hpcapp.applications.surface.types.points import PointCloud


def noisy_sphere(noise: float, count: int = 20_000) -> PointCloud:
    rng = np.random.default_rng(5)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return PointCloud((1 + noise * rng.normal(size=(count, 1))) * normals, normals)


def find_noise(cloud: PointCloud) -> float:
    return choose_scale(measure_points(cloud), 0.001, 1.0, 1.0).noise


@pytest.mark.parametrize("noise", [0.003, 0.01, 0.03])
def test_noise_is_found_within_a_tenth(noise: float) -> None:
    cloud = noisy_sphere(noise)
    found = find_noise(cloud)
    assert found == pytest.approx(noise, rel=0.1)


def test_a_clean_cloud_has_no_noise_to_speak_of() -> None:
    cloud = noisy_sphere(0.0)
    spacing = estimate_spacing(cloud.positions)
    assert find_noise(cloud) < 0.02 * spacing


def test_a_few_points_have_no_noise_that_could_be_found() -> None:
    cloud = noisy_sphere(0.1, count=10)
    assert find_noise(cloud) == 0.0


def test_cells_follow_the_spacing_of_clean_clouds_and_the_noise_of_others() -> None:
    clean = choose_scale(measure_points(noisy_sphere(0.0)), 0.001, 1.0, 1.0)
    assert clean.cell_size == pytest.approx(1.5 * clean.spacing)
    noisy = choose_scale(measure_points(noisy_sphere(0.03)), 0.001, 1.0, 1.0)
    assert noisy.cell_size == pytest.approx(2.5 * noisy.noise)


def test_hands_on_the_wheel() -> None:
    cloud = measure_points(noisy_sphere(0.03))
    scale = choose_scale(cloud, 0.001, 1.0, 1.0)
    smoother = choose_scale(cloud, 0.001, 2.0, 1.0)
    finer = choose_scale(cloud, 0.001, 1.0, 2.0)
    assert smoother.cell_size == pytest.approx(2 * scale.cell_size)
    assert finer.cell_size == pytest.approx(scale.cell_size / 2)


def test_no_cell_is_smaller_than_a_step_of_the_grid() -> None:
    assert choose_scale(measure_points(noisy_sphere(0.0)), 0.2, 1.0, 1.0).cell_size == 0.2
