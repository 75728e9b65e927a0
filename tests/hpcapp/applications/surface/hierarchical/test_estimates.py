from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.hierarchical.estimates import (
    choose_scale,
    draw_sample,
    first_share,
)
from hpccomponent.surface import kernels
from hpccomponent.surface.cloud.spacing import estimate_spacing
from hpccomponent.surface.types.points import FloatArray, PointCloud


def noisy_sphere(noise: float, count: int = 20_000) -> PointCloud:
    rng = np.random.default_rng(5)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return PointCloud((1 + noise * rng.normal(size=(count, 1))) * normals, normals)


def find_noise(cloud: PointCloud) -> float:
    return choose_scale(cloud, 0.001, 1.0, 1.0).noise


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
    clean = choose_scale(noisy_sphere(0.0), 0.001, 1.0, 1.0)
    assert clean.cell_size == pytest.approx(1.5 * clean.spacing)
    noisy = choose_scale(noisy_sphere(0.01), 0.001, 1.0, 1.0)
    assert noisy.cell_size == pytest.approx(6 * noisy.noise)


def test_hands_on_the_wheel() -> None:
    cloud = noisy_sphere(0.01)
    scale = choose_scale(cloud, 0.001, 1.0, 1.0)
    smoother = choose_scale(cloud, 0.001, 2.0, 1.0)
    finer = choose_scale(cloud, 0.001, 1.0, 2.0)
    assert smoother.cell_size == pytest.approx(2 * scale.cell_size)
    assert finer.cell_size == pytest.approx(scale.cell_size / 2)


def test_no_cell_is_smaller_than_a_step_of_the_grid() -> None:
    assert choose_scale(noisy_sphere(0.0), 0.2, 1.0, 1.0).cell_size == 0.2


@pytest.mark.parametrize("count", [20_000, 200_000])
def test_large_clouds_are_judged_by_a_sample(count: int) -> None:
    drawn = []

    def draw(one_in: int) -> tuple[FloatArray, FloatArray]:
        drawn.append(one_in)
        return np.zeros((count // one_in, 3)), np.zeros((count // one_in, 3))

    assert len(draw_sample(draw, count)[0]) <= 20_000
    assert drawn == [max(count // 15_000, 1)]


def test_a_sample_of_few_boxes_is_drawn_anew() -> None:
    """Lumps in eight boxes: a share of them, as of the boxes of a surface, may be none."""
    lumps = np.random.default_rng(3).normal(size=(200_000, 3)) * 1e-3
    lumps += np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)])[
        np.arange(len(lumps)) % 8
    ]

    def draw(one_in: int) -> tuple[FloatArray, FloatArray]:
        rows = kernels.sample_boxes(lumps, lumps.min(axis=0), 24 * 0.01, one_in)
        return lumps[rows], lumps[rows]

    assert len(draw(first_share(len(lumps)))[0]) <= 15_000 // 4
    assert len(draw_sample(draw, len(lumps))[0]) > 15_000 // 4
