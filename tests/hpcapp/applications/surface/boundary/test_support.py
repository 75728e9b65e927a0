"""How far the unsupported places of a surface are from the points, against the truth."""

from __future__ import annotations

import numpy as np
import pytest
from passes import measure_read
from scipy.spatial import cKDTree

from hpcapp.applications.surface.boundary.drive import OpeningSettings
from hpcapp.applications.surface.boundary.support import find_farthest
from hpcapp.applications.surface.hierarchical.method import HierarchicalMethod
from hpcapp.applications.surface.job.outcome import Reconstruction
from hpcapp.applications.surface.pipeline import make_surface
from hpcapp.backends.serial import SerialExecutor
from hpcapp.geometry.points import PointCloud
from hpcapp.progress import Progress, StageClock
from hpcapp.workforce import Workforce


def sphere(hole: float) -> PointCloud:
    """Return points on the unit sphere, in a spiral, without what is within `hole` of its pole."""
    count = 20_000
    turn = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    radius = np.sqrt(1.0 - z * z)
    points = np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)
    points = points[np.linalg.norm(points - [0.0, 0.0, 1.0], axis=1) >= hole]
    return PointCloud(points, points)


def run(cloud: PointCloud, tile_points: int | None = None) -> Reconstruction:
    with SerialExecutor() as executor:
        method = HierarchicalMethod(
            128, tile_points=tile_points, opening=OpeningSettings("auto")
        )  # fmt: skip
        clock = StageClock(Progress())
        workforce = Workforce(executor, in_process=True)
        return make_surface(measure_read(cloud), method, workforce, clock)


@pytest.mark.parametrize("count", [0, 1, 60])
def test_the_farthest_place_is_the_one_that_a_search_tree_finds(count: int) -> None:
    rng = np.random.default_rng(7)
    points = rng.normal(size=(30_000, 3)) * [4.0, 2.0, 0.1]
    cloud = measure_read(PointCloud(points, np.tile([0.0, 0.0, 1.0], (len(points), 1))))
    places = rng.normal(size=(count, 3)) * 4.0
    held, _ = cloud.take_blocks(cloud.keys)
    away = cKDTree(held).query(places)[0].max(initial=0.0) if count else 0.0
    assert find_farthest(places, cloud) == pytest.approx(away, rel=1e-12)


def test_a_hole_is_what_no_point_supports() -> None:
    support = run(sphere(0.4)).facts["support"]
    # The hole is a cap of 4 % of the sphere, in whose border the points reach some spacings.
    assert 0.01 < 1.0 - support["share"] < 0.04
    # Its middle is 0.4 from the border on the sphere; the mesh cuts it shorter.
    assert 0.2 < support["farthest"] < 0.41
    assert 0.0 < support["reach"] < support["farthest"]


def test_points_all_around_support_all_of_it() -> None:
    support = run(sphere(0.0)).facts["support"]
    assert support["share"] == 1.0
    assert support["farthest"] == 0.0


def test_tiles_find_the_same() -> None:
    whole, tiled = (run(sphere(0.4), points).facts["support"] for points in (None, 5_000))
    assert tiled == pytest.approx(whole, rel=1e-9)
