"""What another scan has seen through was not there: it goes, and nothing else does."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from directions import random_directions

import hpcapp
from hpcapp.applications.surface.normals.sensor import find_path
from hpcapp.applications.surface.normals.viewpoint import parse_viewpoint
from hpcapp.applications.surface.reading import seen_through
from hpcapp.applications.surface.reading.seen_through import (
    SEEN_THROUGH,
    are_seen_through,
    drop_seen_through,
    look_around,
)
from hpcapp.geometry.points import BoolArray, FloatArray
from hpcapp.io import PointSource, open_points, read_whole
from hpcapp.lab.simulate.raw.scan import RawSettings, scan_scene

ROOM = np.array([6.0, 5.0, 2.8])
CRATE = np.array([[4.3, 0.6, 0.0], [5.2, 1.4, 0.9]])
PERSON = np.array([[2.0, 2.0, 0.0], [2.5, 2.4, 1.7]])
STANDS = np.array([[1.0, 1.0, 1.5], [5.0, 4.2, 1.5], [1.2, 4.1, 1.4]])

NO_PATH = np.zeros((0, 4))

Scans = list[tuple[FloatArray, FloatArray]]


def _scan_room(points: int, *, with_person: bool = True) -> Scans:
    """Three scans of a room with a crate, during the first of which somebody stood there."""
    random, scans = np.random.default_rng(0), []
    for number, stand in enumerate(STANDS):
        rays = random_directions(points, random)
        far = np.where(rays > 0.0, (ROOM - stand) / rays, -stand / rays).min(axis=1)
        for low, high in [CRATE, *([PERSON] if with_person and not number else [])]:
            planes = np.sort([(low - stand) / rays, (high - stand) / rays], axis=0)
            enters, leaves = planes[0].max(axis=1), planes[1].min(axis=1)
            is_hit = (enters < leaves) & (enters > 0.0)
            far = np.where(is_hit, np.minimum(far, enters), far)
        scans.append((stand, stand + rays * (far + random.normal(0.0, 0.003, points))[:, None]))
    return scans


def _write(path: Path, scans: Scans) -> Path:
    with path.open("w", encoding="utf-8") as file:
        for stand, positions in scans:
            place = " ".join(map(str, stand.tolist()))
            file.write(f"{len(positions)}\n1\n{place}\n1 0 0\n0 1 0\n0 0 1\n")
            file.write(f"1 0 0 0\n0 1 0 0\n0 0 1 0\n{place} 1\n")
            np.savetxt(
                file, np.column_stack([positions - stand, np.full(len(positions), 0.5)]), "%.5f"
            )
    return path


def _walk(
    folder: Path, count: int = 400_000, late: float = 0.0, begin: float = 0.0, second: float = 1.0
) -> tuple[PointSource, Path, BoolArray]:
    """A scanner that is carried to and fro through the room for 40 s; the person leaves after 10.

    Return the points, with times that are late, the path, and which points are the person's. Times
    begin somewhere, in units of which a second has so many.
    """
    random = np.random.default_rng(1)
    times = np.linspace(0.0, 40.0, count)
    along = np.abs((times / 10.0) % 2.0 - 1.0)[:, None]
    eyes = STANDS[2] + along * (STANDS[1] - STANDS[2])
    rays = random_directions(count, random)
    far = np.where(rays > 0.0, (ROOM - eyes) / rays, -eyes / rays).min(axis=1)
    planes = np.sort([(PERSON[0] - eyes) / rays, (PERSON[1] - eyes) / rays], axis=0)
    enters, leaves = planes[0].max(axis=1), planes[1].min(axis=1)
    is_person = (enters < leaves) & (enters > 0.0) & (times < 10.0)
    far = np.where(is_person, enters, far) + random.normal(0.0, 0.003, count)
    np.savez(
        folder / "scan.npz",
        xyz=eyes + far[:, None] * rays,
        gps_time=second * (begin + times + late),
    )
    rows = np.column_stack([second * (begin + times), eyes])[:: count // 400]
    way = folder / "way.csv"
    np.savetxt(way, rows, "%.6f", ",", header="time,x,y,z", comments="")
    return open_points(folder / "scan.npz"), way, is_person


def _is_person(positions: FloatArray) -> BoolArray:
    """Tell which points are of the person, but for the feet."""
    low, high = PERSON
    inside: BoolArray = ((positions > low - 0.02) & (positions < high + 0.02)).all(axis=1)
    return inside & (positions[:, 2] > 0.05)


def _keep(source: PointSource) -> tuple[FloatArray, int]:
    kept = read_whole(drop_seen_through(source, NO_PATH)).positions
    return kept, source.findings.dropped.get(SEEN_THROUGH, 0)


def test_who_stood_in_one_scan_goes_and_all_else_stays(tmp_path: Path) -> None:
    source = open_points(_write(tmp_path / "room.ptx", _scan_room(40_000)))
    before = read_whole(source).positions
    kept, dropped = _keep(source)
    person = _is_person(before).sum()
    assert _is_person(kept).sum() < 0.15 * person
    assert dropped == len(before) - len(kept) <= person
    assert (~_is_person(kept)).sum() > (~_is_person(before)).sum() - 40  # feet, and noise


@pytest.mark.parametrize(("bins", "least"), [(1.0, 0.85), (20.0, 0.0)])
def test_how_far_behind_it_must_be_matters(
    bins: float, least: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = open_points(_write(tmp_path / "room.ptx", _scan_room(20_000)))
    person = _is_person(read_whole(source).positions).sum()
    monkeypatch.setattr(seen_through, "_BEYOND", bins)
    gone = 1.0 - _is_person(_keep(source)[0]).sum() / person
    assert least <= gone <= least + 0.5


def test_what_hangs_together_with_it_goes_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where somebody stands before the crate, or at an edge of it, no scan looks through."""
    source = open_points(_write(tmp_path / "room.ptx", _scan_room(40_000)))
    person, left = _is_person(read_whole(source).positions).sum(), []
    for share in (0.3, 0.5, 1.0):  # nothing is added by the last
        monkeypatch.setattr(seen_through, "_TOGETHER", share)
        kept, _ = _keep(source)
        left.append(_is_person(kept).sum() / person)
    assert left[0] <= left[1] < 0.1 < left[2] + 0.02, left


def test_so_many_scans_are_asked_whatever_their_number(tmp_path: Path) -> None:
    scans = [scan for _ in range(5) for scan in _scan_room(500)]
    around = look_around(open_points(_write(tmp_path / "room.ptx", scans)), NO_PATH)
    assert around is not None
    points = scans[0][1]
    asked = np.concatenate([rows for _, rows in around.ask(points, 0)])
    assert np.array_equal(np.bincount(asked), np.full(len(points), seen_through.MOST_ASKED))


def test_nothing_goes_where_nobody_was(tmp_path: Path) -> None:
    path = _write(tmp_path / "room.ptx", _scan_room(20_000, with_person=False))
    assert _keep(open_points(path))[1] == 0


@pytest.mark.parametrize("scene", ["town", "room", "heap"])
@pytest.mark.parametrize("apart", [0.0, 0.01])
def test_nothing_goes_of_what_all_scans_saw(scene: str, apart: float, tmp_path: Path) -> None:
    raw = scan_scene(scene, "terrestrial", RawSettings(points=60_000, seed=3))
    numbers, times = raw.cloud.attributes["point_source_id"], raw.cloud.attributes["gps_time"]
    scans = []
    for number in np.unique(numbers):
        rows, moved = numbers == number, apart * float(number) * np.array([1.0, 0.0, 0.5])
        stand = raw.trajectory[np.argmin(np.abs(raw.trajectory[:, 0] - np.median(times[rows]))), 1:]
        scans.append((stand + moved, raw.cloud.positions[rows] + raw.cloud.origin + moved))
    assert _keep(open_points(_write(tmp_path / "scene.ptx", scans)))[1] <= 3


def test_scans_that_stood_elsewhere_look_through_nothing(tmp_path: Path) -> None:
    scans = _scan_room(20_000)
    elsewhere = [(np.array([3.0, 2.5, 9.0 + 5.0 * i]), p) for i, (_, p) in enumerate(scans)]
    source = open_points(_write(tmp_path / "room.ptx", elsewhere))
    assert len(_keep(source)[0]) == len(read_whole(source))


def test_scans_of_several_files_are_told_apart(
    tmp_path: Path, run: Callable[..., tuple[int, str, str]]
) -> None:
    scans = _scan_room(20_000)
    names = [str(_write(tmp_path / f"{i}.ptx", [one])) for i, one in enumerate(scans)]
    code, said, _ = run("reconstruct", *names, "-o", str(tmp_path / "m.ply"), "--json")
    assert code == 0
    assert json.loads(said)["dropped"][SEEN_THROUGH] > 200


@pytest.mark.parametrize(("begin", "second"), [(0.0, 1.0), (1.7e9, 1e3), (1.7e9, 1e9)])
def test_who_left_while_a_scanner_was_carried_goes_and_all_else_stays(
    begin: float, second: float, tmp_path: Path
) -> None:
    source, way, is_person = _walk(tmp_path, begin=begin, second=second)
    around = look_around(source, find_path(parse_viewpoint([str(way)])))
    goes = are_seen_through(read_whole(source), around)
    assert goes[is_person].mean() > 0.7
    assert goes[~is_person].mean() < 0.001


def test_times_that_are_not_those_of_the_path_are_said(tmp_path: Path) -> None:
    source, way, _ = _walk(tmp_path, 4000, late=1e6)
    assert drop_seen_through(source, find_path(parse_viewpoint([str(way)]))) is source
    assert source.findings.warnings == [
        "what moved is not looked for: points were measured from 1e+06 to 1.00004e+06, the "
        "trajectory goes from 0 to 39.91"
    ]


@pytest.mark.parametrize("time", [0.0, 5.0, 6e10])
def test_times_that_are_no_seconds_are_said(time: float, tmp_path: Path) -> None:
    """All the same, or so far apart that the way would have pieces without end."""
    points = random_directions(500, np.random.default_rng(2))
    np.savez(tmp_path / "scan.npz", xyz=points, gps_time=np.linspace(0.0, time, 500))
    path = np.array([[0.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.1, time]])
    source = open_points(tmp_path / "scan.npz")
    around = look_around(source, path)
    assert (around is None) == (time != 5.0)
    assert bool(source.findings.warnings) == (time != 5.0)


def test_a_path_tells_a_job_and_the_file_of_what_goes(
    tmp_path: Path, run: Callable[..., tuple[int, str, str]]
) -> None:
    source, way, _ = _walk(tmp_path, 200_000)
    scan, gone = str(source.path), str(tmp_path / "gone.ply")
    code, said, _ = run(
        "reconstruct", scan, "-o", str(tmp_path / "m.ply"), "--viewpoint", str(way), "--json"
    )
    assert code == 0
    dropped = json.loads(said)["dropped"][SEEN_THROUGH]
    assert dropped > 200
    code, _, said = run(
        "convert", scan, "-o", str(tmp_path / "all.ply"), "--rejected", gone,
        "--viewpoint", str(way),
    )  # fmt: skip
    assert code == 0, said
    assert f"{dropped} {SEEN_THROUGH}" in said
    code, _, said = run("convert", scan, "-o", str(tmp_path / "b.ply"), "--viewpoint", str(way))
    assert (code, "give --rejected, too" in said) == (2, True)


def test_one_scan_is_not_looked_at(tmp_path: Path) -> None:
    source = open_points(_write(tmp_path / "one.ptx", _scan_room(5_000)[:1]))
    assert drop_seen_through(source, NO_PATH) is source


def test_a_job_drops_them_alike_in_memory_and_in_a_folder(tmp_path: Path) -> None:
    path = _write(tmp_path / "room.ptx", _scan_room(20_000))
    whole = hpcapp.reconstruct(path, executor="serial")
    parts = hpcapp.reconstruct(path, executor="serial", temp_dir=tmp_path)
    assert whole.facts["dropped"] == parts.facts["dropped"]
    assert whole.facts["dropped"][SEEN_THROUGH] > 200
    assert np.array_equal(whole.vertices, parts.vertices)
    every = hpcapp.reconstruct(path, executor="serial", clean=False)
    assert SEEN_THROUGH not in every.facts["dropped"]


def test_what_goes_can_be_written_into_a_file_of_its_own(
    tmp_path: Path, run: Callable[..., tuple[int, str, str]]
) -> None:
    path, rejected = _write(tmp_path / "room.ptx", _scan_room(20_000)), tmp_path / "gone.ply"
    code, _, said = run(
        "convert", str(path), "-o", str(tmp_path / "all.ply"), "--rejected", str(rejected)
    )
    assert code == 0, said
    gone = _is_person(read_whole(open_points(rejected)).positions).sum()
    assert gone > 200
    assert int(said.split(f" {SEEN_THROUGH}")[0].split()[-1]) == gone
