"""Points without normals get the same ones in memory and in a folder, and on the right side."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from directions import random_directions
from passes import alone, in_folder, in_memory

from hpcapp.applications.surface.cleaning.drive import mend_normals
from hpcapp.applications.surface.cloud import cloud_pass
from hpcapp.applications.surface.cloud.arranged import arrange_cloud
from hpcapp.applications.surface.cloud.cloud_pass import MemoryPass
from hpcapp.applications.surface.cloud.measure import measure_spacing
from hpcapp.applications.surface.normals.drive import orient_normals
from hpcapp.applications.surface.normals.orientation import SURE
from hpcapp.applications.surface.normals.oriented import Oriented
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.applications.surface.normals.sides import judge_normals, orient_cloud
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.lab.simulate.scanner import simulate_scan
from hpcapp.lab.simulate.settings import ScanSettings
from hpcapp.lab.simulate.shapes import SHAPES
from hpcapp.progress import Progress, StageClock

UNKNOWN = Sensor()


def _scan(name: str, **settings: float) -> PointCloud:
    points = {"points": 12_000, **settings}
    return simulate_scan(SHAPES[name], ScanSettings(normals="exact", **points))  # type: ignore[arg-type]


def orient(
    points: PointCloud,
    sensor: Sensor = UNKNOWN,
    attribute: str | None = None,
    *,
    is_oriented: bool = False,
) -> tuple[PointCloud, Oriented]:
    """Orient points in memory, as if their normals had no side where there are some."""
    clock, cloud_pass = StageClock(Progress()), in_memory(points)
    turned, oriented, _ = orient_cloud(
        cloud_pass,
        LocalScale.uniform(measure_spacing(cloud_pass)),
        "auto",
        sensor,
        clock,
        has_normals=points.normals is not None,
        is_oriented=is_oriented,
        attribute=attribute,
    )
    return turned.cloud.points, oriented


def contradicts(points: PointCloud) -> bool:
    cloud_pass = in_memory(points)
    return judge_normals(cloud_pass, measure_spacing(cloud_pass)) == "contradict"


def _share_right(found: PointCloud, truth: PointCloud) -> float:
    assert found.normals is not None
    assert truth.normals is not None
    return float(np.mean(np.einsum("ij,ij->i", found.normals, truth.normals) > 0.0))


@pytest.mark.parametrize(
    ("name", "settings", "least"),
    [
        ("sphere", {}, 1.0),
        ("torus", {"noise": 0.002}, 0.999),
        ("box", {}, 0.98),
        ("knot", {"noise": 0.001, "pose_error": 0.001}, 0.99),
    ],
)
def test_normals_point_out_of_what_was_scanned(
    name: str, settings: dict[str, float], least: float
) -> None:
    scan = _scan(name, **settings)
    found, oriented = orient(PointCloud(scan.positions))
    assert _share_right(found, scan) >= least
    assert oriented.source == "estimated"
    assert oriented.sure > 0.99
    assert oriented.warnings == []
    assert found.attributes == {}


def test_how_sure_the_side_is_is_kept_where_it_is_asked_for() -> None:
    positions = _scan("torus").positions
    scan = PointCloud(positions, attributes={"height": positions[:, 2]})
    found, oriented = orient(scan, attribute="confidence")
    assert list(found.attributes) == ["confidence", "height"]
    confidence = found.attributes["confidence"]
    assert confidence.shape == (len(scan),)
    assert 0.0 <= confidence.min() <= confidence.max() <= 1.0
    assert np.mean(confidence >= SURE) == pytest.approx(oriented.sure)


def test_two_objects_have_their_own_sides() -> None:
    scan = _scan("torus", noise=0.001)
    assert scan.normals is not None
    twice = np.concatenate([scan.positions, scan.positions + np.array([3.0, 0.4, 0.2])])
    truth = PointCloud(twice, np.concatenate([scan.normals, scan.normals]))
    found, _ = orient(PointCloud(twice))
    assert _share_right(found, truth) >= 0.999


def test_a_thin_plate_has_two_sides() -> None:
    random = np.random.default_rng(0)
    top = random.uniform(-1.0, 1.0, (12_000, 3)) * (1.0, 1.0, 0.0) + (0.0, 0.0, 0.03)
    sides = np.where(random.random(len(top)) < 0.5, 1.0, -1.0)
    normals = np.zeros_like(top)
    normals[:, 2] = sides
    positions = top * np.stack([np.ones_like(sides), np.ones_like(sides), sides], axis=1)
    positions += random.normal(0.0, 0.002, positions.shape)
    found, _ = orient(PointCloud(positions))
    assert _share_right(found, PointCloud(positions, normals)) >= 0.99


def test_who_stood_inside_saw_the_inside() -> None:
    normals = random_directions(8_000, 1)
    found, _ = orient(PointCloud(2.0 * normals), Sensor("places", np.array([[0.3, 0.0, 0.0]])))
    assert _share_right(found, PointCloud(2.0 * normals, -normals)) == 1.0


def _sheets(random: np.random.Generator) -> FloatArray:
    """Noise around two sheets, points on a lattice, and some at the same place."""
    plane = random.uniform(-1.0, 1.0, (9_000, 3)) * (1.0, 1.0, 0.01)
    steps = np.arange(40) * 0.02
    lattice = np.stack(np.meshgrid(steps, steps, [0.5]), axis=-1).reshape(-1, 3)
    return np.concatenate([plane, lattice, lattice[:100], random.uniform(-1, 1, (60, 3))])


@pytest.mark.slow
@pytest.mark.parametrize("workers_see", [True, False])
@pytest.mark.parametrize("what", ["knot", "sheets", "given"])
def test_regions_give_the_normals_of_the_whole(
    tmp_path: Path, what: str, workers_see: bool
) -> None:
    scan = _sheets(np.random.default_rng(2)) if what == "sheets" else _scan("knot").positions
    given = np.random.default_rng(3).normal(size=scan.shape)
    given /= np.linalg.norm(given, axis=1, keepdims=True)
    points = PointCloud(scan, given if what == "given" else None)
    memory = MemoryPass(arrange_cloud(points))
    spacing = measure_spacing(memory)
    keeps = what == "given"
    whole, wanted, _ = orient_normals(memory, spacing, UNKNOWN, keeps=keeps, attribute="sure")
    there = in_folder(points, tmp_path, alone(1_500, sees=workers_see))
    found, same, _ = orient_normals(there, spacing, UNKNOWN, keeps=keeps, attribute="sure")
    assert len(found.cloud.parts) > 3
    found, _ = mend_normals(found, spacing)  # which leaves them beside other points
    whole, _ = mend_normals(whole, spacing)
    found.cloud.check()
    for keys in (found.cloud.keys, found.cloud.keys[1::2]):
        sure = whole.cloud.take_columns(keys).attributes["sure"]
        assert found.cloud.take_columns(keys).attributes["sure"].tobytes() == sure.tobytes()
    assert np.ptp(sure) > 0.0
    assert found.cloud.take_blocks(found.cloud.keys)[0].tobytes() == (
        memory.cloud.points.positions.tobytes()
    )
    assert whole.cloud.points.normals is not None
    normals = whole.cloud.points.normals
    assert found.cloud.take_blocks(found.cloud.keys)[1].tobytes() == normals.tobytes()
    assert (same.sure, same.flipped, same.how) == (wanted.sure, wanted.flipped, wanted.how)
    assert wanted.flipped > 0


def test_large_clouds_in_memory_are_turned_in_boxes(monkeypatch: pytest.MonkeyPatch) -> None:
    points = PointCloud(_scan("knot", noise=0.001).positions)
    expected, _ = orient(points, attribute="sure")
    monkeypatch.setattr(cloud_pass, "POINTS_AT_ONCE", 1_000)
    found, _ = orient(points, attribute="sure")
    assert found.normals is not None
    assert expected.normals is not None
    assert found.normals.tobytes() == expected.normals.tobytes()
    assert found.attributes["sure"].tobytes() == expected.attributes["sure"].tobytes()


def test_normals_depend_on_no_number_of_threads() -> None:
    cloud = arrange_cloud(PointCloud(_scan("knot", noise=0.001).positions))
    spacing = measure_spacing(MemoryPass(cloud))
    found = []
    for threads in (1, 3):
        cloud_pass, oriented, _ = orient_normals(
            MemoryPass(cloud, threads), spacing, UNKNOWN, keeps=False
        )
        cloud_pass, flipped = mend_normals(cloud_pass, spacing)
        assert cloud_pass.threads == threads
        normals = cloud_pass.cloud.points.normals
        assert normals is not None
        found.append((normals.tobytes(), oriented, flipped))
    assert found[0] == found[1]


def test_normals_of_a_file_are_warned_of_where_they_are_taken_as_they_are() -> None:
    scan = _scan("torus")
    assert scan.normals is not None
    signs = np.where(np.random.default_rng(4).random(len(scan)) < 0.5, -1.0, 1.0)
    mixed = in_memory(PointCloud(scan.positions, scan.normals * signs[:, None]))
    clock = StageClock(Progress())
    for given, is_wrong in ((in_memory(scan), False), (mixed, True)):
        scale = LocalScale.uniform(measure_spacing(given))
        same, oriented, _ = orient_cloud(given, scale, "file", UNKNOWN, clock, has_normals=True)
        assert same is given
        assert ["contradict" in warning for warning in oriented.warnings] == [True] * is_wrong


def test_random_sides_are_mended_and_good_ones_left() -> None:
    scan = _scan("knot", noise=0.001)
    assert scan.normals is not None
    assert not contradicts(scan)
    signs = np.where(np.random.default_rng(4).random(len(scan)) < 0.5, -1.0, 1.0)
    mixed = PointCloud(scan.positions, scan.normals * signs[:, None])
    assert contradicts(mixed)
    found, oriented = orient(mixed)
    assert _share_right(found, scan) >= 0.99
    assert oriented.source == "file"
    assert abs(oriented.flipped - np.count_nonzero(signs < 0.0)) < 0.02 * len(scan)
    assert "were turned round" in oriented.warnings[0]
    assert found.normals is not None
    unsigned = np.abs(np.einsum("ij,ij->i", found.normals, scan.normals))
    assert unsigned.min() > 1.0 - 1e-6


def test_a_scan_inside_out_among_others_is_turned() -> None:
    first, second = (_scan("torus", noise=0.001, seed=seed) for seed in (1, 2))
    assert first.normals is not None
    assert second.normals is not None
    positions = np.concatenate([first.positions, second.positions])
    truth = PointCloud(positions, np.concatenate([first.normals, second.normals]))
    mixed = PointCloud(positions, np.concatenate([first.normals, -second.normals]))
    assert contradicts(mixed)
    found, _ = orient(mixed)
    assert _share_right(found, truth) >= 0.999


def _turn_towards(scan: PointCloud, towards: FloatArray) -> PointCloud:
    assert scan.normals is not None
    along = np.einsum("ij,ij->i", scan.normals, towards)
    return PointCloud(scan.positions, scan.normals * np.where(along < 0.0, -1.0, 1.0)[:, None])


@pytest.mark.parametrize("name", ["torus", "knot"])
@pytest.mark.parametrize("place", [None, (0.0, 0.0, 5.0), (1.5, -4.0, 2.0)])
def test_normals_that_follow_a_place_are_turned_to_the_surface(
    name: str, place: tuple[float, float, float] | None
) -> None:
    scan = _scan(name, noise=0.001)
    up = np.broadcast_to([0.0, 0.0, 1.0], scan.positions.shape)
    signed = _turn_towards(scan, up if place is None else np.array(place) - scan.positions)
    found, oriented = orient(signed, is_oriented=True)
    assert _share_right(found, scan) > 0.98
    assert oriented.judgement == "follow a place"
    assert "follow one direction or place" in oriented.warnings[0]


@pytest.mark.parametrize("name", ["sphere", "torus", "knot", "box"])
def test_right_normals_of_a_file_are_left(name: str) -> None:
    scan = _scan(name, noise=0.001)
    found, oriented = orient(scan, is_oriented=True)
    assert found.normals is scan.normals or _share_right(found, scan) == 1.0
    assert oriented.is_believed
    assert oriented.warnings == []


def test_a_relief_that_faces_one_way_is_left_as_it_is() -> None:
    random = np.random.default_rng(5)
    x, y = random.uniform(-1.0, 1.0, (2, 12_000))
    relief = np.stack([x, y, 0.2 * np.sin(4.0 * x) * np.cos(3.0 * y)], axis=1)
    rise = np.stack(
        [0.8 * np.cos(4.0 * x) * np.cos(3.0 * y), -0.6 * np.sin(4.0 * x) * np.sin(3.0 * y)], axis=1
    )
    normals = np.column_stack([-rise, np.ones(len(x))])
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    for sign in (1.0, -1.0):  # it may face a camera below
        _, oriented = orient(PointCloud(relief, sign * normals), is_oriented=True)
        assert oriented.is_believed


@pytest.mark.parametrize("moved", [(0.0, 0.0, 0.0), (512_000.0, 5_403_000.0, 0.0)])
def test_the_options_that_a_doubt_names_decide(moved: tuple[float, float, float]) -> None:
    random = np.random.default_rng(6)
    sheet = random.uniform(-1.0, 1.0, (6_000, 3))
    sheet[:, 1] = 0.1 * np.sin(3.0 * sheet[:, 0])  # is y up, or down?
    found, oriented = orient(PointCloud(sheet, origin=np.array(moved)))
    assert oriented.sure < 0.1
    assert oriented.doubt is not None
    assert all(option in oriented.warnings[0] for option in oriented.doubt.options)
    faces = []
    for option in oriented.doubt.options:
        place = np.array([[float(number) for number in option.split(",")]])
        wanted, sure = orient(PointCloud(sheet, origin=np.array(moved)), Sensor("places", place))
        assert sure.sure > 0.99
        assert wanted.normals is not None
        faces.append(wanted.normals[:, 1].mean())
    assert found.normals is not None
    assert faces[0] * found.normals[:, 1].mean() > 0.9
    assert faces[0] * faces[1] < -0.9
