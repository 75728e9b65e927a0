from __future__ import annotations

import logging
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from little_memory import leave_little_memory
from standing import StartCluster

import hpcapp
from hpcapp.applications.surface.cli.run import run_job
from hpcapp.applications.surface.job import backend_choice
from hpcapp.applications.surface.job.backend_choice import Job, choose_backend, least_work
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.paper.settings import Paper
from hpcapp.backends.selection import open_executor
from hpcapp.io import read_points
from hpcapp.progress import Progress


@pytest.fixture
def two_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let there be two cores, wherever this runs."""
    monkeypatch.setattr(backend_choice, "available_cores", lambda: 2)


@pytest.fixture
def hopeful(monkeypatch: pytest.MonkeyPatch, two_cores: None) -> None:
    """Let any two workers pay, and wait for them as long as it takes."""
    monkeypatch.setattr(backend_choice, "WORKERS_PAY", ((2, 1),))
    monkeypatch.setattr(backend_choice, "LEAST_REMOTE", 1)
    monkeypatch.setattr(backend_choice, "WAIT_S", 60.0)


@pytest.mark.usefixtures("two_cores")
@pytest.mark.parametrize(
    ("grid", "known"), [(None, "at most {:,} points:"), (32, "at most {:,} points at grid 32:")]
)
def test_only_what_is_known_before_the_points_are_read_is_told(
    grid: int | None,
    known: str,
    sphere_file: Path,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    caplog.set_level(logging.INFO, "hpcapp")
    leave_little_memory(monkeypatch)
    settings = JobSettings(sphere_file, str(tmp_path / "mesh.ply"), grid=grid)
    report = run_job(settings, Progress())
    [told] = [line for line in caplog.messages if line.startswith("backend")]
    assert told == f"backend {report['backend']}: {report['choice']['reason']}"
    assert report["choice"]["reason"].startswith(known.format(len(read_points(sphere_file))))


@pytest.mark.usefixtures("two_cores")
def test_no_more_workers_are_started_than_fit_into_the_memory_that_may_be_had(
    sphere_file: Path, tmp_path: Path
) -> None:
    job = Job(4_000_000, 512)
    much, little = (
        choose_backend(JobSettings(sphere_file, str(tmp_path / "m.ply"), max_memory=most), job)
        for most in (2e9, 3e8)
    )
    assert (much.backend, much.workers) == ("zmq", 2)
    assert little.backend == "threads"
    assert "max_memory" in little.reason


@given(st.integers(1, 2000), st.integers(1, 2000), st.booleans())
def test_more_workers_never_need_more_work(one: int, other: int, is_remote: bool) -> None:
    few, many = sorted((one, other))
    assert least_work(many, is_remote) <= least_work(few, is_remote)
    assert least_work(few, is_remote=True) >= least_work(few)
    assert least_work(1) == float("inf")


def test_work_grows_with_points_and_with_the_grid() -> None:
    jobs = [Job(1_000, 256), Job(1_000_000, 256), Job(1_000_000, 1024), Job(10_000_000, 1024)]
    assert all(a.work < b.work for a, b in pairwise(jobs))


def run(points: Path, **options: Any) -> tuple[dict[str, Any], bytes]:
    output = points.parent / "mesh.ply"
    settings = JobSettings(points, str(output), grid=32, **options)
    return run_job(settings, Progress()), output.read_bytes()


@pytest.mark.usefixtures("two_cores")
def test_a_small_cloud_starts_nothing(sphere_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def open_and_tell(name: str, **options: Any) -> Any:
        opened.append(name)
        return open_executor(name, **options)

    opened: list[str] = []
    monkeypatch.setattr(backend_choice, "open_executor", open_and_tell)
    for workers in (None, 1, 4):
        report, _ = run(sphere_file, workers=workers)
        assert (report["backend"], report["workers"]) == ("serial", 1)
        told = report["choice"]
        assert (told["backend"], told["workers"], told["workers_asked"]) == ("serial", 1, workers)
        if workers == 1:
            assert "to be used" in told["reason"]
        else:
            assert "too little for 2 workers" in told["reason"]
    assert opened == ["serial"] * 3


def test_what_is_asked_for_is_not_chosen(sphere_file: Path) -> None:
    report, _ = run(sphere_file, backend="threads", workers=3)
    assert report["choice"] == {
        "backend": "threads", "workers": 3, "reason": "it was asked for", "workers_asked": 3,
    }  # fmt: skip
    report, _ = run(sphere_file, method=Paper(), workers=2)
    assert report["backend"] == "serial"
    assert "paper" in report["choice"]["reason"]


@pytest.mark.slow
@pytest.mark.usefixtures("hopeful")
def test_workers_that_pay_are_started(sphere_file: Path) -> None:
    _, alone = run(sphere_file, backend="serial")
    report, mesh = run(sphere_file, workers=4)
    assert (report["backend"], report["workers"]) == ("zmq", 2)  # there are no more cores
    assert mesh == alone
    cloud = read_points(sphere_file)
    assert cloud.normals is not None
    found = hpcapp.reconstruct(cloud.positions, cloud.normals, grid=32)
    again = hpcapp.reconstruct(cloud.positions, cloud.normals, grid=32, executor="serial")
    assert np.array_equal(found.vertices, again.vertices)


@pytest.mark.usefixtures("hopeful")
def test_a_clusters_workers_are_used_where_they_pay(
    sphere_file: Path, standing_cluster: StartCluster
) -> None:
    _, alone = run(sphere_file, backend="serial")
    report, mesh = run(sphere_file, cluster=standing_cluster().inventory)
    assert (report["backend"], report["workers"]) == ("cluster", 2)
    assert mesh == alone


def test_a_cluster_of_too_few_workers_is_not_waited_for(
    sphere_file: Path, standing_cluster: StartCluster
) -> None:
    report, _ = run(sphere_file, cluster=standing_cluster(running=0).inventory)
    assert (report["backend"], report["workers"]) == ("serial", 1)
    assert "too little" in report["choice"]["reason"]


@pytest.mark.usefixtures("hopeful")
def test_a_cluster_whose_workers_do_not_come_is_done_without(
    sphere_file: Path, standing_cluster: StartCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(backend_choice, "WAIT_S", 0.1)
    report, _ = run(sphere_file, cluster=standing_cluster(running=0).inventory)
    assert (report["backend"], report["workers"]) == ("serial", 1)
    assert "no worker came" in report["choice"]["reason"]
