from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.boundary.clearance import SupportRule, find_bare, measure_clearance
from hpcapp.applications.surface.scale.local_scale import LocalScale, count_scale, make_scale
from hpcapp.geometry.points import FloatArray, PointCloud

SPACING = 0.1
RULE = SupportRule(0.0, 3.0, LocalScale.uniform(SPACING))


def flat_square(count: int = 21) -> PointCloud:
    """Points of a unit grid over [0, 2]^2 at height 0, seen from above."""
    x, y = np.meshgrid(np.arange(count) * SPACING, np.arange(count) * SPACING)
    places = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    return PointCloud(places, np.tile([0.0, 0.0, 1.0], (len(places), 1)))


def clearances(places: list[tuple[float, float, float]], rule: SupportRule = RULE) -> FloatArray:
    return measure_clearance(np.array(places), flat_square(), rule).astype(np.float64)


def test_support_ends_half_a_radius_beyond_the_points() -> None:
    inside, beside, beyond = clearances([(1.03, 0.98, 0.0), (1.0, -0.12, 0.0), (1.0, -0.15, 0.0)])
    assert inside < beside < 1.0 < beyond


@pytest.mark.parametrize(("missing", "is_filled"), [(4, True), (6, False)])
def test_a_gap_that_points_support_from_both_sides_stays_filled(
    missing: int, is_filled: bool
) -> None:
    whole = flat_square()
    rows = np.round(whole.positions[:, 1] / SPACING)
    split = whole.take(np.flatnonzero((rows < 7) | (rows >= 7 + missing)))
    y = SPACING * (6.5 + 0.5 * missing)  # in the middle of what is missing
    along, edge = (np.array([(x, y, 0.0)]) for x in (1.03, -0.15))
    assert (measure_clearance(along, split, RULE)[0] < 1.0) == is_filled
    assert measure_clearance(edge, split, RULE)[0] > 1.0  # its ends are border


def turned(turn: FloatArray) -> PointCloud:
    flat = flat_square()
    assert flat.normals is not None
    return PointCloud(flat.positions @ turn.T, flat.normals @ turn.T)


def test_a_slope_ends_as_flat_ground_does() -> None:
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.8, -0.6], [0.0, 0.6, 0.8]])
    places = np.array([(1.0, -0.12, 0.0), (1.0, -0.15, 0.0)])
    beside, beyond = measure_clearance(places @ turn.T, turned(turn), RULE)
    assert beside < 1.0 < beyond


def test_a_fold_is_no_border() -> None:
    flat, wall = flat_square(), turned(np.array([[0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [-1.0, 0, 0]]))
    assert flat.normals is not None
    assert wall.normals is not None
    below = wall.positions - [0.0, 0.0, SPACING]
    normals = np.concatenate([flat.normals, wall.normals])
    box = PointCloud(np.concatenate([flat.positions, below]), normals)
    edge = np.stack([np.zeros(19), np.linspace(0.1, 1.9, 19), np.zeros(19)], axis=1)
    assert measure_clearance(edge, box, RULE).max() < 1.0


def test_a_sheet_behind_the_points_is_not_theirs() -> None:
    near, behind = clearances([(1.0, 1.0, -0.1), (1.0, 1.0, -0.2)])
    assert near < 1.0 < behind


def test_a_lone_point_supports_nothing() -> None:
    lone = PointCloud(np.array([[9.0, 9.0, 9.0]]), np.array([[0.0, 0.0, 1.0]]))
    assert measure_clearance(lone.positions, lone, RULE)[0] > 1.0


def test_far_from_all_points_there_is_no_support() -> None:
    assert clearances([(50.0, 0.0, 0.0)])[0] > 1.0
    none = PointCloud(np.empty((0, 3)), np.empty((0, 3)))
    assert measure_clearance(np.zeros((2, 3)), none, RULE).tolist() == [1.5, 1.5]


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
    assert find_bare(places, [cloud], rule).tolist() == [False, False, True, False]


def test_points_in_pieces_support_what_all_at_once_do() -> None:
    cloud, rule = two_densities()
    places = np.random.default_rng(3).uniform(-1.2, 2.2, (500, 3)) * [1.0, 1.0, 0.01]
    bare = find_bare(places, [cloud], rule)
    assert 0 < bare.sum() < len(bare)
    # Neighbours are in different pieces.
    pieces = [cloud.take(np.arange(first, len(cloud), 7)) for first in range(7)]
    np.testing.assert_array_equal(find_bare(places, pieces, rule), bare)


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
