from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.boundary.clearance import SupportRule, measure_clearance
from hpcapp.applications.surface.types.points import FloatArray, PointCloud

SPACING = 0.1
RULE = SupportRule(0.3, 0.3, 3.0)


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


def test_sparse_points_reach_farther() -> None:
    fine = SupportRule(0.06, 0.24, 3.0)  # chosen for a spacing of 0.02, and these have 0.1
    middle = [(1.05, 1.05, 0.0)]
    assert clearances(middle, SupportRule(0.06, 0.06, 3.0))[0] > 1.0
    assert clearances(middle, fine)[0] < 1.0


def test_neither_order_nor_far_points_change_a_bit() -> None:
    random = np.random.default_rng(1)
    places = random.uniform(-0.5, 2.5, (500, 3)) * [1.0, 1.0, 0.1]
    cloud, rule = flat_square(), SupportRule(0.15, 0.6, 3.0)
    whole = measure_clearance(places, cloud, rule)
    shuffled = cloud.take(random.permutation(len(cloud)))
    assert np.array_equal(measure_clearance(places, shuffled, rule, threads=2), whole)
    low, high = np.array([0.8, 0.8]), np.array([1.2, 1.2])
    some = ((places[:, :2] >= low) & (places[:, :2] <= high)).all(axis=1)
    positions = cloud.positions[:, :2]
    near = ((positions >= low - rule.reach) & (positions <= high + rule.reach)).all(axis=1)
    found = measure_clearance(places[some], cloud.take(np.flatnonzero(near)), rule)
    assert np.array_equal(found, whole[some])
