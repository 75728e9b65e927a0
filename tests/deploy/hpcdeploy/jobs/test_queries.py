"""Jobs on a head that is a folder, with real loaders, runners and verbs."""

from __future__ import annotations

import json
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated import SetUp, make_cluster, make_spec

from hpccomponent.errors import CloudError, InputError, JobError, UsageError
from hpcdeploy.jobs import cluster_job
from hpcdeploy.jobs.display import JobDisplay
from hpcdeploy.jobs.queries import Jobs
from hpcdeploy.machine.local_shell import LocalShell
from hpcdeploy.providers.memory import MemoryProvider
from hpcdeploy.reconcile.converge import bring_up
from hpcdeploy.spec.job_folder import JobState, JobStatus
from hpcdeploy.spec.names import NodeName

PATIENCE_S = 60.0
OPTIONS = ("--grid", "32")
ON_WORKERS = ("--backend", "zmq")  # however little work it is


class Seen(JobDisplay):
    """Remembers what it was shown; tells the first log line that holds `word` to `on_word`."""

    def __init__(self, word: str = "", on_word: Callable[[], object] = lambda: None) -> None:
        self.lines: list[str] = []
        self.events: list[dict[str, Any]] = []
        self._word, self._on_word = word, on_word

    def show_log(self, line: str) -> None:
        self.lines.append(line)
        if self._word and self._word in line:
            self._word = ""
            self._on_word()

    def show_event(self, event: dict[str, Any]) -> None:
        self.events.append(event)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Make the cluster's folder on a head as `up` leaves it, but for the inventory."""
    folder = tmp_path / "home/hpcapp/standing"
    (folder / "venv/bin").mkdir(parents=True)
    python = folder / "venv/bin/python"
    python.write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    python.chmod(0o755)
    return folder


@pytest.fixture
def jobs(tmp_path: Path, folder: Path) -> Iterator[Jobs]:
    jobs = Jobs(LocalShell("head", tmp_path / "home"), "standing")
    yield jobs
    for status in jobs.all():
        jobs.cancel(status.job)


@pytest.fixture
def points(tmp_path: Path) -> Path:
    normals = np.random.default_rng(7).normal(size=(1500, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    path = tmp_path / "sphere.xyz"
    np.savetxt(path, np.hstack([normals, normals]))
    return path


def hold(folder: Path) -> subprocess.Popen[bytes]:
    """Hold the cluster as another master would, so that jobs run and get no further."""
    code = "import sys\nfrom hpccomponent.inventory import hold_cluster\n"
    code += "with hold_cluster(sys.argv[1], print):\n  print(flush=True); sys.stdin.read()"
    holder = subprocess.Popen(
        [sys.executable, "-P", "-c", code, str(folder / "inventory.json")],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert holder.stdout is not None
    holder.stdout.readline()
    return holder


@pytest.fixture
def held(folder: Path, standing_cluster: Callable[..., Any]) -> Iterator[subprocess.Popen[bytes]]:
    """A cluster without workers, that another program holds."""
    standing_cluster(folder, running=0)
    with hold(folder) as holder:
        yield holder


WAITING = "waiting for the cluster's present job"


def test_a_job_gives_the_bytes_of_a_local_run(
    jobs: Jobs, folder: Path, points: Path, tmp_path: Path, standing_cluster: Callable[..., Any]
) -> None:
    standing_cluster(folder)
    status = jobs.submit("reconstruct", points, "mesh.ply", (*OPTIONS, *ON_WORKERS))
    assert (status.job, status.title) == ("1", "sphere.xyz")
    seen = Seen()
    status = jobs.follow("1", seen)
    assert (status.state, status.exit_code) == (JobState.DONE, 0), seen.lines
    assert any("2 of 2 workers" in line for line in seen.lines)
    assert {"stage": "write", "done": 0, "total": 0} in seen.events
    report = jobs.fetch(status, tmp_path / "mesh.ply")
    assert report["watertight"] is True
    subprocess.run(
        [sys.executable, "-P", "-m", "hpcapp", "reconstruct", points, "-o", "local.ply", *OPTIONS],
        cwd=tmp_path,
        check=True,
        capture_output=True,
    )
    assert (tmp_path / "mesh.ply").read_bytes() == (tmp_path / "local.ply").read_bytes()
    assert jobs.log("1") == seen.lines
    again = jobs.submit("reconstruct", points, "mesh.ply", ("--grid", "20", *ON_WORKERS))
    assert jobs.follow(again.job, Seen()).state is JobState.DONE
    assert len(list((folder / "points").iterdir())) == 1


def test_nobody_else_may_read_what_a_job_leaves(
    jobs: Jobs, folder: Path, points: Path, held: subprocess.Popen[bytes]
) -> None:
    jobs.submit("reconstruct", points, "mesh.ply", ON_WORKERS)
    for path in [folder / "points", folder / "jobs", folder / "jobs/1/job.json"]:
        assert path.stat().st_mode & 0o077 == 0


def test_a_job_that_fails_says_why_with_the_exit_code_of_its_verb(
    jobs: Jobs, folder: Path, points: Path, tmp_path: Path, standing_cluster: Callable[..., Any]
) -> None:
    standing_cluster(folder, running=0)
    nothing = tmp_path / "nothing.xyz"
    nothing.write_text("")
    for path, options, kind in (
        (points, ("--no-such-option",), UsageError),
        (nothing, (), InputError),
    ):
        status = jobs.submit("reconstruct", path, "mesh.ply", options)
        status = jobs.follow(status.job, Seen())
        assert status.state is JobState.FAILED
        with pytest.raises(kind, match=f"job {status.job} failed: "):
            jobs.fetch(status, tmp_path / "mesh.ply")
    assert not (tmp_path / "mesh.ply").exists()


def test_jobs_run_one_after_the_other_in_their_order(
    jobs: Jobs, folder: Path, points: Path, held: subprocess.Popen[bytes]
) -> None:
    for _ in range(3):
        jobs.submit("reconstruct", points, "mesh.ply", ON_WORKERS)
    seen = Seen(WAITING, lambda: jobs.cancel("1"))
    assert jobs.follow("1", seen).state is JobState.CANCELLED
    jobs.cancel("3")
    seen = Seen(WAITING, lambda: jobs.cancel("2"))
    status = jobs.follow("2", seen)
    assert seen.lines[0] == "waiting for job 1"
    assert (status.state, status.exit_code) == (JobState.CANCELLED, 130)
    assert [job.state for job in jobs.all()] == [JobState.CANCELLED] * 3
    assert jobs.all()[2].started == ""


def test_a_cancelled_job_leaves_no_process_and_no_mesh(
    jobs: Jobs, folder: Path, points: Path, held: subprocess.Popen[bytes], tmp_path: Path
) -> None:
    jobs.submit("reconstruct", points, "mesh.ply", ON_WORKERS)
    seen = Seen(WAITING, lambda: jobs.cancel("1"))
    status = jobs.follow("1", seen)
    assert not list((folder / "jobs/1").glob("*mesh*"))
    with pytest.raises(JobError, match="job 1 was cancelled"):
        jobs.fetch(status, tmp_path / "mesh.ply")
    assert members(status.runner) == []
    assert jobs.cancel("1") == status  # once more does nothing


def members(group: int) -> list[int]:
    """Return the living processes of a process group."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, number = path.read_text().rpartition(")")[2].split()[:3]
        except (FileNotFoundError, ProcessLookupError):
            continue
        if int(number) == group and state != "Z":
            found.append(int(path.parent.name))
    return found


@pytest.mark.slow
def test_a_frozen_job_can_be_cancelled(
    jobs: Jobs, points: Path, held: subprocess.Popen[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    jobs.submit("reconstruct", points, "mesh.ply", ON_WORKERS)
    runner: list[int] = []

    def freeze_and_cancel() -> None:
        runner.append(jobs.find("1").runner)
        for pid in members(runner[0]):
            if pid != runner[0]:
                os.kill(pid, signal.SIGSTOP)
        jobs.cancel("1")

    assert jobs.follow("1", Seen(WAITING, freeze_and_cancel)).state is JobState.CANCELLED
    assert members(runner[0]) == []


def test_a_killed_runner_takes_its_verb_along_and_the_status_says_so(
    jobs: Jobs, folder: Path, points: Path, held: subprocess.Popen[bytes]
) -> None:
    jobs.submit("reconstruct", points, "mesh.ply", ON_WORKERS)
    jobs.submit("reconstruct", points, "mesh.ply", ON_WORKERS)

    def kill() -> None:
        os.kill(jobs.find("1").runner, signal.SIGKILL)

    status = jobs.follow("1", Seen(WAITING, kill))
    assert (status.state, status.exit_code) == (JobState.FAILED, 1)
    assert "its runner was killed" in status.reason
    assert members(status.runner) == []
    seen = Seen(WAITING, lambda: jobs.cancel("2"))  # the next one has its turn
    assert jobs.follow("2", seen).state is JobState.CANCELLED


def test_a_job_outlives_the_client_that_follows_it(
    jobs: Jobs, folder: Path, points: Path, held: subprocess.Popen[bytes]
) -> None:
    jobs.submit("reconstruct", points, "mesh.ply", ON_WORKERS)
    command = [sys.executable, "-P", "-m", "hpcdeploy.jobs.runner", "--folder", str(folder)]
    client = subprocess.Popen([*command, "follow", "1"], stdout=subprocess.PIPE, text=True)
    assert client.stdout is not None
    with client.stdout as output:
        assert any(WAITING in line for line in output)
    assert client.wait(PATIENCE_S) == 0  # the connection is gone, and it goes too
    assert jobs.find("1").state is JobState.RUNNING
    seen = Seen(WAITING, lambda: jobs.cancel("1"))  # another client sees all from the beginning
    assert jobs.follow("1", seen).state is JobState.CANCELLED


def test_what_is_not_there_is_named(jobs: Jobs, tmp_path: Path, folder: Path) -> None:
    with pytest.raises(UsageError, match="no job was submitted yet"):
        jobs.find(None)
    with pytest.raises(InputError, match=r"missing\.ply: cannot be read"):
        jobs.submit("reconstruct", tmp_path / "missing.ply", "mesh.ply")
    for ask in (jobs.cancel, jobs.log):
        with pytest.raises(UsageError, match="there is no job '7'"):
            ask("7")
    with pytest.raises(CloudError, match=r"job 7 cannot be followed .*there is no job '7'"):
        jobs.follow("7", Seen())


def test_a_head_that_was_not_set_up_is_named(tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()
    with pytest.raises(CloudError, match=r"head: .*not found"):
        Jobs(LocalShell("head", tmp_path / "home"), "standing").all()


def test_a_status_of_a_later_release_is_read() -> None:
    status = JobStatus("1", JobState.DONE, mesh="mesh.ply")
    assert JobStatus.from_json(json.dumps(json.loads(status.to_json()) | {"new": 1})) == status


def test_an_unfinished_job_cannot_be_fetched(
    jobs: Jobs, points: Path, held: subprocess.Popen[bytes], tmp_path: Path
) -> None:
    status = jobs.submit("reconstruct", points, "mesh.ply", ON_WORKERS)
    with pytest.raises(JobError, match="hpcapp attach"):
        jobs.fetch(status, tmp_path / "mesh.ply")


def test_a_worker_that_vanishes_is_replaced_while_somebody_watches(
    jobs: Jobs,
    points: Path,
    held: subprocess.Popen[bytes],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setattr(cluster_job, "LOOK_S", 0.05)
    set_up = SetUp()
    monkeypatch.setattr("hpcdeploy.machine.bootstrap.set_up", set_up)
    monkeypatch.setattr("hpcdeploy.machine.user_data.user_data", lambda *about: f"#!{about}")
    cloud = MemoryProvider()
    cluster = make_cluster(make_spec(2), cloud)
    bring_up(cluster, lambda _: None)
    status = jobs.submit("reconstruct", points, "mesh.ply", ON_WORKERS)
    set_up.during = lambda: jobs.cancel(status.job)

    def interrupt(record: logging.LogRecord) -> bool:
        if WAITING in record.getMessage():
            cloud.interrupt("worker-1")
        return True

    with caplog.at_level("INFO", "hpcapp"):
        caplog.handler.addFilter(interrupt)
        status = cluster_job.watch(cluster, jobs, status)
        caplog.handler.removeFilter(interrupt)
    assert status.state is JobState.CANCELLED  # so the job was still watched when it came
    names = {machine.name for machine in cluster.machines()}
    assert names == {NodeName("head"), NodeName("worker-1", 2), NodeName("worker-2")}
    assert "worker-1" in set_up.calls[-1]
