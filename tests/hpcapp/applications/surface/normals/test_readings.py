"""What a scan is of is told by what its viewers see from behind, and by what none of them sees."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.cloud.spacing import estimate_spacing
from hpcapp.applications.surface.normals import readings, visibility
from hpcapp.applications.surface.normals.estimation import estimate_normals
from hpcapp.applications.surface.normals.inside import AMPLE, find_inside
from hpcapp.applications.surface.normals.linked import LinkedPatches
from hpcapp.applications.surface.normals.orientation import SURE, Orientation, orient_patches
from hpcapp.applications.surface.normals.patches import Links, Patches, find_patches, turn_points
from hpcapp.applications.surface.normals.readings import HABIT, choose, lies_level, weigh_readings
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.geometry.points import Float32Array, FloatArray
from hpccomponent.errors import InputError

FAR = np.full(3, 1e9)


def _group(positions: FloatArray) -> tuple[Patches, Links, float, Float32Array]:
    every, low = np.ones(len(positions), np.bool_), positions.min(axis=0)
    spacing = estimate_spacing(positions)
    vectors = estimate_normals(positions, every, low, spacing)
    return *find_patches(positions, vectors, every, low, spacing), spacing, vectors


def _read(positions: FloatArray) -> list[str]:
    patches, links, spacing, _ = _group(positions)
    found = weigh_readings(patches, LinkedPatches(patches, links), spacing, FAR)
    return [followed.reading.kind for followed in found]


def _orient(
    positions: FloatArray, sensor: Sensor | None = None, zero: FloatArray = FAR
) -> tuple[FloatArray, Orientation]:
    patches, links, spacing, vectors = _group(positions)
    oriented = orient_patches(patches, links, spacing, zero, sensor or Sensor())
    low = positions.min(axis=0)
    normals = turn_points(positions, vectors, low, spacing, oriented.sides)[0]
    return normals.astype(np.float64), oriented


def _share_sure(oriented: Orientation) -> float:
    return float((np.abs(oriented.sides.values) >= SURE).mean())


def _tunnel() -> tuple[FloatArray, FloatArray]:
    """A bent tube with open ends, and where its axis is nearest to each point."""
    random = np.random.default_rng(0)
    bend, turn = random.uniform(0.0, np.pi, 14_000), random.uniform(0.0, 2.0 * np.pi, 14_000)
    outwards = np.stack([np.cos(bend), np.sin(bend), np.zeros(len(bend))], axis=1)
    wall = np.cos(turn)[:, None] * outwards
    wall[:, 2] = np.sin(turn)
    axis = 6.0 * outwards
    return axis + wall, axis


def _slope(degrees: float) -> FloatArray:
    random = np.random.default_rng(1)
    slope = random.uniform(-1.0, 1.0, (6_000, 3))
    slope[:, 2] = 0.05 * np.sin(5.0 * slope[:, 0]) * np.cos(4.0 * slope[:, 1])
    lean = np.radians(degrees)
    turned = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(lean), -np.sin(lean)],
                       [0.0, np.sin(lean), np.cos(lean)]])  # fmt: skip
    slope @= turned.T
    return slope


def _stairs() -> FloatArray:
    """Twelve steps, treads and risers."""
    random = np.random.default_rng(2)
    along, across = random.uniform(0.0, 12.0, 9_000), random.uniform(0.0, 6.0, 9_000)
    step, share = np.floor(along), along % 1.0
    is_tread = share < 0.6
    y = step + np.where(is_tread, share / 0.6, 1.0)
    z = 0.6 * (step + np.where(is_tread, 0.0, (share - 0.6) / 0.4))
    return np.stack([across, y, z], axis=1)


def _houses() -> FloatArray:
    """Ground with four flat roofs, and their walls."""
    random = np.random.default_rng(3)
    ground = random.uniform(-20.0, 20.0, (9_000, 3))
    near = np.abs(np.abs(ground[:, :2]) - 10.0).max(axis=1)
    ground[:, 2] = np.where(near < 3.0, 5.0, 0.3 * np.sin(0.3 * ground[:, 0]))
    walls = random.uniform(-3.0, 3.0, (3_000, 3))
    rows, sides = np.arange(len(walls)), random.integers(0, 2, len(walls))
    walls[rows, sides] = np.where(random.random(len(walls)) < 0.5, -3.0, 3.0)
    walls[:, 2] = random.uniform(0.0, 5.0, len(walls))
    walls[:, :2] += random.choice([-10.0, 10.0], (len(walls), 2))
    return np.concatenate([ground, walls])


def test_a_bent_tunnel_is_seen_from_inside_along_its_whole_length() -> None:
    wall, axis = _tunnel()
    patches, _, spacing, _ = _group(wall)
    places = find_inside(patches, spacing, AMPLE)
    middle = np.arctan2(places[:, 1], places[:, 0])
    assert np.ptp(middle) > 0.8 * np.pi
    assert np.abs(np.hypot(places[:, 0], places[:, 1]) - 6.0).max() < 0.7
    for sensor in (None, Sensor("inside", is_told=True)):
        normals, oriented = _orient(wall, sensor)
        assert (np.einsum("ij,ij->i", normals, axis - wall) > 0.0).mean() > 0.99
        assert oriented.how == "from inside"


def test_what_is_told_to_be_seen_from_outside_is() -> None:
    wall, axis = _tunnel()
    normals, oriented = _orient(wall, Sensor("outside", is_told=True))
    assert (np.einsum("ij,ij->i", normals, axis - wall) < 0.0).mean() > 0.99
    assert _share_sure(oriented) > 0.99


@pytest.mark.parametrize("degrees", [0.0, 35.0])
def test_a_sheet_that_lies_level_is_ground_and_surely_faces_up(degrees: float) -> None:
    normals, oriented = _orient(_slope(degrees))
    assert (normals[:, 2] > 0.0).mean() > 0.99
    assert _share_sure(oriented) == 1.0


@pytest.mark.parametrize(("height", "is_level"), [(0.6, True), (0.85, False)])
def test_what_is_half_as_thick_as_wide_lies_level(height: float, is_level: bool) -> None:
    """Two sheets of a width of 2 spread by .58, and so far apart by .87 of that at height 1."""
    sheets = [_slope(0.0) + np.array([0.0, 0.0, side * height / 2.0]) for side in (-1.0, 1.0)]
    patches = _group(np.concatenate(sheets))[0]
    assert lies_level(patches) == is_level


@pytest.mark.parametrize(("distance", "is_sure"), [(0.75, False), (0.4, True), (-2.0, True)])
def test_what_may_be_the_image_of_a_camera_at_zero_is_unsure(
    distance: float, is_sure: bool
) -> None:
    """It looks along z; nearer it would see more than any camera does, and behind it nothing."""
    _, oriented = _orient(_slope(0.0), zero=np.array([0.0, 0.0, -distance]))
    assert _share_sure(oriented) == float(is_sure)


@pytest.mark.parametrize("degrees", [50.0, 60.0])
def test_an_open_sheet_that_stands_faces_up_and_is_unsure(degrees: float) -> None:
    normals, oriented = _orient(_slope(degrees))
    assert (normals[:, 2] > 0.0).mean() > 0.99
    assert _share_sure(oriented) < 0.1
    assert oriented.doubt is not None
    assert oriented.doubt.rival is not None
    mirrored = oriented.doubt.reading.place - oriented.doubt.rival.place  # type: ignore[operator]
    assert mirrored[2] > 0.0


def test_stairs_face_up() -> None:
    normals, _ = _orient(_stairs())
    assert (normals[:, 2] > -0.5).mean() > 0.99
    assert (normals[:, 2] > 0.5).mean() > 0.5


def test_houses_on_the_ground_tell_above_from_below() -> None:
    normals, oriented = _orient(_houses())
    assert (normals[:9_000, 2] > 0.0).mean() > 0.98
    assert oriented.how == "from above"
    assert _share_sure(oriented) > 0.95


def test_nothing_is_inside_of_a_sheet() -> None:
    with pytest.raises(InputError, match="no place inside was found"):
        _orient(_slope(0.0), Sensor("inside", is_told=True))


def test_a_ball_is_no_room() -> None:
    ball = np.random.default_rng(4).normal(size=(9_000, 3))
    ball /= np.linalg.norm(ball, axis=1)[:, None]
    assert _read(ball)[0] == "outside"
    normals, oriented = _orient(ball)
    assert (np.einsum("ij,ij->i", normals, ball) > 0.0).all()
    assert _share_sure(oriented) == 1.0


def test_a_cube_is_no_room(monkeypatch: pytest.MonkeyPatch) -> None:
    """Planes across its edges are seen from behind by who sees one of the two faces."""
    places = np.stack(np.meshgrid(*[np.arange(31.0)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    cube = places[((places == 0.0) | (places == 30.0)).any(axis=1)]
    cube += 0.1 * np.random.default_rng(0).normal(size=cube.shape)  # or edges have two planes
    assert _read(cube)[0] == "outside"
    monkeypatch.setattr(readings, "RARE", 0.5 * readings.RARE)
    assert _read(cube)[0] == "outside"
    monkeypatch.setattr(visibility, "_BENT", 2.0 * visibility._BENT)
    assert _read(cube)[0] == "inside"


def test_habit_decides_between_sides_alone() -> None:
    assert choose([0.3, 0.02, 0.01], [None, 0.0, 0.02]) == 1
    assert choose([0.015, 0.02, 0.01], [None, 0.0, 0.02]) == 0
    assert choose([0.3, 0.025, 0.03], [None, 0.02, None]) == 1
    assert choose([0.038, 0.0], [0.0, HABIT]) == 0  # a bowl, seen from above
