"""A cloud that is not in memory, and tiles that are kept: the mesh is the same, byte for byte."""

from __future__ import annotations

import errno
import os
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from directions import random_directions
from hypothesis import given
from hypothesis import strategies as st
from little_memory import leave_little_memory

from hpcapp.api.reconstruction import reconstruct
from hpcapp.applications.surface.attributes.choice import parse_attributes
from hpcapp.applications.surface.cli.run import run_job
from hpcapp.applications.surface.extraction.parts import MeshPart
from hpcapp.applications.surface.hierarchical import method
from hpcapp.applications.surface.hierarchical.settings import Hierarchical
from hpcapp.applications.surface.job import plan, site
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.methods.method import TILE_POINTS
from hpcapp.applications.surface.resolution.memory import LEAST_TILE, Together, parse_limit
from hpcapp.applications.surface.steps import read
from hpcapp.applications.surface.stitching import shared_ply, surface, tile_ply
from hpcapp.applications.surface.stitching.handle_groups import Mended
from hpcapp.geometry.points import PointCloud
from hpcapp.io import read_mesh, read_points, write_points
from hpcapp.progress import Progress, ProgressObserver
from hpccomponent.errors import OutputError, UsageError

if TYPE_CHECKING:
    from lab_bucket import Bucket

pytest_plugins = ["lab_bucket"]
pytestmark = pytest.mark.usefixtures("endpoint")

SILENT = Progress()


class Stages(ProgressObserver):
    """Remembers which stages began."""

    def __init__(self) -> None:
        self.begun: list[str] = []

    def on_begin(self, stage: str) -> None:
        """Take note."""
        self.begun.append(stage)


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A torus with noise, a few outliers and a hole, whose surface no tile closes by itself."""
    rng = np.random.default_rng(2)
    u, v = rng.uniform(0, 2 * np.pi, (2, 30_000))
    normals = np.stack([np.cos(u) * np.cos(v), np.sin(u) * np.cos(v), np.sin(v)], axis=1)
    ring = np.stack([np.cos(u), np.sin(u), np.zeros_like(u)], axis=1)
    positions = ring + (0.4 + 0.002 * rng.normal(size=(len(u), 1))) * normals
    positions[:20] = rng.uniform(-2, 2, (20, 3))
    kept = (positions[:, 0] < 0.9) | (np.abs(positions[:, 1]) > 0.3)
    path = tmp_path_factory.mktemp("scan") / "scan.ply"
    write_points(path, PointCloud(positions[kept], normals[kept]))
    return path


@pytest.fixture(scope="module")
def whole(scan: Path) -> bytes:
    """The mesh of all points at once, in memory."""
    output = scan.with_name("whole.ply")
    report = run_job(JobSettings(scan, str(output), grid=96), SILENT)
    assert report["watertight"]
    assert report["tiles"] == 1
    return output.read_bytes()


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let so many points be too many for memory, and tiles be small."""
    leave_little_memory(monkeypatch, 6_000)


@pytest.mark.slow
@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("backend", ["serial", "threads", "processes", "zmq"])
def test_a_cloud_on_disk_gives_the_bytes_of_one_in_memory(
    backend: str, scan: Path, whole: bytes, tmp_path: Path
) -> None:
    room = tmp_path / "room"
    output = tmp_path / "mesh.ply"
    workers = None if backend == "serial" else 2
    settings = JobSettings(
        scan, str(output), grid=96, backend=backend, workers=workers, temp_dir=str(room)
    )
    report = run_job(settings, SILENT)
    assert output.read_bytes() == whole
    assert report["tiles"] > 1
    assert report["dropped"]["outliers"] > 0
    assert list(room.rglob("*")) == []  # what was kept is taken away


@pytest.mark.slow
@pytest.mark.leaks_allowed  # loky keeps its resource tracker
@pytest.mark.parametrize("backend", ["serial", "processes", "zmq", "loky:ProcessPoolExecutor"])
def test_how_sure_the_sides_of_normals_are_is_known_on_disk_too(
    backend: str, scan: Path, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """Whether workers see the folder or not, as those of loky."""
    is_foreign = ":" in backend
    if is_foreign:
        pytest.importorskip("loky", reason="loky is not installed")
    whole, output = tmp_path / "whole.ply", tmp_path / "mesh.ply"
    choice = parse_attributes("confidence")
    settings = JobSettings(scan, str(whole), grid=96, normals="estimate", attributes=choice)
    run_job(settings, SILENT)
    request.getfixturevalue("small")
    workers = None if is_foreign or backend == "serial" else 2
    report = run_job(
        replace(settings, output=str(output), backend=backend, workers=workers), SILENT
    )
    assert report["tiles"] > 1
    assert report["attributes"] == ["confidence"]
    assert b"property float confidence" in output.read_bytes()
    assert output.read_bytes() == whole.read_bytes()


@pytest.mark.slow
@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("backend", ["serial", "processes", "zmq"])
def test_a_view_on_disk_is_cut_open_alike(backend: str, scan: Path, tmp_path: Path) -> None:
    """The upper half of the torus: workers that hold the parts cut them."""
    given = read_points(scan)
    upper = tmp_path / "upper.ply"
    write_points(upper, given.take(np.flatnonzero(given.positions[:, 2] > 0.0)))
    output, workers = tmp_path / "mesh.ply", None if backend == "serial" else 2
    settings = JobSettings(
        upper, str(output), grid=96, backend=backend, workers=workers, temp_dir=str(tmp_path / "t"),
        method=Hierarchical(close="no"),
    )  # fmt: skip
    report = run_job(settings, SILENT)
    assert report["tiles"] > 1
    assert report["open"]
    assert f"open, {report['boundaries']} boundaries" in report["summary"]
    half = given.take(np.flatnonzero(given.positions[:, 2] > 0.0))
    reconstruct(half, grid=96, close="no").save(tmp_path / "whole.ply")
    assert output.read_bytes() == (tmp_path / "whole.ply").read_bytes()


@pytest.mark.parametrize(("points", "grid"), [(12, 48), (300, 32), (20_000, 16)])
@pytest.mark.parametrize("backend", ["serial", "zmq"])
def test_a_cloud_of_one_level_is_one_tile(
    points: int, grid: int, backend: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arms = random_directions(points, 5)
    scan, output = tmp_path / "scan.ply", tmp_path / "mesh.ply"
    write_points(scan, PointCloud(1.5 * arms + (7.0, 0.0, 0.0), arms))
    run_job(JobSettings(scan, str(tmp_path / "whole.ply"), grid=grid), SILENT)
    leave_little_memory(monkeypatch)
    report = run_job(JobSettings(scan, str(output), grid=grid, backend=backend), SILENT)
    assert report["tiles"] == report["levels"] == 1
    assert output.read_bytes() == (tmp_path / "whole.ply").read_bytes()


@pytest.mark.usefixtures("small")
def test_a_grid_that_makes_one_tile_of_too_many_points_is_refused(
    scan: Path, tmp_path: Path
) -> None:
    with pytest.raises(UsageError, match=r"a grid of 16 cells .* max_memory; .* finer grid"):
        run_job(JobSettings(scan, str(tmp_path / "mesh.ply"), grid=16), SILENT)


def test_an_open_scan_is_doubted_alike_wherever_its_points_are(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    """Much of such a mesh lies in bricks without points, which several parts have."""
    x, y = np.random.default_rng(6).uniform(-1.0, 1.0, (2, 12_000))
    normals = np.stack([0.6 * x, 0.6 * y, np.ones_like(x)], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    positions = np.stack([x, y, -0.3 * (x * x + y * y)], axis=1)
    scan, output = tmp_path / "scan.ply", tmp_path / "mesh.ply"
    write_points(scan, PointCloud(positions, normals))
    settings = JobSettings(scan, str(output), grid=64, method=Hierarchical(close="yes"))
    warnings = run_job(settings, SILENT)["warnings"]
    low, high = positions.min(axis=0), positions.max(axis=0)
    slack = 2.0 * float((high - low).max()) / 56
    vertices = read_mesh(output).vertices
    share = np.mean(((vertices < low - slack) | (vertices > high + slack)).any(axis=1))
    assert share > 0.1
    assert len(warnings) == 1
    assert float(warnings[0].partition(" % of the mesh lies outside")[0]) == pytest.approx(
        100.0 * share,
        abs=3.0,  # cleaning makes the box smaller
    )
    request.getfixturevalue("small")
    assert run_job(settings, SILENT)["warnings"] == warnings


def test_workers_read_a_cloud_that_memory_would_hold(
    scan: Path, whole: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan, "FOLDER_FROM_POINTS", 10_000)
    monkeypatch.setattr(read, "read_whole", None)
    output = tmp_path / "mesh.ply"
    run_job(JobSettings(scan, str(output), grid=96, backend="zmq", workers=2), SILENT)
    assert output.read_bytes() == whole


@pytest.mark.usefixtures("small")
@pytest.mark.leaks_allowed  # loky keeps its resource tracker
def test_workers_that_see_no_folder_are_sent_points_and_give_tiles_back(
    scan: Path, whole: bytes, tmp_path: Path
) -> None:
    pytest.importorskip("loky", reason="loky is not installed")
    output = tmp_path / "mesh.ply"
    run_job(JobSettings(scan, str(output), grid=96, backend="loky:ProcessPoolExecutor"), SILENT)
    assert output.read_bytes() == whole


@pytest.mark.slow
@pytest.mark.usefixtures("small")
@pytest.mark.leaks_allowed  # boto3 closes its connections when it is collected
def test_workers_keep_tiles_in_a_bucket(
    scan: Path, whole: bytes, tmp_path: Path, bucket: Bucket
) -> None:
    output = tmp_path / "mesh.ply"
    settings = JobSettings(
        scan, str(output), grid=96, backend="zmq", workers=2, temp_dir="s3://lab/tiles"
    )
    run_job(settings, SILENT)
    assert output.read_bytes() == whole
    assert list(bucket.objects.all()) == []


@pytest.mark.usefixtures("small")
def test_workers_write_the_mesh_themselves(
    scan: Path, whole: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without small handles: the master looks for these itself."""

    def load(*_: object) -> MeshPart:
        raise AssertionError

    monkeypatch.setattr(surface.Surface, "load", load)
    monkeypatch.setattr(method, "mend_handles", lambda given, _: (given, Mended()))
    output = tmp_path / "mesh.ply"
    run_job(JobSettings(scan, str(output), grid=96, backend="zmq", workers=2), SILENT)
    assert output.read_bytes() == whole


class Memory(ProgressObserver):
    """Measures what this process has more at most, from the extraction's end on, than before it."""

    def on_begin(self, stage: str) -> None:
        """Take note of the memory before the extraction."""
        if stage == "extract":
            self._before = tracemalloc.get_traced_memory()[0]

    def on_end(self, stage: str, seconds: float) -> None:
        """Look only at what comes after the extraction."""
        if stage == "close":
            tracemalloc.reset_peak()
        more = tracemalloc.get_traced_memory()[1] - getattr(self, "_before", 0)
        self.growth = max(0, more)  # the far field may be let go before the end, or after it


@pytest.mark.slow
@pytest.mark.usefixtures("small")
def test_the_memory_does_not_grow_with_the_mesh(scan: Path, tmp_path: Path) -> None:
    output = tmp_path / "mesh.ply"
    sizes, growths = [], []
    for grid in (64, 192):
        memory = Memory()
        tracemalloc.start()
        run_job(
            JobSettings(scan, str(output), grid=grid, backend="zmq", workers=2), Progress(memory)
        )
        tracemalloc.stop()
        sizes.append(output.stat().st_size)
        growths.append(memory.growth)
    assert sizes[1] > sizes[0] + 2e6
    assert growths[1] - growths[0] < 0.2 * (sizes[1] - sizes[0])  # bricks and seams


@pytest.mark.usefixtures("small")
def test_what_a_worker_cannot_write_is_written_here(
    scan: Path, whole: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[str, str]] = []

    def write_kept(kept: tuple[str, str], *values: Any) -> bool:
        asked.append(kept)
        return len(asked) % 2 == 0 and shared_ply.write_kept(kept, *values)

    monkeypatch.setattr(surface, "write_kept", write_kept)
    output = tmp_path / "mesh.ply"
    run_job(JobSettings(scan, str(output), grid=96, backend="serial"), SILENT)
    assert output.read_bytes() == whole
    assert len(asked) > 2


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("backend", ["serial", "threads"])
def test_a_full_disk_leaves_the_old_mesh(
    backend: str, scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write(*_: object) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "pwrite", write)
    output = tmp_path / "mesh.ply"
    output.write_bytes(b"the mesh of yesterday")
    with pytest.raises(OutputError, match=f"^{output}: cannot be written: No space left"):
        run_job(JobSettings(scan, str(output), grid=96, backend=backend), SILENT)
    assert output.read_bytes() == b"the mesh of yesterday"
    assert list(tmp_path.iterdir()) == [output]


@pytest.mark.slow
@pytest.mark.usefixtures("bucket")
@pytest.mark.leaks_allowed  # boto3 closes its connections when it is collected
@pytest.mark.parametrize("name", ["mesh.obj", "mesh.tiles"])
def test_what_is_kept_is_written_in_other_formats_too(
    name: str, scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(site, "choose_tile", lambda *_: 6_000)
    room = str(tmp_path / "room")
    places = ((None, "serial"), (room, "serial"), (room, "processes"), ("s3://lab/tiles", "serial"))
    meshes = []
    for index, (place, backend) in enumerate(places):  # the first leaves parts in memory
        output = tmp_path / str(index) / name
        output.parent.mkdir()
        settings = JobSettings(scan, str(output), grid=48, backend=backend, temp_dir=place)
        run_job(settings, SILENT)
        files = [output] if output.is_file() else sorted(output.iterdir())
        meshes.append({file.name: file.read_bytes() for file in files})
        assert list(output.parent.iterdir()) == [output]
    assert meshes[0] == meshes[1] == meshes[3]
    if name == "mesh.obj":
        assert meshes[2] == meshes[0]
    else:  # how many there are depends on the workers
        assert len(meshes[2]) > 1


@pytest.mark.usefixtures("small")
def test_a_tile_that_a_worker_cannot_write_is_written_here(
    scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write_some(kept: tuple[str, str], *values: Any) -> bool:
        asked.append(kept)
        return len(asked) % 2 == 0 and tile_ply.write_kept_tile(kept, *values)

    meshes: list[dict[str, bytes]] = []
    for write in (tile_ply.write_kept_tile, write_some):
        asked: list[tuple[str, str]] = []
        monkeypatch.setattr(surface, "write_kept_tile", write)
        output = tmp_path / f"{len(meshes)}.tiles"
        run_job(JobSettings(scan, str(output), grid=48, backend="serial"), SILENT)
        meshes.append({file.name: file.read_bytes() for file in output.iterdir()})
    assert len(asked) > 2
    assert meshes[0] == meshes[1]


@pytest.mark.usefixtures("small")
def test_tiles_can_be_the_output(scan: Path, whole: bytes, tmp_path: Path) -> None:
    run_job(JobSettings(scan, str(tmp_path / "mesh.tiles"), grid=96), SILENT)
    tiles = sorted((tmp_path / "mesh.tiles").iterdir())
    assert len(tiles) > 1
    (tmp_path / "whole.ply").write_bytes(whole)
    faces = sum(len(read_mesh(tile).faces) for tile in tiles)
    assert faces == len(read_mesh(tmp_path / "whole.ply").faces)


@pytest.mark.usefixtures("small")
def test_steps_that_need_all_points_are_refused(scan: Path, tmp_path: Path) -> None:
    settings = JobSettings(scan, str(tmp_path / "mesh.ply"), grid=64, denoise=True)
    with pytest.raises(UsageError, match="'denoise' needs all points in memory"):
        run_job(settings, SILENT)


def test_to_resume_takes_a_folder(scan: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="--temp-dir"):
        run_job(JobSettings(scan, str(tmp_path / "mesh.ply"), resume=True), SILENT)


@pytest.mark.parametrize("place", ["ftp://machine/tiles", "{file}/tiles"])
def test_a_place_that_cannot_be_had_is_found_out_before_the_work(
    place: str, scan: Path, tmp_path: Path
) -> None:
    place = place.format(file=scan)
    settings = JobSettings(scan, str(tmp_path / "mesh.ply"), grid=64, temp_dir=place)
    stages = Stages()
    with pytest.raises((UsageError, OutputError)):
        run_job(settings, Progress(stages))
    assert stages.begun == []


@pytest.mark.parametrize("text", ["", "2X", "-1G", "1e9", "G", "100M"])
def test_what_is_no_size_is_refused(text: str) -> None:
    with pytest.raises(UsageError):
        parse_limit(text)


def test_tiles_follow_the_memory() -> None:
    assert parse_limit("1.5g") == 1.5 * 2**30
    assert parse_limit("300MiB") == 300 * 2**20
    points = 10_000_000
    tiles = [Together(points, 2).fit(limit) for limit in (2.0**40, 2.0**31, 2.0**30)]
    assert tiles[0] == TILE_POINTS
    assert tiles == sorted(tiles, reverse=True)
    assert Together(points, 1, in_process=True).fit(2.0**31) > tiles[1]


@given(st.integers(1, 10**10), st.integers(1, 64), st.booleans(), st.floats(28.0, 40.0))
def test_all_processes_together_fit_the_limit_or_take_the_least(
    points: int, workers: int, has_normals: bool, power: float
) -> None:
    together, limit = Together(points, workers, has_normals=has_normals), 2.0**power
    tile = together.fit(limit)
    assert LEAST_TILE <= tile <= TILE_POINTS
    whole = together.whole(tile)
    assert whole == together.own(tile) + workers * together.each(tile)
    if whole > limit:
        assert not together.fits(limit)
        assert all(together.whole(size) >= 0.9 * whole for size in (50_000, 400_000, 2_500_000))
