"""Executors that are handed in: used, and left open."""

from __future__ import annotations

import os
import signal
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

import hpcapp
from hpcapp.backends.processes import open_processes
from hpcapp.backends.selection import open_backend, open_executor
from hpcapp.backends.serial import SerialExecutor
from hpcapp.workforce import map_batches
from hpccomponent.errors import UsageError, WorkerLostError
from hpccomponent.surface.types.points import PointCloud


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
