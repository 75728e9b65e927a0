from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.boundary.clearance import (
    SupportRule,
    find_bare,
    measure_clearance,
)
from hpcapp.applications.surface.scale.local_scale import LocalScale, count_scale, make_scale
from hpcapp.applications.surface.types.points import FloatArray, PointCloud

SPACING = 0.1
RULE = SupportRule(0.0, 3.0, LocalScale.uniform(SPACING))


def flat_square(count: int = 21) -> PointCloud:
    """Points of a unit grid over [0, 2]^2 at height 0, seen from above."""
    x, y = np.meshgrid(np.arange(count) * SPACING, np.arange(count) * SPACING)
    places = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    return PointCloud(places, np.tile([0.0, 0.0, 1.0], (len(places), 1)))


def clearances(places: list[tuple[float, float, float]], rule: SupportRule = RULE) -> FloatArray:
    return measure_clearance(np.array(places), flat_square(), rule).astype(np.float64)


def test_support_ends_a_radius_beyond_the_points() -> None:
    inside, beside, beyond = clearances([(1.03, 0.98, 0.0), (1.0, -0.27, 0.0), (1.0, -0.32, 0.0)])
    assert inside < beside < 1.0 < beyond


def test_a_sheet_behind_the_points_is_not_theirs() -> None:
    near, behind = clearances([(1.0, 1.0, -0.1), (1.0, 1.0, -0.2)])
    assert near < 1.0 < behind


def test_a_lone_point_supports_nothing() -> None:
    lone = PointCloud(np.array([[9.0, 9.0, 9.0]]), np.array([[0.0, 0.0, 1.0]]))
    assert measure_clearance(lone.positions, lone, RULE)[0] > 1.0


def test_far_from_all_points_there_is_no_support() -> None:
    assert clearances([(50.0, 0.0, 0.0)])[0] > 1.0
    none = PointCloud(np.empty((0, 3)), np.empty((0, 3)))
    assert measure_clearance(np.zeros((2, 3)), none, RULE).tolist() == pytest.approx([1.4, 1.4])


def two_densities() -> tuple[PointCloud, SupportRule]:
    """Points 0.01 apart where x is below 0, and 0.1 apart above."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(-100, 0) * 0.01, np.arange(201) * 0.01))
    dense = np.stack([x, y, np.zeros(len(x))], axis=1)
    sparse = flat_square(21).positions
    positions = np.concatenate([dense, sparse])
    cloud = PointCloud(positions, np.tile([0.0, 0.0, 1.0], (len(positions), 1)))
    counted = count_scale(positions, np.full(3, -2.0), 0.25, 5)
    scale = make_scale(0.014, np.full(3, -2.0), 0.25, [counted])
    return cloud, SupportRule(0.0, 3.0, scale)


def test_points_support_as_far_as_their_own_spacing_asks() -> None:
    cloud, rule = two_densities()
    places = np.array([(-0.5, 0.503, 0.0), (1.05, 1.05, 0.0), (-1.05, 0.5, 0.0), (2.2, 0.95, 0.0)])
    dense, sparse, beyond_dense, beyond_sparse = measure_clearance(places, cloud, rule)
    assert max(dense, sparse, beyond_sparse) < 1.0
    assert beyond_dense > 1.0
    assert find_bare(places, cloud, rule).tolist() == [False, False, True, False]


def test_sparse_points_support_no_thicker_than_usual() -> None:
    cloud, rule = two_densities()
    behind = np.array([(1.05, 1.05, -0.015), (1.05, 1.05, -0.05)])
    near, far = measure_clearance(behind, cloud, rule)
    assert near < 1.0 < far


def test_neither_order_nor_far_points_change_a_bit() -> None:
    random = np.random.default_rng(1)
    places = random.uniform(-0.5, 2.5, (500, 3)) * [1.0, 1.0, 0.1]
    cloud, rule = two_densities()
    whole = measure_clearance(places, cloud, rule)
    shuffled = cloud.take(random.permutation(len(cloud)))
    assert np.array_equal(measure_clearance(places, shuffled, rule, threads=2), whole)
    low, high = np.array([0.8, 0.8]), np.array([1.2, 1.2])
    some = ((places[:, :2] >= low) & (places[:, :2] <= high)).all(axis=1)
    positions = cloud.positions[:, :2]
    near = ((positions >= low - rule.reach) & (positions <= high + rule.reach)).all(axis=1)
    found = measure_clearance(places[some], cloud.take(np.flatnonzero(near)), rule)
    assert np.array_equal(found, whole[some])
