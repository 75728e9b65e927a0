"""Tiles that jobs of other scans take: the mesh is that of a fresh job, byte for byte."""

from __future__ import annotations

import logging
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from little_memory import leave_little_memory

import hpcapp
from hpcapp.api.mesh import Mesh
from hpcapp.applications.surface.job import storage
from hpcapp.geometry.points import PointCloud
from hpcapp.io import write_points

if TYPE_CHECKING:
    from lab_bucket import Bucket

pytest_plugins = ["lab_bucket"]

SCANS = 6
FAR = np.array([450_000.0, 5_400_000.0, 300.0])


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A hilly strip, scanned from left to right; the last scan lies amid the others."""
    random, folder = np.random.default_rng(5), tmp_path_factory.mktemp("scans")
    made = []
    for index in range(SCANS + 1):
        # The scans reach half a unit into each other.
        left, right = (9.0, 9.6) if index == SCANS else (3.0 * index, 3.0 * index + 3.5)
        x, y = random.uniform((left, 0.0), (right, 2.0), (int(1_500 * (right - left)), 2)).T
        z = 0.2 * np.sin(3.0 * x) * np.cos(2.0 * y)
        slopes = 0.6 * np.cos(3.0 * x) * np.cos(2.0 * y), -0.4 * np.sin(3.0 * x) * np.sin(2.0 * y)
        normals = np.stack([-slopes[0], -slopes[1], np.ones(len(x))], axis=1)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        positions = np.stack([x, y, z], axis=1) + 0.002 * random.normal(size=(len(x), 1)) * normals
        path = folder / f"scan-{index}.ply"
        write_points(path, PointCloud(positions, normals))
        made.append(path)
    return made


def update(scans: list[Path], place: Path | str, **asked: Any) -> tuple[Mesh, int, int]:
    """Return the mesh, how many tiles it has, and how many of these were taken."""
    settings = {"grid": 192, "executor": "serial", "attributes": "none", **asked}
    mesh = hpcapp.reconstruct([str(path) for path in scans], update=place, **settings)
    return mesh, mesh.facts["tiles"], mesh.facts["tiles_taken"]


def bits(mesh: Mesh) -> tuple[bytes, bytes]:
    return mesh.vertices.tobytes(), mesh.faces.tobytes()


def forget_tiles(place: Path) -> Path:
    """Return a copy of a place that has all but the tiles: what a fresh job is to begin with."""
    fresh = place.with_name(f"{place.name}-fresh")
    fresh.mkdir(0o700)
    shutil.copytree(place / "frames", fresh / "frames")
    return fresh


@pytest.fixture(scope="module")
def first(scans: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The place in which a job of all scans but the last one has left its tiles."""
    place = tmp_path_factory.mktemp("first") / "place"
    _, tiles, taken = update(scans[:SCANS], place)
    assert tiles > 5
    assert taken == 0
    return place


@pytest.fixture
def place(first: Path, tmp_path: Path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(first, tmp_path / "place"))


@pytest.mark.parametrize(
    ("close", "change"),
    [("auto", "added"), ("auto", "removed"), ("auto", "none"), ("yes", "added")],
)
def test_an_updated_mesh_is_that_of_a_fresh_job(
    close: str, change: str, scans: list[Path], tmp_path: Path
) -> None:
    place = tmp_path / "place"
    before = scans if change == "removed" else scans[:SCANS]
    now = [scans[SCANS], *scans[:SCANS]] if change == "added" else scans[:SCANS]
    old, tiles, _ = update(before, place, close=close)
    fresh, _, none = update(now, forget_tiles(place), close=close)
    mesh, tiles, taken = update(now, place, close=close)
    assert bits(mesh) == bits(fresh)
    assert none == 0
    assert 0 < taken <= tiles
    assert (taken == tiles) == (change == "none")
    assert (bits(mesh) == bits(old)) == (change == "none")


@pytest.mark.slow
def test_where_points_lie_and_who_works_changes_no_bit(
    scans: list[Path], first: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [scans[SCANS], *scans[:SCANS]]
    found = []
    for name, asked in {
        "serial": {}, "threads": {"executor": "threads", "workers": 2},
        "disk": {"executor": "processes", "workers": 2, "max_memory": "8G"},
    }.items():  # fmt: skip
        if name == "disk":  # from here on
            leave_little_memory(monkeypatch, 6_000)
        place = Path(shutil.copytree(first, tmp_path / name))
        found.append(update(now, place, **asked))
    assert found[0][2] > 0
    assert [bits(mesh) for mesh, *_ in found[1:]] == [bits(found[0][0])] * 2
    assert [taken for *_, taken in found] == [found[0][2]] * 3


def test_other_settings_take_nothing(scans: list[Path], place: Path) -> None:
    _, _, taken = update(scans[:SCANS], place, smoothness=1.5)
    assert taken == 0
    assert len(list((place / "frames").iterdir())) == 2  # those of before are gone


@pytest.mark.slow
def test_another_build_takes_nothing(
    scans: list[Path], place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(storage, "kernel_id", lambda: "another")
    _, _, taken = update(scans[:SCANS], place)
    assert taken == 0


@pytest.mark.slow
def test_points_beyond_the_frame_make_another_one(
    scans: list[Path], place: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    beyond = tmp_path / "beyond.ply"
    points = hpcapp.read_points(scans[SCANS])
    write_points(beyond, PointCloud(points.positions + np.array([20.0, 0.0, 0.0]), points.normals))
    with caplog.at_level(logging.WARNING, "hpcapp"):
        _, _, taken = update([*scans[:SCANS], beyond], place)
    assert taken == 0
    assert "beyond the box" in caplog.text
    _, tiles, taken = update([*scans[:SCANS], beyond], place)
    assert taken == tiles


@pytest.mark.parametrize("damage", [b"", b"hpcvalue3 and then nothing"])
def test_a_damaged_tile_is_made_again(
    damage: bytes, scans: list[Path], place: Path, caplog: pytest.LogCaptureFixture
) -> None:
    whole, *_ = update(scans[:SCANS], Path(shutil.copytree(place, f"{place}-whole")))
    damaged = [path for path in sorted((place / "tiles").iterdir()) if path.is_file()]
    for path in damaged:
        path.write_bytes(damage)
    with caplog.at_level(logging.WARNING, "hpcapp"):
        mesh, _, taken = update(scans[:SCANS], place)
    assert bits(mesh) == bits(whole)
    assert taken == 0
    assert "is made again" in caplog.text


@pytest.mark.slow
def test_a_tile_of_other_points_is_refused_under_a_name_that_is_not_its_own(
    scans: list[Path], place: Path
) -> None:
    whole, _, _ = update(scans[:SCANS], Path(shutil.copytree(place, f"{place}-whole")))
    paths = sorted((path for path in (place / "tiles").iterdir() if path.is_file()), key=str)
    contents = [path.read_bytes() for path in paths]
    for path, content in zip(paths, [*contents[1:], contents[0]], strict=True):
        path.write_bytes(content)
    mesh, _, taken = update(scans[:SCANS], place)
    assert bits(mesh) == bits(whole)
    assert taken == 0


@pytest.mark.slow
def test_what_a_job_that_was_stopped_has_finished_is_taken(scans: list[Path], place: Path) -> None:
    whole, tiles, _ = update(scans[:SCANS], Path(shutil.copytree(place, f"{place}-whole")))
    made = sorted(path for path in (place / "tiles").iterdir() if path.is_file())
    for path in made[::2]:
        path.unlink()
    mesh, _, taken = update(scans[:SCANS], place)
    assert bits(mesh) == bits(whole)
    assert taken < tiles


@pytest.mark.slow
def test_a_place_holds_the_tiles_of_its_last_job_alone(scans: list[Path], place: Path) -> None:
    before = {path.name for path in (place / "tiles").iterdir()}
    update([scans[SCANS], *scans[:SCANS]], place)
    update(scans[:SCANS], place)
    assert {path.name for path in (place / "tiles").iterdir()} == before
    assert not (place / "points").exists()


@pytest.mark.slow
def test_georeferenced_scans_keep_their_origin(scans: list[Path], tmp_path: Path) -> None:
    """That of their box alone would be another one with each scan."""
    far = []
    for scan in scans:
        points = hpcapp.read_points(scan)
        far.append(tmp_path / scan.name)
        write_points(far[-1], PointCloud(points.positions + FAR, points.normals))
    place = tmp_path / "place"
    update(far[1:SCANS], place)
    fresh, _, none = update(far[1:], forget_tiles(place))
    mesh, _, taken = update(far[1:], place)
    assert (none, taken > 0) == (0, True)
    assert bits(mesh) == bits(fresh)


@pytest.mark.slow
@pytest.mark.usefixtures("endpoint")
def test_tiles_lie_in_a_bucket_as_well(
    bucket: Bucket, scans: list[Path], first: Path, tmp_path: Path
) -> None:
    del bucket
    update(scans[:SCANS], "s3://lab/strip")
    now = [scans[SCANS], *scans[:SCANS]]
    mesh, _, taken = update(now, "s3://lab/strip")
    there, _, as_many = update(now, Path(shutil.copytree(first, tmp_path / "place")))
    assert bits(mesh) == bits(there)
    assert taken == as_many > 0


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("--update", "{}/file"), 2, "is not a folder"),
        (("--update", "{}/other"), 2, "holds other things than the tiles of a job, as notes.txt"),
        (("--update", "{}/new", "--temp-dir", "{}/t"), 2, "exclude each other"),
        (("--update", "{}/new", "--resume"), 2, "--resume"),
        (("--update", "{}/new", "--method", "paper"), 2, "means nothing to --method paper"),
        (("--update", "gs://lab"), 2, "no store is known"),
        (("--update", ""), 2, "names no file"),
    ],
)
def test_what_cannot_be_is_one_line(
    words: tuple[str, ...], code: int, said: str, scans: list[Path], tmp_path: Path, run: Any
) -> None:
    (tmp_path / "file").write_text("")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("mine")
    asked = [word.format(tmp_path) for word in words]
    found, _, err = run("reconstruct", str(scans[0]), "-o", str(tmp_path / "mesh.ply"), *asked)
    assert found == code
    assert said in err.splitlines()[-1]
    assert (tmp_path / "other" / "notes.txt").read_text() == "mine"
