"""What the backends promise beyond the contract of `test_executor_contract`."""

from __future__ import annotations

import os
import signal
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import hpcapp
from hpcapp.backends import BACKENDS
from hpcapp.backends.processes import open_processes
from hpcapp.backends.selection import open_backend, open_executor
from hpcapp.backends.serial import SerialExecutor
from hpcapp.geometry.points import PointCloud
from hpcapp.workforce import map_batches
from hpccomponent.errors import UsageError, WorkerLostError
from hpccomponent.limits import available_cores


@pytest.mark.parametrize(
    ("name", "workers", "policy", "words"),
    [
        ("cloud", None, "pull", "choose one of serial, threads, processes, zmq, dask=ADDRESS"),
        ("dask", None, "pull", "names no scheduler; write dask=tcp://HOST:PORT"),
        ("dask=tcp://here", None, "pull", "names no scheduler"),
        ("dask=ftp://here:1", None, "pull", "names no scheduler"),
        ("dask=tcp://127.0.0.1:1", 2, "pull", "leave workers out"),
        ("mpi", None, "pull", "start it as 'mpiexec -n 5 python -m mpi4py.futures -m hpcapp"),
        ("threads", 2, "fair", "choose one of adaptive, pull, equal"),
        ("threads", 0, "pull", "cannot have 0 workers"),
        ("serial", 2, "pull", "choose another executor"),
    ],
)
def test_what_cannot_be_opened_is_refused(
    name: str, workers: int | None, policy: str, words: str
) -> None:
    with (
        pytest.raises(UsageError, match=words),
        open_executor(name, workers=workers, policy=policy),
    ):
        pass


def open_executor_defaults() -> dict[str, int]:
    found = {}
    for name in ("serial", "threads"):
        with open_executor(name) as backend:
            found[name] = backend.workforce.workers
    return found


def test_as_many_workers_as_cores_unless_told() -> None:
    assert open_executor_defaults() == {"serial": 1, "threads": available_cores()}
    assert set(BACKENDS) == {"serial", "threads", "processes", "zmq"}


def test_equal_batches_are_one_for_each_worker() -> None:
    for policy, batches in (("equal", 2), ("pull", 8), ("adaptive", 8)):
        with open_executor("threads", workers=2, policy=policy) as backend:
            assert len(backend.workforce.cut(100)) == batches


def test_the_serial_executor_keeps_errors_in_their_futures() -> None:
    assert SerialExecutor().submit(divmod, 7, 2).result() == (3, 1)
    assert isinstance(SerialExecutor().submit(divmod, 7, 0).exception(), ZeroDivisionError)


def test_a_pool_that_has_lost_a_worker_is_opened_anew(tasks: ModuleType, tmp_path: Path) -> None:
    started, released = tmp_path / "started", tmp_path / "released"
    with open_executor("processes", workers=1) as backend:
        dying = backend.executor.submit(tasks.announce_and_wait, str(started), str(released))
        waiting = [backend.executor.submit(pow, 2, power) for power in range(8)]
        tasks.wait_for_file(str(started))
        first = int(started.read_text())
        os.kill(first, signal.SIGKILL)
        released.touch()
        assert dying.result() != first
        assert [future.result() for future in waiting] == [2**power for power in range(8)]


def test_a_task_that_kills_every_worker_is_given_up(tasks: ModuleType) -> None:
    with open_executor("processes", workers=1) as backend:
        with pytest.raises(
            WorkerLostError, match=r"kill_worker was not finished: 4 worker\(s\) died"
        ):
            map_batches(backend.workforce, tasks.kill_worker, [()])
        assert backend.executor.submit(pow, 2, 3).result() == 8


def test_processes_compute_on_one_thread() -> None:
    with open_executor("processes", workers=1) as backend:
        assert backend.executor.submit(os.getenv, "OMP_NUM_THREADS").result() == "1"


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="no signal masks here")
def test_a_pool_is_deaf_to_interrupts_and_leaves_the_masters_mask_alone() -> None:
    before = signal.pthread_sigmask(signal.SIG_BLOCK, set())
    with open_executor("processes", workers=1) as backend:
        pid = backend.executor.submit(os.getpid).result()
        os.kill(pid, signal.SIGINT)
        assert backend.executor.submit(os.getpid).result() == pid
        assert signal.pthread_sigmask(signal.SIG_BLOCK, set()) == before


def test_an_executor_is_used_and_stays_open(sphere: PointCloud) -> None:
    assert sphere.normals is not None
    alone = hpcapp.reconstruct(sphere.positions, sphere.normals, grid=32)
    with ThreadPoolExecutor(3) as pool:
        mesh = hpcapp.reconstruct(sphere.positions, sphere.normals, grid=32, executor=pool)
        assert pool.submit(pow, 2, 3).result() == 8
    assert mesh.vertices.tobytes() == alone.vertices.tobytes()
    assert mesh.faces.tobytes() == alone.faces.tobytes()


def test_it_tells_how_many_workers_it_has_or_is_told() -> None:
    with ThreadPoolExecutor(3) as pool:
        with open_backend(pool) as backend:
            assert (backend.name, backend.workforce.workers) == ("ThreadPoolExecutor", 3)
            assert backend.workforce.in_process
        with open_backend(pool, workers=7) as backend:
            assert backend.workforce.workers == 7


@pytest.mark.parametrize("name", ["serial", "processes", "zmq"])
def test_our_own_are_taken_as_they_are(name: str) -> None:
    with open_executor(name, workers=1) as backend, open_backend(backend.executor) as borrowed:
        assert borrowed.executor is backend.executor
        assert borrowed.workforce.workers == 1


@pytest.mark.parametrize("thing", [7, SerialExecutor, b"serial"])
def test_what_is_no_executor_is_refused(thing: Any) -> None:
    with (
        pytest.raises(UsageError, match="is no Executor; give a backend's name"),
        open_backend(thing),
    ):
        pass


def test_a_pool_that_breaks_is_its_owners_to_open_anew() -> None:
    with open_processes(1) as pool, open_backend(pool) as backend:
        pid = backend.executor.submit(os.getpid).result()
        with pytest.raises(WorkerLostError, match=r"1 worker\(s\) died .* open another Executor"):
            map_batches(backend.workforce, os.kill, [(pid, signal.SIGKILL)])
