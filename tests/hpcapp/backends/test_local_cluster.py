"""The local emulation with real processes: each layer killed, and nothing outlives the master."""

from __future__ import annotations

import errno
import os
import re
import select
import signal
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest
from contract_tasks import wait_for_file

from hpcapp.backends import local_cluster
from hpcapp.backends.local_cluster import LocalCluster, LocalMachines
from hpcapp.communicator.executor import CommunicatorExecutor
from hpccomponent.errors import NoWorkersError, UsageError

pytestmark = pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="watches processes by pidfd")

PATIENCE_S = 10.0
TASKS = """
import os, pathlib, signal, time

def wait_for(files):
    while not files():
        time.sleep(0.005)  # between two looks, in the worker; no event crosses

def add(a, b):
    return a + b

def add_later(folder, a, b):
    pathlib.Path(folder, str(os.getpid())).touch()
    wait_for(pathlib.Path(folder, "released").exists)
    return a + b

def family(folder, count):  # each worker has one of these tasks, and waits for the others
    pathlib.Path(folder, str(os.getpid())).touch()
    wait_for(lambda: len(os.listdir(folder)) >= count)
    return [os.getpid(), os.getppid()]

def hang(path):
    open(path, "w").close()
    signal.pause()
"""
NAMES = [f"cluster.{name}=cluster_tasks:{name}" for name in ("add", "add_later", "family", "hang")]


@pytest.fixture(autouse=True)
def task_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "cluster_tasks.py").write_text(TASKS)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Give the folder for temporary files, and see that nothing is left in it."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    yield folder
    assert list(folder.iterdir()) == []


def is_alive(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"  # a zombie is gone, only not yet collected by its new parent


def wait_gone(pids: list[int]) -> None:
    for pid in pids:
        try:
            pidfd = os.pidfd_open(pid)
        except ProcessLookupError:
            continue
        try:
            assert select.select([pidfd], [], [], PATIENCE_S)[0], f"process {pid} is still there"
        finally:
            os.close(pidfd)


def family(cluster: LocalCluster, meeting: Path) -> list[tuple[int, int]]:
    """Return (worker, component) of every machine; `meeting` is a folder to be made."""
    meeting.mkdir()
    futures: list[Future[list[int]]] = [
        cluster.executor.submit("cluster.family", str(meeting), cluster.workers)
        for _ in range(cluster.workers)
    ]
    found = {(pids[0], pids[1]) for pids in (future.result() for future in futures)}
    assert len(found) == cluster.workers
    return sorted(found)


def all_pids(cluster: LocalCluster, meeting: Path) -> list[int]:
    return [*cluster.loader_pids, *(pid for pair in family(cluster, meeting) for pid in pair)]


def submit_many(cluster: LocalCluster, count: int, folder: Path) -> list[Future[int]]:
    """Submit additions that wait until there is a file ``released``."""
    folder.mkdir()
    return [cluster.executor.submit("cluster.add_later", str(folder), i, 1) for i in range(count)]


@pytest.mark.parametrize("policy", ["adaptive", "pull", "equal"])
def test_work_is_done_and_nothing_is_left(policy: str, tmp_path: Path) -> None:
    with LocalCluster(2, policy=policy, extra_tasks=NAMES) as cluster:
        futures: list[Future[object]] = [
            cluster.executor.submit("cluster.add", i, 1) for i in range(20)
        ]
        assert [future.result() for future in futures] == list(range(1, 21))
        pids = all_pids(cluster, tmp_path / "meeting")
        assert len(set(pids)) == 6
        assert all(map(is_alive, pids))
    assert not any(map(is_alive, pids))


def test_submitted_work_is_finished_when_the_block_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shut_down = CommunicatorExecutor.shutdown

    def release_and_shut_down(executor: CommunicatorExecutor, *arguments: Any, **how: Any) -> None:
        (tmp_path / "work" / "released").touch()
        shut_down(executor, *arguments, **how)

    monkeypatch.setattr(CommunicatorExecutor, "shutdown", release_and_shut_down)
    with LocalCluster(1, extra_tasks=NAMES) as cluster:
        futures = submit_many(cluster, 10, tmp_path / "work")
    assert [future.result(0) for future in futures] == list(range(1, 11))


def test_secrets_are_readable_by_their_owner_only(folder: Path) -> None:
    with LocalCluster(1, extra_tasks=NAMES):
        [top] = folder.iterdir()
        assert stat.S_IMODE(top.stat().st_mode) == 0o700
        [connection] = top.rglob("connection.json")
        assert stat.S_IMODE(connection.stat().st_mode) == 0o600


@pytest.mark.slow
@pytest.mark.parametrize("layer", ["worker", "component", "loader"])
def test_the_job_outlives_the_loss_of_any_process(layer: str, tmp_path: Path) -> None:
    with LocalCluster(2, extra_tasks=NAMES) as cluster:
        [(worker, component), (other, _)] = family(cluster, tmp_path / "meeting")
        victim = {"worker": worker, "component": component, "loader": cluster.loader_pids[0]}[layer]
        futures = submit_many(cluster, 40, tmp_path / "work")
        for pid in (worker, other):
            wait_for_file(str(tmp_path / "work" / str(pid)))
        os.kill(victim, signal.SIGKILL)
        (tmp_path / "work" / "released").touch()
        assert [future.result() for future in futures] == list(range(1, 41))


def test_a_killed_loader_takes_its_component_and_worker_along(tmp_path: Path) -> None:
    with LocalCluster(1, extra_tasks=NAMES) as cluster:
        pids = all_pids(cluster, tmp_path / "meeting")
        os.kill(cluster.loader_pids[0], signal.SIGKILL)
        wait_gone(pids)


def test_a_killed_component_is_replaced(tmp_path: Path) -> None:
    with LocalCluster(1, extra_tasks=NAMES) as cluster:
        [(worker, component)] = family(cluster, tmp_path / "first")
        os.kill(component, signal.SIGKILL)
        [(other_worker, other_component)] = family(cluster, tmp_path / "second")
        assert {worker, component}.isdisjoint({other_worker, other_component})
        wait_gone([worker, component])


def test_the_job_ends_when_all_loaders_are_killed(tmp_path: Path) -> None:
    with LocalCluster(2, extra_tasks=NAMES) as cluster:
        futures: list[Future[object]] = [
            cluster.executor.submit("cluster.hang", str(tmp_path / "x")) for _ in range(3)
        ]
        for pid in cluster.loader_pids:
            os.kill(pid, signal.SIGKILL)
        for future in futures:
            with pytest.raises(NoWorkersError):
                future.result(PATIENCE_S)


def fail_at_work(error: BaseException, path: Path, pids: list[int]) -> None:
    """Raise in the block while every worker is busy and more is waiting."""
    with LocalCluster(2, extra_tasks=NAMES) as cluster:
        pids += all_pids(cluster, path.with_name("meeting"))
        for _ in range(9):
            cluster.executor.submit("cluster.hang", str(path))
        raise error


@pytest.mark.parametrize("error", [ValueError("mine"), KeyboardInterrupt()])
def test_an_exception_cuts_running_work_off(tmp_path: Path, error: BaseException) -> None:
    pids: list[int] = []
    with pytest.raises(type(error)):
        fail_at_work(error, tmp_path / "x", pids)
    assert len(pids) == 6
    assert not any(map(is_alive, pids))


def test_an_interrupt_while_it_starts_leaves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(CommunicatorExecutor, "wait_for_workers", interrupt)
    cluster = LocalCluster(2, extra_tasks=NAMES)
    with pytest.raises(KeyboardInterrupt), cluster:
        pass
    assert len(cluster.loader_pids) == 2
    assert not any(map(is_alive, cluster.loader_pids))


def end_with_work_running(path: Path, pids: list[int]) -> None:
    """Leave the block by its end, and have an interrupt come while that waits for the work."""
    with LocalCluster(1, extra_tasks=NAMES) as cluster:
        pids += all_pids(cluster, path.with_name("meeting"))
        cluster.executor.submit("cluster.hang", str(path))
        signal.setitimer(signal.ITIMER_REAL, 0.3)


def test_an_interrupt_while_it_waits_for_work_to_end_leaves_nothing(tmp_path: Path) -> None:
    pids: list[int] = []
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    try:
        with pytest.raises(KeyboardInterrupt):
            end_with_work_running(tmp_path / "x", pids)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert len(pids) == 3
    assert not any(map(is_alive, pids))


@pytest.mark.slow
@pytest.mark.parametrize("layer", ["worker", "component", "loader"])
def test_a_frozen_process_does_not_hold_up_the_end(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, layer: str
) -> None:
    monkeypatch.setattr(local_cluster, "_LEAVE_S", 2.0)
    with LocalCluster(1, extra_tasks=NAMES) as cluster:
        pids = all_pids(cluster, tmp_path / "meeting")
        os.kill(pids[["loader", "worker", "component"].index(layer)], signal.SIGSTOP)
    wait_gone(pids)  # a worker whose component was killed goes by itself


def test_loaders_that_end_at_once_are_quoted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "python"
    program.write_text("#!/bin/sh\necho no loader today >&2; exit 3\n")
    program.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(program))
    with pytest.raises(NoWorkersError, match="no loader today"), LocalCluster(2):
        pass


def test_a_loader_that_cannot_be_found_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/no/such/python")
    with pytest.raises(NoWorkersError, match="/no/such/python"), LocalCluster(2):
        pass


def test_a_loader_for_which_the_system_has_no_room_is_one_less(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    start = subprocess.Popen
    started: list[subprocess.Popen[bytes]] = []

    def start_two(*arguments: Any, **settings: Any) -> subprocess.Popen[bytes]:
        if len(started) == 2:
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        started.append(start(*arguments, **settings))
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", start_two)
    with LocalCluster(4, extra_tasks=NAMES) as cluster:
        assert cluster.workers == len(cluster.loader_pids) == 2
        assert cluster.executor.submit("cluster.add", 1, 1).result() == 2
    assert "2 of 4: no loader can be started" in caplog.text


def test_more_than_this_machine_carries_is_refused_before_anything_is_started() -> None:
    with pytest.raises(UsageError, match="workers=1000000: this machine carries "):
        LocalCluster(1_000_000)


def test_machines_that_were_started_early_wait_and_end_with_the_cluster(tmp_path: Path) -> None:
    with LocalMachines(2, NAMES) as machines:
        with LocalCluster(machines) as cluster:
            pids = all_pids(cluster, tmp_path / "meeting")
            assert cluster.loader_pids == machines.loader_pids
            assert len(set(pids)) == 6
        assert not any(map(is_alive, pids))


def test_machines_for_which_no_cluster_comes_leave() -> None:
    with LocalMachines(2, NAMES) as machines:
        pids = machines.loader_pids
        assert len(pids) == 2
    assert not any(map(is_alive, pids))


def test_a_loader_that_ended_before_anybody_answered_is_told_of() -> None:
    with LocalMachines(1, NAMES) as machines:
        os.kill(machines.loader_pids[0], signal.SIGKILL)
        wait_gone(machines.loader_pids)
        with (
            pytest.raises(NoWorkersError, match="no loader is left: machine-0 ended by signal 9"),
            LocalCluster(machines),
        ):
            pass


@pytest.mark.parametrize(("workers", "policy"), [(0, "pull"), (-1, "pull"), (2, "fair")])
def test_impossible_wishes_are_refused(workers: int, policy: str) -> None:
    with pytest.raises(UsageError):
        LocalCluster(workers, policy=policy)


MASTER = """
import pathlib, sys
from hpcapp.backends.local_cluster import LocalCluster

folder, *names = sys.argv[1:]
meeting = pathlib.Path(folder, "meeting")
meeting.mkdir()
with LocalCluster(2, extra_tasks=names) as cluster:
    pairs = [cluster.executor.submit("cluster.family", str(meeting), 2) for _ in range(2)]
    known = [*cluster.loader_pids, *(pid for pair in pairs for pid in pair.result())]
    futures = [cluster.executor.submit("cluster.hang", f"{folder}/hangs") for _ in range(4)]
    print("ready", *known, flush=True)
    futures[0].result()
"""


@pytest.fixture
def master(tmp_path: Path) -> Iterator[subprocess.Popen[str]]:
    """Start a master with a session of its own, as a terminal would."""
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", MASTER, str(tmp_path), *NAMES],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=environment,
    )
    yield process
    process.kill()
    process.communicate()


def ready_pids(master: subprocess.Popen[str]) -> list[int]:
    assert master.stdout is not None
    line = master.stdout.readline()
    assert re.fullmatch(r"ready( \d+){6}\n", line), line
    return [int(word) for word in line.split()[1:]]


def test_nothing_outlives_a_killed_master(master: subprocess.Popen[str]) -> None:
    pids = ready_pids(master)
    master.kill()
    wait_gone(pids)


def test_ctrl_c_ends_everything_in_order(master: subprocess.Popen[str], tmp_path: Path) -> None:
    pids = ready_pids(master)
    os.killpg(master.pid, signal.SIGINT)
    _, complaint = master.communicate(timeout=PATIENCE_S)
    assert master.returncode == -signal.SIGINT
    assert complaint.rstrip().endswith("KeyboardInterrupt")
    assert not any(map(is_alive, pids))
    assert list(tmp_path.glob("hpcapp-*")) == []
