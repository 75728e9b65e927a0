"""What was flown over is told by returns, angles, ground or a map, where it is covered evenly."""

from __future__ import annotations

import numpy as np
import pytest
from on_earth import put_on_earth

from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io.points.survey import is_flown_over, is_projected

MAP = np.array([512_000.0, 5_403_000.0, 400.0])


def make_ground(size: float = 100.0) -> FloatArray:
    ground = np.random.default_rng(0).uniform(0.0, size, (4_000, 3))
    ground[:, 2] = 0.1 * ground[:, 0]
    return ground


def make_house() -> FloatArray:
    """Ground around a tripod, and walls."""
    random = np.random.default_rng(1)
    angle, distance = random.uniform(0.0, 6.3, 3_000), random.exponential(8.0, 3_000)
    ground = np.stack([distance * np.cos(angle), distance * np.sin(angle), 0 * angle], axis=1)
    wall = random.uniform(0.0, 20.0, (2_000, 3)) * (1.0, 0.0, 0.5)
    return np.concatenate([ground, wall + np.array([0.0, 12.0, 0.0])])


@pytest.mark.parametrize(
    ("name", "low", "high", "is_told"),
    [
        ("return_number", 1, 3, True),
        ("return_number", 1, 1, False),
        ("classification", 2, 6, True),
        ("classification", 0, 1, False),
        ("scan_angle", -9, 9, True),
        ("scan_angle", 14, 17, True),
        ("scan_angle", 0, 1, False),
        ("intensity", 1, 9, False),
    ],
)
def test_columns_of_a_flight_are_believed_of_what_is_even(
    name: str, low: int, high: int, is_told: bool
) -> None:
    for positions, is_even in ((make_ground(), True), (make_house(), False)):
        column = np.linspace(low, high, len(positions)).astype(np.int8)
        cloud = PointCloud(positions, attributes={name: column})
        assert is_flown_over(cloud) == (is_told and is_even)
        assert not is_flown_over(cloud, "degree")


def test_what_is_wide_and_even_on_a_map_was_flown_over() -> None:
    ground = PointCloud(make_ground() + MAP)
    assert is_flown_over(ground)
    assert is_flown_over(PointCloud(make_ground(), origin=MAP))
    assert not is_flown_over(PointCloud(make_ground()))
    assert not is_flown_over(PointCloud(make_ground(20.0) + MAP))
    assert not is_flown_over(PointCloud(make_house() + MAP))
    assert not is_flown_over(PointCloud(make_ground(90.0) + MAP / 0.3048), "ft")
    assert not is_flown_over(PointCloud((make_ground() * (1, 1, 12)) + MAP))


@pytest.mark.parametrize("latitude", [48.0, -35.0])
def test_what_was_flown_over_is_even_across_up(latitude: float) -> None:
    assert is_flown_over(put_on_earth(PointCloud(make_ground()), latitude))
    assert not is_flown_over(put_on_earth(PointCloud(make_ground(20.0)), latitude))
    assert not is_flown_over(put_on_earth(PointCloud(make_house()), latitude))


def test_coordinates_of_a_map_are_known_by_their_size_or_their_name() -> None:
    ground = make_ground()
    assert is_projected(PointCloud(ground + MAP))
    assert is_projected(PointCloud(ground), crs="EPSG:32632")
    assert not is_projected(PointCloud(ground))
    assert not is_projected(PointCloud(ground + MAP), "degree")
    assert not is_projected(PointCloud(ground + np.array([4.2e6, 6.0e5, 4.7e6])))
    assert not is_projected(PointCloud(ground * (1, 1e4, 1) + MAP))
    assert not is_projected(PointCloud(np.empty((0, 3))))
