"""Raw scans, judged against the truth beside them."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.spatial import KDTree

from hpcapp.applications.compare.nearest import NearestFace
from hpcapp.geometry.points import FloatArray
from hpcapp.lab.simulate.raw.scan import RawScan, RawSettings, scan_scene
from hpcapp.lab.simulate.raw.scanners import SCANNERS
from hpcapp.lab.simulate.raw.scenes import SCENES
from hpccomponent.errors import UsageError

PAIRS = [(scene, one.name) for one in SCANNERS.values() for scene in one.scenes]
GROUND, VEGETATION = 2, 5


def scan(scene: str, scanner: str | None = None, **settings: Any) -> RawScan:
    usual: dict[str, Any] = {"points": 4000, "shape": "torus"}
    return scan_scene(scene, scanner, RawSettings(**usual | settings))


@cache
def clean(scene: str, scanner: str) -> RawScan:
    return scan(scene, scanner, noise=0.0)


def distances(raw: RawScan) -> FloatArray:
    """How far the points are off the truth; leaves, of which it has none, are left out."""
    kinds = raw.cloud.attributes.get("classification", np.zeros(len(raw.cloud)))
    return NearestFace(raw.truth).query(raw.cloud.positions[kinds != VEGETATION])[0]


def eyes(raw: RawScan) -> FloatArray:
    """Where the scanner was at the time of each point."""
    time, *axes = raw.trajectory.T
    now = raw.cloud.attributes["gps_time"]
    return np.stack([np.interp(now, time, axis) for axis in axes], axis=1)


@pytest.mark.parametrize(("scene", "scanner"), PAIRS)
def test_without_noise_the_points_lie_on_the_truth(scene: str, scanner: str) -> None:
    raw = clean(scene, scanner)
    assert len(raw.cloud) == 4000
    assert raw.cloud.normals is None
    off = distances(raw)
    # a model's mesh is flat between its vertices
    assert off.max() < (1e-3 if scene == "object" else 1e-8)
    assert np.median(off) < 3e-4


@pytest.mark.parametrize(("scene", "scanner"), PAIRS)
def test_time_ascends_and_every_point_is_seen_from_the_trajectory(scene: str, scanner: str) -> None:
    raw = clean(scene, scanner)
    times = raw.cloud.attributes["gps_time"]
    assert (np.diff(times) >= 0.0).all()
    assert (np.diff(raw.trajectory[:, 0]) > 0.0).all()
    assert raw.trajectory[0, 0] <= times[0]
    assert raw.trajectory[-1, 0] >= times[-1]
    # just before the point there is nothing: the line of sight from where the scanner was is free
    surface = SCENES[scene](np.random.default_rng(0), "torus").surface
    sight = eyes(raw) - raw.cloud.positions
    for share in (0.01, 0.1, 0.3, 0.6, 0.9):
        assert surface.value(raw.cloud.positions + share * sight).min() > -1e-9


def test_the_noise_is_that_of_the_scanner_or_as_asked_for() -> None:
    for settings, spread in (({}, 0.03), ({"noise": 0.1}, 0.1)):
        raw = scan("terrain", "airborne", **settings)
        # a strip looks down steeply: most of the noise is across the ground
        assert distances(raw).std() == pytest.approx(spread * 0.6, rel=0.15)
        assert distances(raw).max() < 5.0 * spread


def test_last_returns_under_crowns_lie_on_the_ground() -> None:
    raw = clean("forest", "airborne")
    columns = raw.cloud.attributes
    is_last = columns["return_number"] == columns["number_of_returns"]
    ground = columns["classification"] == GROUND  # which lies on the truth: see above
    assert (columns["number_of_returns"] > 1).mean() > 0.3
    assert is_last[ground].all()
    assert (ground & (columns["number_of_returns"] > 1)).sum() > 100
    # what came before, of the same pulse, lies above it, on the way to the scanner
    before = np.flatnonzero(~is_last)
    assert (columns["gps_time"][before] == columns["gps_time"][before + 1]).all()
    assert (columns["return_number"][before + 1] == columns["return_number"][before] + 1).all()
    height = raw.cloud.positions[:, 2]
    assert (height[before] > height[before + 1]).all()


def test_an_aircraft_is_above_and_looks_across_its_flight() -> None:
    raw = clean("town", "airborne")
    assert raw.trajectory[:, 3].min() > raw.truth.vertices[:, 2].max() + 100.0
    sight = raw.cloud.positions - eyes(raw)
    assert np.abs(sight[:, 0]).max() < 1e-3
    angle = np.degrees(np.arctan2(sight[:, 1], -sight[:, 2]))
    assert np.abs(angle - raw.cloud.attributes["scan_angle"]).max() < 1e-3
    assert set(raw.cloud.attributes["point_source_id"]) == {1, 2}
    assert {GROUND, 6} == set(raw.cloud.attributes["classification"])


def test_a_tripod_leaves_fewer_points_the_farther_away() -> None:
    raw = clean("terrain", "terrestrial")
    away = np.linalg.norm(raw.cloud.positions - raw.trajectory[0, 1:], axis=1)
    spacing = KDTree(raw.cloud.positions).query(raw.cloud.positions, k=5)[0][:, 4]
    rings = [np.median(spacing[(away > r) & (away <= 2 * r)]) for r in (2.5, 5.0, 10.0, 20.0)]
    assert all(far > 1.4 * near for near, far in pairwise(rings))


@pytest.mark.parametrize(
    ("scene", "scanner"),
    [("town", "airborne"), ("room", "terrestrial"), ("room", "handheld"), ("object", None)],
)
def test_as_many_points_fly_and_stray_as_asked_for(scene: str, scanner: str | None) -> None:
    raw = scan(scene, scanner, flying=0.03, strays=0.02, noise=0.0)
    assert len(raw.cloud) == 4000
    assert raw.is_flying.sum() == 120
    assert raw.is_stray.sum() == 80
    wrong = raw.is_flying | raw.is_stray
    assert not (raw.is_flying & raw.is_stray).any()
    off, diagonal = distances(raw), np.linalg.norm(np.ptp(raw.truth.vertices, axis=0))
    unit = diagonal if scene == "object" else 1.0
    assert off[~wrong].max() < 1e-3 * unit
    assert off[raw.is_flying].max() < 0.35 * unit
    assert np.median(off[raw.is_flying]) > 2e-3 * unit
    assert np.median(off[raw.is_stray]) > 0.02 * diagonal


def test_drift_moves_points_and_trajectory_together() -> None:
    still, moved = (scan("room", drift=drift, noise=0.0) for drift in (0.0, 0.05))
    move = moved.cloud.positions - still.cloud.positions
    path = moved.trajectory[:, 1:] - still.trajectory[:, 1:]
    assert 0.01 < np.sqrt((move**2).mean()) < 0.15
    stand = moved.cloud.attributes["point_source_id"]
    for number in (1, 2):
        # a stand is nearly rigid
        assert np.ptp(move[stand == number], axis=0).max() < 0.05
    now = moved.cloud.attributes["gps_time"]
    for axis in range(3):
        along = np.interp(now, moved.trajectory[:, 0], path[:, axis])
        assert np.abs(along - move[:, axis]).max() < 1e-3


def test_one_seed_gives_one_scan_and_another_another() -> None:
    wild: dict[str, Any] = {"flying": 0.01, "strays": 0.01, "drift": 0.01}
    first, again, other = (scan("forest", **wild, seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(first.cloud.positions, again.cloud.positions)
    assert np.array_equal(first.trajectory, again.trajectory)
    assert np.array_equal(first.truth.vertices, again.truth.vertices)
    for name, column in first.cloud.attributes.items():
        assert np.array_equal(column, again.cloud.attributes[name])
    assert not np.array_equal(first.cloud.positions, other.cloud.positions)


def test_points_do_not_depend_on_the_number_of_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    several = scan("town", points=40_000)
    monkeypatch.setattr("hpcapp.lab.simulate.rays.available_cores", lambda: 1)
    assert np.array_equal(several.cloud.positions, scan("town", points=40_000).cloud.positions)


@pytest.mark.parametrize(
    ("scene", "scanner", "settings", "words"),
    [
        ("room", "airborne", {}, "terrestrial or handheld"),
        ("terrain", "structured-light", {}, "airborne or terrestrial"),
        ("moon", None, {}, "terrain, yard"),
        ("room", "sonar", {}, "no scanner"),
        ("object", None, {"shape": "cube-ish"}, "no shape"),
        ("terrain", None, {"flying": 0.1}, "met an edge"),
        ("terrain", None, {"strays": 0.9}, "strays is 0.9"),
        ("terrain", None, {"noise": -1.0}, "noise is -1"),
        ("terrain", None, {"drift": float("nan")}, "drift is nan"),
    ],
)
def test_what_makes_no_sense_is_refused(
    scene: str, scanner: str | None, settings: dict[str, Any], words: str
) -> None:
    with pytest.raises(UsageError, match=words):
        scan(scene, scanner, **settings)
