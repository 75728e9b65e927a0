from __future__ import annotations

from collections.abc import Collection

import numpy as np
import pytest
from directions import random_directions

from hpcapp.applications.surface.attributes.carry import AttributeField
from hpcapp.geometry.points import FloatArray, PointCloud

RNG = np.random.default_rng(7)


def coloured(positions: FloatArray) -> PointCloud:
    """A cloud whose columns are smooth functions of the place, and one label."""
    return PointCloud(
        positions,
        None,
        np.rint(127.5 * (1 + positions)).astype(np.uint8),
        {
            "wave": np.sin(3 * positions[:, 0]) * positions[:, 1],
            "intensity": np.rint(2000 + 1500 * positions[:, 2]).astype(np.uint16),
            "side": np.where(positions[:, 0] > 0, 7, -3).astype(np.int8),
        },
    )


def carry(places: FloatArray, points: PointCloud, labels: Collection[str] = ()) -> PointCloud:
    return AttributeField(points, labels).evaluate(places).points


def test_smooth_columns_are_met_and_keep_their_types() -> None:
    vertices = 1.002 * random_directions(3000, RNG)
    points = coloured(random_directions(20_000, RNG))
    carried = carry(vertices, points, {"side"})
    truth = coloured(vertices / 1.002)
    assert carried.colours is not None
    assert truth.colours is not None
    assert carried.colours.dtype == np.uint8
    assert np.abs(carried.colours - truth.colours.astype(int)).max() <= 6
    for name, tolerance in (("wave", 0.09), ("intensity", 60)):
        found = carried.attributes[name]
        assert found.dtype == truth.attributes[name].dtype
        error = found.astype(float) - truth.attributes[name]
        assert np.abs(error).max() < tolerance
        assert np.sqrt((error**2).mean()) < tolerance / 5


def test_labels_are_exact_but_at_their_borders() -> None:
    vertices, points = random_directions(3000, RNG), coloured(random_directions(20_000, RNG))
    side = carry(vertices, points, {"side"}).attributes["side"]
    assert set(side) == {7, -3}
    is_inner = np.abs(vertices[:, 0]) > 0.05
    assert (side == np.where(vertices[:, 0] > 0, 7, -3))[is_inner].all()


def test_a_constant_stays_what_it_is_to_the_last_bit() -> None:
    points = random_directions(500, RNG)
    columns = {"a": np.full(500, 0.1), "b": np.full(500, 255, np.uint8)}
    carried = carry(random_directions(200, RNG), PointCloud(points, None, None, columns))
    np.testing.assert_allclose(carried.attributes["a"], 0.1, rtol=1e-15)
    assert (carried.attributes["b"] == 255).all()


def test_other_points_that_are_farther_away_change_no_bit() -> None:
    points = coloured(random_directions(4000, RNG))
    vertices = random_directions(300, RNG)
    vertices = vertices[vertices[:, 2] > 0.5]
    near = points.take(points.positions[:, 2] > 0.2)
    of_all, of_near = (AttributeField(some, {"side"}).evaluate(vertices) for some in (points, near))
    for name, column in of_all.points.attributes.items():
        assert column.tobytes() == of_near.points.attributes[name].tobytes()
    assert of_all.points.colours is not None
    assert of_near.points.colours is not None
    assert of_all.points.colours.tobytes() == of_near.points.colours.tobytes()
    assert of_all.farthest.tobytes() == of_near.farthest.tobytes()


@pytest.mark.parametrize("step", [1, 7, 300])
def test_places_do_not_depend_on_one_another_nor_on_threads(step: int) -> None:
    points, vertices = coloured(random_directions(4000, RNG)), random_directions(300, RNG)
    whole = AttributeField(points, {"side"}).evaluate(vertices).points.attributes["wave"]
    field = AttributeField(points, {"side"}, threads=2)
    parts = [field.evaluate(vertices[i : i + step]) for i in range(0, 300, step)]
    found = np.concatenate([part.points.attributes["wave"] for part in parts])
    assert found.tobytes() == whole.tobytes()


def test_a_lattice_whose_points_tie_gives_the_same_whichever_tree_finds_them() -> None:
    steps = np.arange(40.0)
    lattice = np.stack(np.meshgrid(steps, steps, [0.0]), axis=-1).reshape(-1, 3)
    cloud = coloured(lattice)
    vertices = lattice[(lattice[:, 0] > 9) & (lattice[:, 0] < 14)] + [0.5, 0.5, 0.0]
    some = cloud.take(np.abs(lattice[:, 0] - 12) < 7)
    found = [carry(vertices, points, {"side"}).attributes for points in (cloud, some)]
    for name in found[0]:
        assert found[0][name].tobytes() == found[1][name].tobytes()


def test_numbers_that_are_none_do_not_count_where_others_do() -> None:
    positions = np.stack([np.arange(30.0), np.zeros(30), np.zeros(30)], axis=1)
    height = np.where(np.arange(30) < 15, np.nan, 4.0)
    height[20] = np.inf
    cloud = PointCloud(positions, None, None, {"height": height})
    found = carry(positions[[0, 15, 20, 29]], cloud).attributes["height"]
    assert np.isnan(found[0])
    np.testing.assert_array_equal(found[1:], 4.0)


def test_a_cloud_of_few_points_gives_what_it_has() -> None:
    one = PointCloud(np.zeros((1, 3)), None, None, {"a": np.array([3], np.int16)})
    field = AttributeField(one, ()).evaluate(np.array([[2.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))
    assert field.points.attributes["a"].tolist() == [3, 3]
    assert field.nearest.tolist() == [2.0, 0.0]
    assert np.isinf(field.farthest).all()


def test_points_at_one_place_and_no_vertices_are_no_trouble() -> None:
    cloud = PointCloud(np.ones((20, 3)), None, None, {"a": np.arange(20.0)})
    assert np.isfinite(carry(np.ones((2, 3)), cloud).attributes["a"]).all()
    assert not len(carry(np.empty((0, 3)), cloud))
