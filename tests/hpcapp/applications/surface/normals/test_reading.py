"""The one reading of a scan with normals: of shapes whose answer is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from passes import alone, in_folder, measure_read

from hpcapp.applications.surface.cloud.arranged import arrange_cloud
from hpcapp.applications.surface.cloud.cloud_pass import MemoryPass
from hpcapp.applications.surface.normals.drive import orient_normals
from hpcapp.applications.surface.normals.reading import read_scan
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.applications.surface.types.reading import Reading
from hpcapp.geometry.points import FloatArray, PointCloud

STANDING = 0.4  # a table is drawn to, a terrain is not
TURNS = [np.eye(3), np.eye(3)[[1, 2, 0]], np.diag([1.0, -1.0, -1.0])]


def ball(count: int = 9_000) -> FloatArray:
    """Return points that lie evenly on the unit sphere, in a spiral."""
    turn = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)


def terrain(height: float) -> tuple[FloatArray, FloatArray]:
    x, y = np.random.default_rng(1).uniform(-3.0, 3.0, (2, 9_000))
    z = height * np.sin(x) * np.cos(y)
    slopes = [-height * np.cos(x) * np.cos(y), height * np.sin(x) * np.sin(y), np.ones(len(x))]
    normals = np.stack(slopes, axis=1)
    return np.stack([x, y, z], axis=1), normals / np.linalg.norm(normals, axis=1)[:, None]


def read(positions: FloatArray, normals: FloatArray) -> Reading:
    return measure_read(PointCloud(positions, normals)).measured.reading


@pytest.mark.parametrize(("scale", "shift"), [(1e-20, 50.0), (1e20, 50.0), (1.0, -9.0)])
def test_a_ball_is_seen_from_outside_and_turned_inside_out_from_inside(
    scale: float, shift: float
) -> None:
    for side, kind in ((1.0, "outside"), (-1.0, "inside")):
        reading = read((ball() + shift) * scale, side * ball())
        assert (reading.kind, reading.certainty > 0.9) == (kind, True)
        assert reading.share_missing < 0.05


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("lowest", [-0.6, -0.3, 0.0])
def test_an_object_draws_together_to_what_is_missing_whatever_is_up(
    turn: FloatArray, lowest: float
) -> None:
    dome = ball(12_000)
    dome = dome[dome[:, 2] > lowest] @ turn
    reading = read(dome, dome)
    assert reading.drawn > STANDING
    assert np.array(reading.missing) @ ([0.0, 0.0, -1.0] @ turn) > 0.95 * reading.share_missing


@pytest.mark.parametrize("height", [0.0, 0.3, 0.8])
def test_a_terrain_is_seen_from_above_and_does_not_draw_together(height: float) -> None:
    reading = read(*terrain(height))
    assert reading.kind == "above"
    assert abs(reading.drawn) < 0.5 * STANDING
    assert reading.missing[2] < -0.5


def test_a_flat_view_of_something_round_does_not_draw_together() -> None:
    cap = ball(60_000)
    cap = cap[cap[:, 2] > 0.96]
    assert read(cap, cap).drawn < STANDING


@pytest.mark.parametrize(("distance", "is_inside"), [(0.5, True), (5.0, False)])
@pytest.mark.parametrize("is_told", [True, False])
def test_known_places_are_among_the_points_or_around_them(
    distance: float, is_inside: bool, is_told: bool
) -> None:
    """A scanner in the middle of a room, by what its user or its file tells, leaves it open."""
    cloud_pass = MemoryPass(arrange_cloud(PointCloud(ball() + 50.0)))
    places = cloud_pass.cloud.origin + 50.0 + np.array([[0.0, 0.0, distance]])
    sensor = Sensor("places", places - cloud_pass.cloud.origin, is_told=is_told)
    cloud_pass, _, verdict = orient_normals(cloud_pass, 0.03, sensor, keeps=False)
    reading = read_scan(cloud_pass, LocalScale.uniform(0.03), sensor, False, verdict)
    assert reading.kind == "places"
    assert (reading.share_going_on > 0.5) == is_inside


def test_a_folder_gives_the_reading_of_memory(tmp_path: Path) -> None:
    dome = ball(20_000)
    dome = dome[dome[:, 2] > -0.3]
    points = PointCloud(dome, dome)
    given = LocalScale.uniform(0.02), Sensor(), False
    whole = read_scan(MemoryPass(arrange_cloud(points)), *given)
    there = in_folder(points, tmp_path, alone(1_500))
    assert len(there.cloud.parts) > 3
    assert read_scan(there, *given) == whole
