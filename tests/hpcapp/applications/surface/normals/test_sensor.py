"""Cameras that cannot have seen the points are refused; all that can have are not."""

from __future__ import annotations

import numpy as np
import pytest
from camera_files import look_at, ring
from directions import random_directions

from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.geometry.points import FloatArray
from hpccomponent.errors import InputError

ZERO, FAR = np.zeros(3), np.array([500_000.0, 5_200_000.0, 400.0])
RANDOM = np.random.default_rng(5)
BALL = random_directions(500, RANDOM)
TERRAIN = np.concatenate(
    [RANDOM.uniform(-50, 50, (500, 2)), RANDOM.uniform(0, 3, (500, 1))], axis=1
)
GRID = np.stack(np.meshgrid(*2 * [np.linspace(-40.0, 40.0, 5)], [60.0]), axis=-1).reshape(-1, 3)


def cameras(places: FloatArray, targets: FloatArray) -> Sensor:
    return Sensor("places", places, look_at(places, targets)[:, 2], is_told=True)


def pair(far: float) -> Sensor:
    """Two photographs, 1 apart, of a place so far below them."""
    places = np.array([[-0.5, 0.0, far], [0.5, 0.0, far]])
    return cameras(places, places * (1, 1, 0))


def look_down(share: float) -> Sensor:
    """A camera above so much of the ball, which looks down."""
    place = np.array([[0.0, 0.0, np.quantile(BALL[:, 2], share)]])
    return cameras(place, place - (0, 0, 1))


@pytest.mark.parametrize(
    ("sensor", "points"),
    [
        (cameras(ring(), ZERO), BALL),
        (cameras(ring(radius=0.3, height=0.1), 3 * ring(radius=0.3, height=0.1)), BALL),
        (cameras(ring(), ZERO), BALL / 30.0 + 0.2),  # a part of what they saw
        (cameras(GRID, GRID * (1, 1, 0)), TERRAIN),
        (cameras(GRID, GRID * (1, 1, 0)), TERRAIN / 20.0 + 45.0),
        (pair(12.0), BALL / 1000.0),
        (look_down(0.28), BALL),
        (Sensor("places", ring() + 1e7, np.zeros((8, 3)), is_told=True), BALL),
        (Sensor("places", ring() + 1e7), BALL),
        (Sensor("above", is_told=True), BALL),
    ],
    ids=[
        *("around", "inside", "a part", "survey", "corner of a survey", "stereo", "above most"),
        *("places without a direction", "a file's places", "a direction"),
    ],
)
def test_cameras_that_may_have_seen_the_points_are_taken(
    sensor: Sensor, points: FloatArray
) -> None:
    sensor.check_sight(points, ZERO)
    sensor.check_sight(points + FAR, FAR)


@pytest.mark.parametrize(
    ("sensor", "points", "seen"),
    [
        (cameras(ring(), ZERO), BALL + FAR, "times their extent"),
        (cameras(GRID, GRID * (1, 1, 0)), TERRAIN + FAR / 100.0, "times their extent"),
        (pair(28.0), BALL / 1000.0, "the nearest is 28 away, 28 times their extent"),
        (cameras(GRID, GRID * (1, 1, 0)), TERRAIN + 100.0, " 0 % of the points lie"),
        (cameras(ring(), 2 * ring()), BALL, " 0 % of the points lie before one"),
        (look_down(0.12), BALL, ": 12 % of the points lie before one"),
    ],
    ids=["map", "another field", "stereo", "other heights", "outwards", "above few"],
)
def test_cameras_in_other_coordinates_are_refused_in_a_line(
    sensor: Sensor, points: FloatArray, seen: str
) -> None:
    with pytest.raises(InputError, match=seen) as caught:
        sensor.check_sight(points, ZERO)
    assert "in the same coordinates" in str(caught.value)
    assert "\n" not in str(caught.value)
    with pytest.raises(InputError, match=seen):
        sensor.check_sight(points - FAR, -FAR)


def test_what_lies_before_a_camera_stays_there_where_heights_are_scaled() -> None:
    sensor = cameras(ring(height=9.0), ZERO)
    scaled = sensor.scale_heights(3.28)
    assert sensor.places is not None
    assert sensor.axes is not None
    assert scaled.places is not None
    assert scaled.axes is not None
    depths = np.einsum("nkj,nj->nk", BALL - sensor.places[:, None], sensor.axes)
    scaled_ball = BALL * (1, 1, 3.28)
    assert np.einsum("nkj,nj->nk", scaled_ball - scaled.places[:, None], scaled.axes) == (
        pytest.approx(depths)
    )
    assert Sensor("above").scale_heights(3.28).places is None
