"""Strays near a surface go; what is sparse as all around it, or flat, stays."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.cleaning.drive import drop_strays
from hpcapp.applications.surface.cloud.arranged import arrange_cloud
from hpcapp.applications.surface.cloud.cloud_pass import MemoryPass
from hpcapp.applications.surface.cloud.measure import measure_scale
from hpcapp.geometry.points import BoolArray, FloatArray, PointCloud

Random = np.random.Generator


@pytest.fixture
def random() -> Random:
    return np.random.default_rng(3)


def find_dropped(positions: FloatArray) -> BoolArray:
    cloud = PointCloud(positions, attributes={"row": np.arange(len(positions))})
    cloud_pass = MemoryPass(arrange_cloud(cloud))
    kept, cleaned, _ = drop_strays(cloud_pass, measure_scale(cloud_pass))
    dropped = np.ones(len(positions), np.bool_)
    dropped[kept.cloud.points.attributes["row"]] = False
    assert dropped.sum() == cleaned.outliers + cleaned.strays
    return dropped


def plane(random: Random, points: int, noise: float = 0.1) -> FloatArray:
    """A square of points one spacing apart, in the mean."""
    side = np.sqrt(points)
    flat = random.uniform(0.0, side, (points, 2))
    return np.column_stack([flat, random.normal(0.0, noise, points)])


@pytest.mark.parametrize("height", [4.0, 6.0, 10.0])
def test_single_points_over_a_surface_go(random: Random, height: float) -> None:
    above = np.column_stack([random.uniform(5.0, 95.0, (40, 2)), np.full(40, height)])
    dropped = find_dropped(np.concatenate([plane(random, 10_000), above]))
    assert dropped[-40:].mean() > 0.9
    assert not dropped[:-40].any()


@pytest.mark.parametrize("height", [5.0, 8.0])
def test_clumps_of_eight_go(random: Random, height: float) -> None:
    middles = np.column_stack([random.uniform(5.0, 95.0, (10, 2)), np.full(10, height)])
    clumps = np.repeat(middles, 8, axis=0) + random.normal(0.0, 0.6, (80, 3))
    dropped = find_dropped(np.concatenate([plane(random, 10_000), clumps]))
    assert dropped[-80:].mean() > 0.75
    assert not dropped[:-80].any()


@pytest.mark.parametrize("noise", [0.0, 0.3, 1.0])
def test_a_surface_and_its_border_stay_however_noisy(random: Random, noise: float) -> None:
    assert find_dropped(plane(random, 10_000, noise)).mean() < 0.005


def test_a_sparse_part_beside_a_dense_one_stays(random: Random) -> None:
    points = plane(random, 40_000)
    is_sparse = points[:, 0] > 100.0
    points = points[~is_sparse | (random.random(len(points)) < 1 / 30)]
    assert find_dropped(points).mean() < 0.001


def test_a_wire_over_the_ground_stays(random: Random) -> None:
    along = np.arange(5.0, 95.0, 1.5)
    wire = np.column_stack([along, np.full_like(along, 50.0), np.full_like(along, 8.0)])
    dropped = find_dropped(np.concatenate([plane(random, 10_000), wire]))
    assert dropped[-len(wire) :].mean() < 0.1
    assert dropped[: -len(wire)].mean() < 0.001


def test_a_sparse_sheet_close_to_a_dense_one_stays(random: Random) -> None:
    sparse = plane(random, 10_000, 0.02)[::12] + np.array([0.0, 0.0, 12.0])
    assert find_dropped(np.concatenate([plane(random, 10_000), sparse])).mean() < 0.003
