from __future__ import annotations

import numpy as np
import pytest
from directions import random_directions

from hpcapp.applications.surface.cloud.measure import measure_points
from hpcapp.applications.surface.cloud.spacing import estimate_spacing
from hpcapp.applications.surface.resolution.estimates import choose_scale, suggest_grid
from hpcapp.geometry.points import PointCloud


def noisy_sphere(noise: float, count: int = 20_000) -> PointCloud:
    rng = np.random.default_rng(5)
    normals = random_directions(count, rng)
    return PointCloud((1 + noise * rng.normal(size=(count, 1))) * normals, normals)


def find_noise(cloud: PointCloud) -> float:
    return choose_scale(measure_points(cloud).measured, 0.001, 1.0, 1.0).noise.whole


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
    clean = choose_scale(measure_points(noisy_sphere(0.0)).measured, 0.001, 1.0, 1.0)
    assert clean.cell_size == pytest.approx(1.5 * clean.spacing)
    noisy = choose_scale(measure_points(noisy_sphere(0.03)).measured, 0.001, 1.0, 1.0)
    assert noisy.cell_size == pytest.approx(2.5 * noisy.noise.whole)


def test_hands_on_the_wheel() -> None:
    cloud = measure_points(noisy_sphere(0.03)).measured
    scale = choose_scale(cloud, 0.001, 1.0, 1.0)
    smoother = choose_scale(cloud, 0.001, 2.0, 1.0)
    finer = choose_scale(cloud, 0.001, 1.0, 2.0)
    assert smoother.cell_size == pytest.approx(2 * scale.cell_size)
    assert finer.cell_size == pytest.approx(scale.cell_size / 2)


def test_no_cell_is_smaller_than_a_step_of_the_grid() -> None:
    assert choose_scale(measure_points(noisy_sphere(0.0)).measured, 0.2, 1.0, 1.0).cell_size == 0.2


def uneven_sphere(noise: float) -> PointCloud:
    """Three quarters of the points on a fiftieth of it; the noise of all is the same."""
    cloud = noisy_sphere(noise, 200_000)
    assert cloud.normals is not None
    is_close = cloud.normals[:, 2] > 0.96
    rows = np.concatenate([np.flatnonzero(is_close)[:3_900], np.flatnonzero(~is_close)[:6_000]])
    return cloud.take(rows)


def test_dense_parts_do_not_hide_the_noise() -> None:
    assert find_noise(uneven_sphere(0.01)) == pytest.approx(0.01, rel=0.3)


def test_cells_are_halved_where_points_are_dense_and_doubled_where_they_are_sparse() -> None:
    even = choose_scale(measure_points(noisy_sphere(0.0)).measured, 0.0, 1.0, 1.0)
    assert (even.finer, even.coarser) == (0, 0)
    uneven = choose_scale(measure_points(uneven_sphere(0.0)).measured, 0.0, 1.0, 1.0)
    assert uneven.finer + uneven.coarser >= 2
    assert uneven.finest == uneven.cell_size * 2.0**-uneven.finer
    noisy = choose_scale(measure_points(uneven_sphere(0.02)).measured, 0.0, 1.0, 1.0)
    assert noisy.finest >= 2.5 * noisy.noise.whole


def test_no_refined_cell_is_smaller_than_a_step_either() -> None:
    scale = choose_scale(measure_points(uneven_sphere(0.0)).measured, 0.03, 1.0, 1.0)
    assert scale.finest >= 0.03


def test_a_grid_follows_the_densest_points() -> None:
    longest = 2.0
    even, uneven = (
        suggest_grid(measure_points(cloud).measured, longest, 1.0, 1.0).grid
        for cloud in (noisy_sphere(0.0, 10_000), uneven_sphere(0.0))
    )
    assert uneven > 1.8 * even


def test_a_small_scan_gets_a_small_mesh() -> None:
    found = suggest_grid(measure_points(noisy_sphere(0.0, 1_000)).measured, 2.0, 1.0, 1.0)
    spacing = np.sqrt(4.0 * np.pi / 1_000)
    assert 0.5 * spacing < 2.0 / (found.grid - 8) < 1.1 * spacing
