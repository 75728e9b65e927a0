"""Jobs that share a folder, that were killed, that failed, and whose folder was damaged."""

from __future__ import annotations

import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from directions import random_directions
from little_memory import leave_little_memory

from hpcapp.applications.surface.cli.run import run_job
from hpcapp.applications.surface.hierarchical import all_tiles
from hpcapp.applications.surface.job import storage
from hpcapp.applications.surface.job.plan import Place
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.tiles import tasks as region
from hpcapp.geometry.points import PointCloud
from hpcapp.io import write_points
from hpcapp.progress import Progress
from hpccomponent.errors import InputError, JobError, NoWorkersError
from hpccomponent.files.held_folders import read_owner

pytest_plugins = ["lab_bucket"]
pytestmark = pytest.mark.usefixtures("endpoint")

SILENT = Progress()
OPTIONS = ("--grid", "64", "--backend", "zmq", "--workers", "2")

PAUSED = """
import os, sys
from hpcapp.applications.surface.hierarchical import all_tiles
from hpcapp.cli import main

def stream_some(*arguments):
    for number, result in enumerate(stream_batches(*arguments), 1):
        yield result
        if number == 1:
            print("paused", flush=True)
            if sys.stdin.readline() == "fail\\n":
                from hpccomponent.errors import WorkerLostError
                raise WorkerLostError("the last worker is gone")

os.umask(0)
stream_batches, all_tiles.stream_batches = all_tiles.stream_batches, stream_some
main()
"""


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sphere with a dent, which takes several small tiles."""
    normals = random_directions(20_000, 4)
    path = tmp_path_factory.mktemp("scan") / "scan.ply"
    write_points(path, PointCloud(normals * [1.0, 0.7, 0.5], normals / [1.0, 0.7, 0.5]))
    return path


@pytest.fixture(scope="module")
def whole(scan: Path) -> bytes:
    output = scan.with_name("whole.ply")
    run_job(JobSettings(scan, str(output), grid=64), SILENT)
    return output.read_bytes()


class Commands:
    """Real commands that share ``room`` and a folder for temporary files."""

    def __init__(self, folder: Path, scan: Path) -> None:
        self.folder, self.room, self.temporary = folder, folder / "room", folder / "temporary"
        self.temporary.mkdir()
        self.scan = scan
        self.started: list[subprocess.Popen[str]] = []

    def start(
        self, output: str, *options: str, program: tuple[str, ...] = ("-m", "hpcapp")
    ) -> subprocess.Popen[str]:
        command = [
            sys.executable, *program, "reconstruct", str(self.scan),
            "-o", str(self.folder / output), *OPTIONS, "--temp-dir", str(self.room), *options,
        ]  # fmt: skip
        process = subprocess.Popen(
            command, cwd=self.folder, env={**os.environ, "TMPDIR": str(self.temporary)},
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        self.started.append(process)
        return process

    def pause(self, output: str, *options: str) -> subprocess.Popen[str]:
        """Start one that waits, after its first tile, for a line."""
        process = self.start(output, *options, program=("-c", PAUSED))
        assert process.stdout is not None
        assert process.stdout.readline() == "paused\n", process.communicate()[1]
        return process

    def run(self, output: str, *options: str) -> str:
        process = self.start(output, *options)
        told = process.communicate()[1]
        assert process.returncode == 0, told
        return told

    def left(self) -> list[Path]:
        """Return what lies in the room and in the folder for temporary files."""
        return [path for place in (self.room, self.temporary) for path in place.rglob("*")]


@pytest.fixture
def commands(tmp_path: Path, scan: Path) -> Iterator[Commands]:
    made = Commands(tmp_path, scan)
    yield made
    for process in made.started:
        process.kill()
        process.communicate()


@pytest.mark.slow
def test_two_jobs_of_one_input_have_a_folder_each(commands: Commands, whole: bytes) -> None:
    first = commands.pause("first.ply")
    told = commands.run("second.ply")
    assert re.search(rf"@.*, process {first.pid} \(.*\) has the same job in {commands.room}", told)
    told = first.communicate("go on\n")[1]
    assert first.returncode == 0, told
    for name in ("first.ply", "second.ply"):
        assert (commands.folder / name).read_bytes() == whole
    assert commands.left() == []


@pytest.mark.slow
def test_to_resume_a_job_that_runs_waits_for_it_and_goes_on(
    commands: Commands, whole: bytes
) -> None:
    first = commands.pause("first.ply", "--resume")
    second = commands.start("second.ply", "--resume")
    assert second.stderr is not None
    assert re.match(rf"waiting for .*@.*, process {first.pid} \(", second.stderr.readline())
    kept = _tiles(commands.room)
    first.kill()
    first.communicate()
    told = second.communicate()[1]
    assert second.returncode == 0, told
    assert kept
    assert (commands.folder / "second.ply").read_bytes() == whole
    assert list(commands.room.iterdir()) == []


@pytest.mark.slow
def test_a_job_that_was_waited_for_in_vain_is_done_again(commands: Commands, whole: bytes) -> None:
    first = commands.pause("first.ply")
    second = commands.start("second.ply", "--resume")
    assert second.stderr is not None
    assert second.stderr.readline().startswith("waiting for ")
    first.communicate("go on\n")
    told = second.communicate()[1]
    assert second.returncode == 0, told
    for name in ("first.ply", "second.ply"):
        assert (commands.folder / name).read_bytes() == whole
    assert commands.left() == []


@pytest.mark.slow
def test_who_waits_can_be_interrupted(commands: Commands) -> None:
    commands.pause("first.ply")
    second = commands.start("second.ply", "--resume")
    assert second.stderr is not None
    assert second.stderr.readline().startswith("waiting for ")
    second.send_signal(signal.SIGINT)
    second.communicate()
    assert second.returncode == 130


@pytest.mark.slow
def test_nobody_else_may_look_into_what_lies_there(commands: Commands) -> None:
    """Whatever the umask says: the paused command has none."""
    commands.pause("mesh.ply")
    left = commands.left()
    assert any(path.name == "connection.json" for path in left)
    assert any(path.name.startswith(".owner") for path in left)
    assert _tiles(commands.room)
    wrong = [path for path in left if path.stat().st_mode & 0o077]
    assert [path for path in wrong if _is_open(path, commands)] == []


def _is_open(path: Path, commands: Commands) -> bool:
    """Tell whether others come as far as a path."""
    return all(
        above.stat().st_mode & 0o001
        for above in path.parents
        if above.is_relative_to(commands.folder) and above != commands.folder
    )


@pytest.mark.slow
def test_what_a_killed_command_leaves_the_next_one_removes(
    commands: Commands, whole: bytes
) -> None:
    first, neighbour = commands.pause("first.ply"), commands.pause("neighbour.ply")
    living = {path: _pid(path) for path in commands.temporary.iterdir()}
    first.kill()
    first.wait()
    assert len(living) == 2
    done = subprocess.run(
        [sys.executable, "-P", "-m", "hpcapp", "info", str(commands.scan)],
        env={**os.environ, "TMPDIR": str(commands.temporary)}, capture_output=True, check=True,
    )  # fmt: skip
    assert done.stdout
    assert [_pid(path) for path in commands.temporary.iterdir()] == [neighbour.pid]
    told = commands.run("third.ply")  # the killed one's points go, too
    assert f"process {neighbour.pid} " in told
    neighbour.communicate("go on\n")
    assert neighbour.returncode == 0
    assert commands.left() == []
    assert (commands.folder / "neighbour.ply").read_bytes() == whole


def _pid(folder: Path) -> int:
    owner = read_owner(folder)
    assert owner is not None
    return owner.pid


@pytest.mark.slow
@pytest.mark.parametrize(
    ("end", "resumes"),
    [("fail", False), ("fail", True), ("interrupt", True), ("terminate", False)],
)
def test_a_job_that_fails_leaves_only_what_it_was_asked_to_keep(
    commands: Commands, whole: bytes, end: str, resumes: bool
) -> None:
    paused = commands.pause("mesh.ply", *["--resume"] * resumes)
    if end != "fail":
        paused.send_signal(signal.SIGINT if end == "interrupt" else signal.SIGTERM)
    told = paused.communicate("fail\n" if end == "fail" else None)[1]
    assert paused.returncode == (1 if end == "fail" else 130), told
    if not resumes:
        assert "what was finished is removed" in told
        assert commands.left() == []
        return
    assert f"is kept in {commands.room}" in told
    assert "with --resume goes on from there" in told
    kept = _tiles(commands.room)
    assert kept
    told = commands.run("mesh.ply", "--resume")
    assert "warning" not in told
    assert (commands.folder / "mesh.ply").read_bytes() == whole
    assert commands.left() == []


@pytest.mark.slow
@pytest.mark.leaks_allowed  # Dask keeps a thread
def test_a_job_that_fails_early_leaves_nothing(scan: Path, tmp_path: Path) -> None:
    place = tmp_path / "room"
    common: dict[str, Any] = {"grid": 64, "temp_dir": str(place), "resume": True}
    bad = tmp_path / "bad.ply"
    bad.write_bytes(scan.read_bytes()[:-7])
    for error, settings in (
        (InputError, JobSettings(bad, str(tmp_path / "mesh.ply"), **common)),
        (
            NoWorkersError,
            JobSettings(
                scan, str(tmp_path / "mesh.ply"), backend="dask=tcp://127.0.0.1:9", **common
            ),
        ),
    ):
        with pytest.raises(error):
            run_job(settings, SILENT)
        assert list(place.rglob("*")) == []


@pytest.fixture(scope="module")
def kept(scan: Path, whole: bytes) -> Path:
    """The folder of a job that failed at its last tile; its points lie there."""
    place = scan.with_name("kept")
    with pytest.MonkeyPatch.context() as patch:
        _let_tiles_be_small(patch)
        made = _count_tiles(patch)
        run_job(_settings(scan, place), SILENT)
        assert len(made) > 2
        _count_tiles(patch, fail_at=len(made))
        with pytest.raises(JobError, match="the power is gone"):
            run_job(_settings(scan, place), SILENT)
    assert len(_tiles(place)) == len(made) - 1
    return place


def _settings(scan: Path, place: Path) -> JobSettings:
    output = str(place.with_name("mesh.ply"))
    return JobSettings(scan, output, grid=64, backend="serial", temp_dir=str(place), resume=True)


def _let_tiles_be_small(patch: pytest.MonkeyPatch) -> None:
    leave_little_memory(patch, 5_000)


def _count_tiles(patch: pytest.MonkeyPatch, fail_at: int | None = None) -> list[int]:
    """Count the tiles that are made, and fail at one of them."""
    made: list[int] = []

    def mesh_tile(*arguments: object) -> object:
        if len(made) + 1 == fail_at:
            raise JobError("the power is gone")
        made.append(1)
        return region.mesh_tile(*arguments)  # type: ignore[arg-type]

    patch.setattr(all_tiles, "mesh_tile", mesh_tile)
    return made


def _tiles(place: Path) -> list[Path]:
    return [path for path in place.glob("*/*") if re.fullmatch("[0-9a-f]{32}", path.name)]


def _cut(path: Path, chance: random.Random) -> None:
    os.truncate(path, chance.randrange(path.stat().st_size))


def _flip(path: Path, chance: random.Random) -> None:
    content = bytearray(path.read_bytes())
    for _ in range(chance.choice([1, 1, 100])):
        content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
    path.write_bytes(content)


def _empty(path: Path, _chance: random.Random) -> None:
    path.write_bytes(b"")


def _make_folder(path: Path, _chance: random.Random) -> None:
    path.unlink()
    (path / "inner").mkdir(parents=True)
    (path / "inner" / "file").write_bytes(b"in the way")


def _make_pipe(path: Path, _chance: random.Random) -> None:
    path.unlink()
    os.mkfifo(path)


def _make_loop(path: Path, _chance: random.Random) -> None:
    path.unlink()
    path.symlink_to(path)


def _make_junk(path: Path, chance: random.Random) -> None:
    path.write_bytes(chance.randbytes(path.stat().st_size))


DAMAGES = [_cut, _flip, _empty, _make_folder, _make_pipe, _make_loop, _make_junk]
KINDS: dict[str, Callable[[Path], Iterable[Path]]] = {
    "tile": lambda place: _tiles(place),
    "note": lambda place: list(place.glob("*/points/loaded")),
    "index": lambda place: [
        max(place.glob("*/points/*/index"), key=lambda at: at.stat().st_mtime_ns)
    ],
    "block file": lambda place: list(place.glob("*/points/*/points.*")),
    "lock": lambda place: list(place.glob("*/.owner")),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "damage"),
    [(kind, damage) for n, kind in enumerate(KINDS) for damage in DAMAGES[n % 2 :: 2]],
)
def test_what_is_damaged_is_made_again(
    kind: str,
    damage: Callable[[Path, random.Random], None],
    scan: Path,
    whole: bytes,
    kept: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    place = tmp_path / "room"
    shutil.copytree(kept, place)
    chance = random.Random(f"{kind} {damage.__name__}")  # noqa: S311 - to be repeated
    found = sorted(KINDS[kind](place))
    victim = chance.choice(found)
    damage(victim, chance)
    _let_tiles_be_small(monkeypatch)
    made = _count_tiles(monkeypatch)
    run_job(_settings(scan, place), SILENT)
    assert place.with_name("mesh.ply").read_bytes() == whole
    warnings = [
        r.message for r in caplog.records if "made again" in r.message or "read again" in r.message
    ]
    if kind == "lock":
        assert warnings == []
    else:
        assert len(warnings) == 1
        assert str(victim) in warnings[0]
    assert len(made) == (2 if kind == "tile" else 1)
    assert list(place.iterdir()) == []


@pytest.mark.parametrize("kind", ["tile", "block file"])
def test_what_took_the_place_of_another_is_found_out(
    kind: str,
    scan: Path,
    whole: bytes,
    kept: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    place = tmp_path / "room"
    shutil.copytree(kept, place)
    first, second, *_ = sorted(KINDS[kind](place))
    shutil.copy(first, second)
    _let_tiles_be_small(monkeypatch)
    run_job(_settings(scan, place), SILENT)
    assert place.with_name("mesh.ply").read_bytes() == whole
    assert f"warning: {second} is cut or changed" in caplog.text


def test_folders_in_the_way_are_no_obstacle(
    scan: Path,
    whole: bytes,
    kept: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """Every folder of the job becomes a file."""
    _let_tiles_be_small(monkeypatch)
    for name in ("points", "sums", "points/*"):
        place = tmp_path / name.replace("/*", "-inner") / "room"
        shutil.copytree(kept, place)
        for folder in place.glob(f"*/{name}"):
            if folder.is_dir():
                shutil.rmtree(folder)
                folder.write_bytes(b"no folder")
        run_job(_settings(scan, place), SILENT)
        assert place.with_name("mesh.ply").read_bytes() == whole
        assert list(place.iterdir()) == []
        assert ("the points are read again" in caplog.text) == (name != "sums")
        caplog.clear()


def test_different_inputs_in_one_folder_do_not_touch_each_other(
    scan: Path, kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "room"
    shutil.copytree(kept, place)
    before = set(place.rglob("*"))
    other = tmp_path / "other.ply"
    shutil.copy(scan, other)
    _let_tiles_be_small(monkeypatch)
    run_job(_settings(other, place), SILENT)
    assert set(place.rglob("*")) == before


def test_whatever_decides_the_mesh_is_part_of_the_name_of_a_job(scan: Path, tmp_path: Path) -> None:
    settings = replace(_settings(scan, tmp_path / "room"), inputs=(scan,))
    few = tmp_path / "few.ply"
    write_points(few, PointCloud(np.eye(3), np.eye(3)))
    others: list[dict[str, Any]] = [
        {"grid": 65}, {"normals": "estimate"}, {"viewpoint": ((1.0, 2.0, 3.0),)},
        {"denoise": True}, {"points": few},
    ]  # fmt: skip
    found = []
    for other in [{}, *others, {"backend": "threads", "workers": 2}]:
        with storage.open_storage(replace(settings, **other), Place.MEMORY) as opened:
            assert opened.checkpoint is not None
            found.append(opened.checkpoint.job.rpartition("-")[0])
    assert len(set(found)) == 1 + len(others)
    assert found[0] == found[-1]


def test_without_a_folder_a_job_has_a_temporary_one(
    scan: Path, whole: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tiles and points lie there while it runs; workers elsewhere do not see it."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    settings = replace(_settings(scan, tmp_path / "room"), temp_dir=None, resume=False)
    for backend in ("serial", "loky:ProcessPoolExecutor"):
        with storage.open_storage(replace(settings, backend=backend), Place.DISK) as opened:
            [near] = (tmp_path / "temporary").iterdir()
            assert opened.checkpoint is not None
            assert opened.folder == near / opened.checkpoint.job / "points"
            assert opened.checkpoint.place == str(near)
            assert opened.checkpoint.is_shared == (backend == "serial")
    _let_tiles_be_small(monkeypatch)
    assert run_job(settings, SILENT)["tiles"] > 1
    assert (tmp_path / "mesh.ply").read_bytes() == whole
    assert list((tmp_path / "temporary").iterdir()) == []


@pytest.mark.slow
@pytest.mark.leaks_allowed  # boto3 closes its connections when it is collected
def test_jobs_of_one_input_share_a_bucket(
    scan: Path, whole: bytes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, bucket: Any
) -> None:
    """A job that failed goes on under its prefix; one that does not resume has its own."""
    _let_tiles_be_small(monkeypatch)
    settings = replace(_settings(scan, tmp_path / "room"), temp_dir="s3://lab/tiles")
    _count_tiles(monkeypatch, fail_at=3)
    with pytest.raises(JobError, match="the power is gone"):
        run_job(settings, SILENT)
    left = {item.key for item in bucket.objects.all()}
    assert len(left) == 2
    _count_tiles(monkeypatch)
    run_job(replace(settings, resume=False, output=str(tmp_path / "other.ply")), SILENT)
    assert {item.key for item in bucket.objects.all()} == left
    victim = bucket.Object(sorted(left)[0])
    victim.put(Body=victim.get()["Body"].read()[:-1])
    made = _count_tiles(monkeypatch)
    run_job(settings, SILENT)
    assert len(made) == len(_tiles_of(scan, tmp_path, monkeypatch)) - 1  # one of two was whole
    for name in ("mesh.ply", "other.ply"):
        assert (tmp_path / name).read_bytes() == whole
    assert list(bucket.objects.all()) == []


def _tiles_of(scan: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Count the tiles of a whole job."""
    made = _count_tiles(monkeypatch)
    run_job(_settings(scan, tmp_path / "whole"), SILENT)
    return made
