from __future__ import annotations

import logging

import numpy as np
import pytest
from directions import random_directions

from hpcapp.applications.surface.cloud.arranged import MemoryCloud
from hpcapp.applications.surface.cloud.measure import measure_points
from hpcapp.applications.surface.hierarchical.settings import Hierarchical
from hpcapp.applications.surface.job.settings import Settings
from hpcapp.applications.surface.paper.settings import Paper
from hpcapp.applications.surface.resolution import memory
from hpcapp.applications.surface.resolution.asked import find_grid, guess_grid
from hpcapp.geometry.points import PointCloud
from hpccomponent.errors import UsageError


def sphere(points: int, noise: float = 0.0) -> MemoryCloud:
    """Points on a sphere of radius 1, pi * 4 / points of its area each."""
    rng = np.random.default_rng(points)
    normals = random_directions(points, rng)
    radii = 1.0 + noise * rng.normal(size=points)
    return measure_points(PointCloud(radii[:, None] * normals, normals))


def test_a_dense_clean_scan_gets_steps_as_far_apart_as_its_points() -> None:
    cloud = sphere(400_000)
    spacing = np.sqrt(4.0 * np.pi / 400_000)
    assert find_grid(Settings(), cloud) == pytest.approx(2.0 / spacing, rel=0.12)


def test_four_times_the_points_are_twice_the_cells() -> None:
    few, many = (find_grid(Settings(), sphere(points)) for points in (200_000, 800_000))
    assert many == pytest.approx(2 * few, rel=0.1)


def test_noise_makes_the_grid_coarser_and_so_do_fewer_points() -> None:
    clean, noisy = (find_grid(Settings(), sphere(400_000, noise)) for noise in (0.0, 0.003))
    assert 256 < noisy < clean
    assert 32 < find_grid(Settings(), sphere(400_000, 0.03)) < 256
    assert 32 < find_grid(Settings(), sphere(2_000)) < find_grid(Settings(), sphere(8_000)) < 256


def test_detail_and_smoothness_turn_the_grid_too() -> None:
    cloud = sphere(400_000)
    plain = find_grid(Settings(), cloud)
    finer = find_grid(Settings(method=Hierarchical(detail=1.5)), cloud)
    assert finer == pytest.approx(1.5 * plain, rel=0.05)


def test_the_reason_is_said(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, "hpcapp"):
        grid = find_grid(Settings(), sphere(400_000))
    (line,) = [record.getMessage() for record in caplog.records]
    assert line.startswith(f"grid {grid}: steps of 0.00")
    assert "apart" in line


def test_what_is_asked_for_is_taken() -> None:
    cloud = sphere(5_000)
    assert find_grid(Settings(grid=100), cloud) == 100
    assert find_grid(Settings(depth=7), cloud) == 128
    assert find_grid(Settings(voxel_size=0.02), cloud) == pytest.approx(108, abs=1)
    assert find_grid(Settings(method=Paper()), cloud) == 256


def test_memory_makes_a_chosen_grid_coarser_and_refuses_one_that_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    cloud = sphere(400_000)
    wanted = find_grid(Settings(), cloud)
    cells = memory.count_surface_cells(wanted, cloud.points)
    needed = Hierarchical().estimate_memory(wanted, len(cloud), cells)
    monkeypatch.setattr(memory, "available_memory", lambda: int(0.7 * needed))
    with caplog.at_level(logging.INFO, "hpcapp"):
        assert 256 <= find_grid(Settings(), cloud) < wanted
    assert f"all that memory holds; {wanted} would suit" in caplog.text
    with pytest.raises(UsageError, match=f"grid={wanted} needs about"):
        find_grid(Settings(grid=wanted), cloud)


@pytest.mark.parametrize(("points", "guess"), [(100, 256), (1_000_000, 1000), (10**9, 4096)])
def test_before_points_are_read_the_most_is_guessed(points: int, guess: int) -> None:
    assert guess_grid(Settings(), points) == guess
    assert guess_grid(Settings(grid=64), points) == 64
    assert guess_grid(Settings(depth=5), points) == 32
