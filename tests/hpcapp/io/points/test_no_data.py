"""What a raster or a scanner writes where nothing was measured is told from what is meant."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import shared_data

from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import open_points, read_whole, write_points
from hpcapp.io.points.no_data import find_no_data
from hpcapp.parts.ground import take_ground

MAP = np.array([476_000.0, 5_200_000.0, 0.0])
RANDOM = np.random.default_rng(8)
SINGLE_MAX = float(np.finfo(np.float32).max)
Shape = Callable[[], FloatArray]


def make_terrain(low: float, high: float, side: float = 200.0, cells: int = 70) -> FloatArray:
    """Return a raster of heights from `low` to `high`."""
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [np.linspace(0.0, side, cells)]))
    hills = np.sin(x / side * 7) + np.cos(y / side * 5 + 1)
    hills = (hills - hills.min()) / np.ptp(hills)
    return np.column_stack([x, y, np.round(low + (high - low) * hills, 3)])


TERRAIN = make_terrain(300.0, 400.0)
IS_GONE = (np.abs(TERRAIN[:, 0] - 80) < 25) & (np.abs(TERRAIN[:, 1] - 120) < 40)


def spoil(positions: FloatArray, value: float, axis: int = 2) -> FloatArray:
    """Return the same with a value in the place of what was not measured."""
    spoilt = positions.copy()
    spoilt[IS_GONE[: len(spoilt)], axis] = value
    return spoilt


def find(positions: FloatArray, *, goes_on: bool = False) -> list[tuple[int, float]]:
    """Return axes and numbers of what is none."""
    places, _ = find_no_data(PointCloud(positions), None, None, goes_on=goes_on)
    return [(int(np.argmax(~np.isnan(place))), float(np.nanmax(place))) for place in places]


@pytest.mark.parametrize("origin", [MAP, 0 * MAP])
@pytest.mark.parametrize(
    "value", [-9999, -99999, -32768, -32767, -SINGLE_MAX, SINGLE_MAX, 1e30, -3.4e38, 9999, 1e6]
)
def test_a_number_far_from_all_others_is_no_data(value: float, origin: FloatArray) -> None:
    assert find(spoil(TERRAIN + origin, value)) == [(2, float(value))]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_any_coordinate_may_be_none(axis: int) -> None:
    assert find(spoil(TERRAIN, -9999, axis)) == [(axis, -9999.0)]


def test_several_numbers_are_each_none() -> None:
    spoilt = spoil(TERRAIN + MAP, -9999)
    spoilt[::37, 2], spoilt[::41, 2], spoilt[::43, 2] = -32768, 1e30, 0.0
    assert sorted(number for _, number in find(spoilt)) == [-32768.0, -9999.0, 0.0, 1e30]


@pytest.mark.parametrize(
    ("low", "high", "is_none"), [(222.0, 322.0, True), (178.0, 278.0, False), (3.0, 50.0, False)]
)
def test_a_height_of_zero_on_a_map_is_told_by_the_range(
    low: float, high: float, is_none: bool
) -> None:
    """At 2.22 and 1.78 of the range below the terrain, and on a coast."""
    found = find(spoil(make_terrain(low, high) + MAP, 0.0))
    assert found == ([(2, 0.0)] if is_none else [])


@pytest.mark.parametrize(("low", "is_none"), [(222.0, True), (178.0, False)])
def test_another_number_is_told_by_the_extent(low: float, is_none: bool) -> None:
    """At 1.11 and .89 of the longest side below the terrain."""
    spoilt = spoil(make_terrain(low, low + 30.0), 0.0)
    assert find(spoilt) == ([(2, 0.0)] if is_none else [])


@pytest.mark.parametrize("value", [-999, 9999])
def test_a_map_may_be_wider_than_no_data_is_deep(value: float) -> None:
    wide = make_terrain(300.0, 400.0, side=20_000.0) + MAP
    assert find(spoil(wide, value)) == [(2, float(value))]


def test_zeros_that_may_be_none_are_kept_and_said() -> None:
    wide = make_terrain(300.0, 400.0, side=5000.0)
    places, doubts = find_no_data(PointCloud(spoil(wide, 0.0)), None, None, goes_on=False)
    assert not len(places)
    assert len(doubts) == 1
    assert "z is 0" in doubts[0]


def _floor(things: FloatArray, width: float = 10.0) -> FloatArray:
    plan = RANDOM.uniform(-width / 2, width / 2, (4000, 2))
    return np.vstack([np.column_stack([plan, np.zeros(4000)]), things])


def _ball(middle: float) -> FloatArray:
    directions = RANDOM.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return np.add(directions, (0.0, 0.0, middle))


def _lattice() -> FloatArray:
    axes = np.meshgrid(np.arange(20.0), np.arange(20.0), [0.0, 5.0, 10.0, 60.0])
    return np.column_stack([axis.ravel() for axis in axes])


def _stairs() -> FloatArray:
    plan = RANDOM.uniform(0, 4, (5000, 2))
    return np.column_stack([plan, 0.17 * np.floor(plan[:, 0] / 0.25)])


def _box() -> FloatArray:
    sides = RANDOM.uniform(0, 1, (6000, 3))
    rows = np.arange(6000)
    sides[rows, rows % 3] = rows // 3 % 2
    return np.multiply(sides, (100.0, 80.0, 2.0))


def _cliffs() -> FloatArray:
    """Return an island of heights of 60 to 100 in a sea at 0, of which no cliff is seen."""
    land: FloatArray = make_terrain(60.0, 105.0) + MAP
    land[np.hypot(*(land[:, :2] - MAP[:2] - 100).T) > 70, 2] = 0.0
    return land


def _contours() -> FloatArray:
    turns = RANDOM.uniform(0, 2 * np.pi, (5000, 1))
    levels = 10.0 * RANDOM.integers(0, 12, (5000, 1))
    return np.hstack([(300 - levels) * np.cos(turns), (300 - levels) * np.sin(turns), levels])


HONEST: dict[str, Shape] = {
    "a ball on a floor": lambda: _floor(_ball(1.0)),
    "a ball over a floor": lambda: _floor(_ball(5.0)),
    "a ball over a floor, on a map": lambda: _floor(_ball(4.5)) + MAP,
    "a table": lambda: _floor(RANDOM.uniform((-1, -1, 0.74), (1, 1, 0.76), (2000, 3))),
    "a lattice with a gap": _lattice,
    "stairs": _stairs,
    "faces of a box": _box,
    "a lake": lambda: np.maximum(make_terrain(380.0, 425.0), (0, 0, 395.0)),
    "a sea and cliffs on a map": _cliffs,
    "contours": _contours,
    "nothing else": lambda: np.eye(3)[np.arange(60) % 3] * 1e90,
    "a plane": lambda: TERRAIN * (1, 1, 0),
}


@pytest.mark.parametrize("name", HONEST)
def test_what_is_meant_is_kept(name: str) -> None:
    assert not find(HONEST[name]())


@pytest.mark.parametrize("name", ["odd/a6_short_millimetres.ply"])
def test_a_wall_behind_an_object_is_kept(name: str) -> None:
    path = shared_data.shared(f"real/{name}")
    expected = json.loads((shared_data.FOLDER / "real/odd/expected.json").read_text())
    assert len(read_whole(open_points(path))) == expected[Path(name).name]["points"]


@pytest.mark.parametrize("suffix", [".xyz", ".las", ".ply", ".npz", ".e57"])
def test_all_formats_leave_it_out_and_count_it(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    write_points(path, PointCloud(spoil(TERRAIN + MAP, -9999)))
    source = open_points(path)
    found = read_whole(source)
    assert source.findings.dropped == {"no data": IS_GONE.sum()}
    assert [line[:12] for line in source.findings.warnings] == ["z is -9999 w"]
    np.testing.assert_allclose(
        found.positions + found.origin, (TERRAIN + MAP)[~IS_GONE], rtol=0, atol=1e-3
    )


def test_the_ground_is_that_of_the_terrain(tmp_path: Path) -> None:
    hills = make_terrain(300.0, 320.0) + MAP
    write_points(tmp_path / "a.xyz", PointCloud(spoil(hills, -9999)))
    ground = read_whole(take_ground(open_points(tmp_path / "a.xyz")))
    assert (ground.positions[:, 2] + ground.origin[2]).min() >= 300
    assert len(ground) > 0.9 * (~IS_GONE).sum()


@pytest.mark.parametrize("rows", [slice(-300, None), slice(None, 140_000)])
def test_no_data_at_the_end_or_at_the_start_of_a_text_is_left_out(
    tmp_path: Path, rows: slice
) -> None:
    """A text is looked at from its start, 131,072 rows at first."""
    terrain = make_terrain(300.0, 400.0, side=2000.0, cells=400) + MAP
    terrain[rows, 2] = -9999
    np.savetxt(tmp_path / "a.xyz", terrain, fmt="%.2f")
    source, gone = open_points(tmp_path / "a.xyz"), int((terrain[:, 2] == -9999).sum())
    assert sum(len(part) for part in source.chunks(50_000)) == len(terrain) - gone
    assert source.findings.dropped == {"no data": gone}


def test_a_sea_with_a_pier_is_kept_where_the_land_follows(tmp_path: Path) -> None:
    """It is all that the first 131,072 rows have."""
    coast = make_terrain(-100.0, 50.0, side=2000.0, cells=500) + MAP
    coast = coast[np.argsort(coast[:, 2])]
    coast[:, 2] = np.maximum(coast[:, 2], 0)
    coast[100:1100, 2] = 5.0 + 0.001 * np.arange(1000)
    assert not coast[1100:131_072, 2].any()
    np.savetxt(tmp_path / "a.xyz", coast, fmt="%.3f")
    source = open_points(tmp_path / "a.xyz")
    assert sum(len(part) for part in source.chunks(50_000)) == len(coast)
    assert not source.findings.warnings
