"""What a job will do is told before its points are read, and is what it does."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from directions import random_directions
from little_memory import leave_little_memory

from hpcapp.applications.surface.cli.run import run_job
from hpcapp.applications.surface.job import plan
from hpcapp.applications.surface.job.plan import Place, plan_job
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.paper.settings import Paper
from hpcapp.applications.surface.resolution.memory import Together
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.io import write_mesh, write_points
from hpcapp.lab.simulate.scanner import simulate_scan
from hpcapp.lab.simulate.settings import ScanSettings
from hpcapp.lab.simulate.shapes import find_shape
from hpcapp.progress import Progress

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def scan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(plan, "FOLDER_FROM_POINTS", 1_000)
    normals = random_directions(1_500, 1)
    for suffix in (".ply", ".xyz"):
        write_points(tmp_path / f"scan{suffix}", PointCloud(normals, normals))
    return tmp_path / "scan.ply"


def find_place(scan: Path, **asked: Any) -> Place:
    return plan_job(JobSettings(scan, "mesh.ply", **asked)).place


@pytest.mark.parametrize(
    ("asked", "place"),
    [
        ({"backend": "zmq"}, Place.SHARED),
        ({"backend": "processes"}, Place.SHARED),
        ({"workers": 2}, Place.MEMORY),  # too few points to start them
        ({"workers": 1}, Place.MEMORY),
        ({"backend": "serial"}, Place.MEMORY),
        ({"backend": "threads"}, Place.MEMORY),
        ({"backend": "zmq", "denoise": True}, Place.MEMORY),
        ({"backend": "zmq", "method": Paper()}, Place.MEMORY),
        ({"backend": "loky:ProcessPoolExecutor"}, Place.MEMORY),  # who knows where they are
        ({"backend": "loky:ProcessPoolExecutor", "temp_dir": "/shared"}, Place.SHARED),
        ({"backend": "loky:ProcessPoolExecutor", "temp_dir": "s3://bucket"}, Place.MEMORY),
        ({"backend": "zmq", "cluster": Path("cluster.json")}, Place.MEMORY),
        ({"backend": "zmq", "cluster": Path("cluster.json"), "temp_dir": "/shared"}, Place.SHARED),
    ],
)
def test_points_go_where_other_processes_read_them(
    scan: Path, asked: dict[str, Any], place: Place
) -> None:
    assert find_place(scan, **asked) is place
    assert find_place(scan.with_suffix(".xyz"), **asked) is Place.MEMORY


def test_few_points_or_no_room_stay_in_memory(scan: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plan, "_BYTES_ON_DISK", 1 << 60)
    assert find_place(scan, backend="zmq") is Place.MEMORY
    monkeypatch.undo()
    assert find_place(scan, backend="zmq") is Place.MEMORY
    assert find_place(scan.with_name("none.ply"), backend="zmq") is Place.MEMORY


def test_points_that_memory_does_not_hold_lie_on_disk(
    scan: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan, "BYTES_PER_POINT", 1e6)
    settings = JobSettings(scan, "mesh.ply", max_memory=1.4e9)
    planned = plan_job(settings)
    assert planned.place is Place.DISK
    assert planned.available == 1.4e9
    assert planned.disk > 0.0
    assert find_place(scan, max_memory=1.7e9, workers=1) is Place.MEMORY


@pytest.mark.parametrize("is_little", [False, True])
def test_a_job_does_what_was_planned(
    scan: Path, monkeypatch: pytest.MonkeyPatch, is_little: bool
) -> None:
    settings = JobSettings(
        scan, str(scan.with_name("mesh.ply")), grid=48, backend="threads", workers=2, max_memory=1e9
    )
    if is_little:
        leave_little_memory(monkeypatch)
    monkeypatch.setattr(Together, "fit", lambda *_: 600)
    planned = plan_job(settings)
    assert planned.place is (Place.DISK if is_little else Place.MEMORY)
    report = run_job(settings, Progress())
    assert (report["backend"], report["workers"]) == (
        planned.choice.backend, planned.choice.workers,
    )  # fmt: skip
    assert (report["grid"], report["points"]) == (planned.job.grid, planned.job.points)
    assert report["tiles"] >= planned.tiles == 3


def test_a_plan_is_printed_and_nothing_is_done(run: Run, scan: Path) -> None:
    words = ("reconstruct", "scan.ply", "-o", "mesh.ply", "--workers", "1", "--plan")
    code, out, _ = run(*words)
    assert code == 0
    rows = dict(line.split(None, 1) for line in out.splitlines())
    assert rows.keys() == {"points", "grid", "backend", "tiles", "memory"}
    assert rows["points"] == "at most 1,500, in the memory of this process"
    assert rows["grid"].endswith("chosen when the points are measured")
    code, out, _ = run(*words, "--json", "--grid", "512")
    assert code == 0
    told = json.loads(out)
    assert (told["points"], told["grid"], told["is_grid_chosen"]) == (1_500, 512, True)
    assert told["memory"] > 1e8
    assert not (scan.parent / "mesh.ply").exists()
    code, out, _ = run(*words, "scan.xyz")
    assert code == 0
    assert int(out.split()[3].strip(",").replace(",", "")) >= 3_000


def test_workers_that_the_user_has_opened_may_read_for_themselves(scan: Path) -> None:
    settings = JobSettings(scan, "mesh.ply", temp_dir="/shared", workers=2)
    assert plan_job(settings, is_opened=True).place is Place.SHARED
    assert plan_job(settings).place is Place.MEMORY


def test_of_a_mesh_as_many_points_are_planned_as_are_taken_on_its_faces(
    run: Run, scan: Path
) -> None:
    corners = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    write_mesh(scan.with_name("part.off"), Mesh(corners, faces))
    for words, points in ((), 100_000), (("--sample", "5000"), 5_000):
        code, out, _ = run("reconstruct", "part.off", "-o", "m.ply", "--plan", "--json", *words)
        assert (code, json.loads(out)["points"]) == (0, points)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("none.ply",), 3),
        (("-",), 2),
        (("scan.ply.gz",), 2),
        (("scan.ply", "--resume"), 2),
        (("scan.ply", "--cluster", "lab.yaml"), 2),
    ],
)
@pytest.mark.usefixtures("scan")
def test_what_cannot_be_planned_is_one_line(
    run: Run, words: tuple[str, ...], expected: int
) -> None:
    for name in ("scan.ply.gz", "lab.yaml"):
        Path(name).touch()
    code, out, said = run("reconstruct", *words, "-o", "mesh.ply", "--plan")
    assert (code, out) == (expected, "")
    assert len(said.splitlines()) == 1


MEASURED = """
from hpcapp.__main__ import main
try:
    main()
finally:
    print(*(line for line in open("/proc/self/status") if line.startswith("VmHWM:")))
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="/proc tells what a process held at most")
@pytest.mark.parametrize(("points", "least", "most"), [(20_000, 0.8, 1.25), (300_000, 0.8, 1.05)])
def test_a_job_takes_about_as_much_memory_as_planned(
    tmp_path: Path, points: int, least: float, most: float
) -> None:
    scan = tmp_path / "scan.ply"
    write_points(scan, simulate_scan(find_shape("knot"), ScanSettings(points=points, noise=0.001)))
    planned = plan_job(JobSettings(scan, "mesh.ply", backend="serial")).memory
    words = ("reconstruct", str(scan), "-o", str(tmp_path / "mesh.ply"), "--backend", "serial")
    done = subprocess.run(
        [sys.executable, "-P", "-c", MEASURED, *words], capture_output=True, text=True, check=True
    )
    assert least * planned < 1024.0 * float(done.stdout.split()[1]) < most * planned
