from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hpcapp.applications.surface.field.cell_points import CloudRows, SortedPoints, sort_cloud
from hpcapp.applications.surface.field.robust import find_tolerance, tell_kurtosis, weigh_points
from hpcapp.geometry.lattice import pack_places, spread_keys
from hpcapp.geometry.points import FloatArray, IntArray, PointCloud
from hpcapp.kernels.portable.quadrics.robust import rate_points

SIZE = 0.25


def plane(heights: FloatArray) -> PointCloud:
    """Points about z = 0.6, at some heights above it."""
    positions = np.random.default_rng(1).uniform(0.0, 1.0, size=(len(heights), 3))
    positions[:, 2] = 0.6 + heights
    return PointCloud(positions, np.tile([0.0, 0.0, 1.0], (len(heights), 1)))


def plane_level(edge: float) -> tuple[IntArray, Any, Any]:
    """Vertices whose quadrics are the distance from z = 0.6, with variances of 0.25."""
    axis = np.arange(6)
    places = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    coefficients = np.zeros((len(places), 10), np.float32)
    coefficients[:, 0] = places[:, 2] - 0.6 / edge
    coefficients[:, 3] = 1.0
    return pack_places(places), coefficients, np.full(len(places), 0.25, np.float32)


def rows_of(points: SortedPoints) -> IntArray:
    """Return which points of the cloud these are."""
    assert isinstance(points.held, CloudRows)
    return points.held.rows.astype(np.int64)


@pytest.mark.parametrize("depth", [0, 1])
def test_distances_from_a_plane(depth: int) -> None:
    heights = np.random.default_rng(2).uniform(-0.05, 0.05, 400)
    cells, points = sort_cloud(plane(heights), np.zeros(3), SIZE)
    local, _, offsets = points.place(slice(0, len(cells)))
    level = plane_level(SIZE * 2.0**depth)
    expected = (heights[rows_of(points)] / (SIZE * 2.0**depth)) ** 2 / 0.25
    found = rate_points(local, offsets, cells, depth, *level)
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_points_far_off_count_little() -> None:
    heights = np.random.default_rng(2).uniform(-0.05, 0.05, 400)
    cells, points = sort_cloud(plane(heights), np.zeros(3), SIZE)
    squares = (heights[rows_of(points)] / (2.0 * SIZE)) ** 2 / 0.25
    found = weigh_points(cells, points, plane_level(2.0 * SIZE), 3.0).weights
    assert found is not None
    np.testing.assert_allclose(found, 1.0 / (1.0 + squares / 3.0), atol=1e-6)
    moments = weigh_points(cells, points, plane_level(2.0 * SIZE), 3.0).sum(slice(0, len(cells)))
    assert moments[:, 0].sum() == pytest.approx(found.sum())
    assert moments[:, 37].sum() == pytest.approx(found.sum())  # all normals point along z


def test_points_whose_surroundings_are_not_known_count_in_full() -> None:
    cells, points = sort_cloud(plane(np.full(50, 0.1)), np.zeros(3), SIZE)
    corners = spread_keys(cells, 5, 6)
    coefficients = np.ones((len(corners), 10), np.float32)
    blend = corners, coefficients, np.ones(len(corners), np.float32)
    weighed = weigh_points(cells, points, blend, 3.0)
    assert weighed.weights is not None
    assert (weighed.weights == 1.0).all()


def test_kurtosis_of_noise_that_differs_from_place_to_place() -> None:
    random = np.random.default_rng(3)
    cloud = PointCloud(random.uniform(0.0, 1.0, size=(60_000, 3)), np.ones((60_000, 3)))
    cells, points = sort_cloud(cloud, np.zeros(3), 1.0 / 16.0)
    left = cloud.positions[rows_of(points), 0] > 0.5
    scale = np.where(left, 5.0, 1.0)
    gaussian = tell_kurtosis((scale * random.normal(size=60_000)) ** 2, cells, points.offsets)
    tailed = tell_kurtosis(
        (scale * random.standard_t(6.0, size=60_000)) ** 2, cells, points.offsets
    )
    assert gaussian == pytest.approx(3.0, abs=0.1)
    assert 4.5 < tailed < 7.0
    assert tell_kurtosis(np.ones(1), cells[:1], np.array([0, 1])) == 3.0


def test_only_heavy_tails_are_not_averaged() -> None:
    assert np.isinf(find_tolerance(3.0))
    assert np.isinf(find_tolerance(4.3))
    assert find_tolerance(5.3) == pytest.approx(6.0)
    assert 2.0 < find_tolerance(50.0) < find_tolerance(6.0)
