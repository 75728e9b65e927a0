"""One contract for every backend: what an application may rely on."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from hpcapp.backends.selection import Backend, open_backend, open_executor
from hpcapp.workforce import Workforce, map_batches
from hpccomponent.errors import TaskError

NAMES = ("echo", "total", "fail", "append_line", "wait_for_file")
RunMpi = Callable[..., "subprocess.CompletedProcess[str]"]
WAIT = 60.0  # seconds, for what takes milliseconds: only a defect runs into it


UNDER_MPI = "mpi4py.futures" in sys.orig_argv
"""Whether this is the run that `test_mpi_keeps_the_contract_too` starts."""

POOL = pytest.param("processes", marks=pytest.mark.leaks_allowed)  # multiprocessing's tracker
DASK = pytest.param("dask", marks=pytest.mark.leaks_allowed)  # it pools its connections
RAY = pytest.param("ray", marks=pytest.mark.leaks_allowed)  # it runs as long as the fixture
HERE = ["serial", "threads", "processes", "zmq", DASK, RAY, "loky:ProcessPoolExecutor", "handed in"]


@pytest.fixture(scope="module", params=["mpi"] if UNDER_MPI else HERE)
def executor(
    request: pytest.FixtureRequest, tasks: ModuleType, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Executor]:
    with open_named(request, tasks) as backend:
        # Pools start their workers with the first tasks: let them, before leaks are counted.
        released = tmp_path_factory.mktemp("start") / "released"
        if request.param == "serial":
            released.touch()
        waiting = [backend.executor.submit(tasks.wait_for_file, str(released)) for _ in range(2)]
        released.touch()
        for future in waiting:
            future.result(WAIT)
        backend.executor.submit(tasks.echo, bytes(1 << 24)).result(WAIT)  # Dask's thread for them
        yield backend.executor


@contextmanager
def open_named(request: pytest.FixtureRequest, tasks: ModuleType) -> Iterator[Backend]:
    """Open the backend that is to keep the contract, with two workers where it can have them."""
    name = request.param
    if name == "handed in":
        with ThreadPoolExecutor(2) as pool, open_backend(pool) as backend:
            yield backend
        return
    if name == "ray" and find_spec("ray") is None:  # not imported: that is the backend's to do
        pytest.skip("Ray is not installed")
    workers = 2 if name in {"threads", "processes", "zmq", "ray"} else None
    extra = [f"contract.{task}={tasks.__name__}:{task}" for task in NAMES]
    if name == "dask":
        name += "=" + request.getfixturevalue("start_dask")().address
    with open_executor(name, workers=workers, extra_tasks=extra) as backend:
        yield backend


@pytest.mark.slow
def test_results_are_bitwise_equal_in_whichever_order_they_come(
    executor: Executor, tasks: ModuleType
) -> None:
    arrays = [np.random.default_rng(seed).standard_normal((500, 3)) for seed in range(20)]
    futures = {executor.submit(tasks.echo, array): array for array in arrays}
    large = np.arange(700_000.0)
    futures[executor.submit(tasks.echo, large)] = large
    done = list(as_completed(futures, timeout=WAIT))
    assert len(done) == 21
    for future in done:
        assert future.result().tobytes() == futures[future].tobytes()


def test_every_kind_of_value_travels(executor: Executor, tasks: ModuleType) -> None:
    numbers = (1, -(2**70), 0.1, True, None)
    pair = tasks.Pair("two", 2)
    values: Any
    values = (*numbers, "text", b"bytes", (1, 2), [3, "x"], {"k": (4.5,)}, pair, [(pair,)])
    received = executor.submit(tasks.echo, *values).result(WAIT)
    assert received == values
    assert [type(value) for value in received] == [type(value) for value in values]


def test_sums_have_the_same_bits_as_here(executor: Executor, tasks: ModuleType) -> None:
    values = np.random.default_rng(3).standard_normal(100_001)
    assert executor.submit(tasks.total, values).result(WAIT) == tasks.total(values)


def test_an_exception_comes_back_and_the_next_task_runs(
    executor: Executor, tasks: ModuleType
) -> None:
    failed = executor.submit(tasks.fail, "no luck")
    with pytest.raises((ValueError, TaskError), match="no luck"):
        failed.result(WAIT)
    assert executor.submit(tasks.echo, 1).result(WAIT) == 1


def test_the_same_call_twice_runs_twice(
    executor: Executor, tasks: ModuleType, tmp_path: Path
) -> None:
    path = tmp_path / "lines"
    for _ in range(2):
        executor.submit(tasks.append_line, str(path)).result(WAIT)
    assert len(path.read_text().splitlines()) == 2


def test_map_batches_keeps_the_order_and_passes_on_what_was_raised(
    executor: Executor, tasks: ModuleType
) -> None:
    workforce = Workforce(executor, 2, 4)
    seen: list[tuple[int, int]] = []
    batches = [(number,) for number in range(30)]
    advance = lambda done, total: seen.append((done, total))  # noqa: E731 - one line says it
    assert map_batches(workforce, tasks.echo, batches, advance) == list(range(30))
    assert seen == [(done, 30) for done in range(1, 31)]
    with pytest.raises((ValueError, TaskError), match="no luck"):
        map_batches(workforce, tasks.fail, [("no luck",)] * 3)


def test_what_has_not_started_can_be_cancelled(
    executor: Executor, tasks: ModuleType, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    if request.node.callspec.params["executor"] == "serial":
        pytest.skip("the serial backend has run a task before it can be cancelled")
    released = tmp_path / "released"
    futures = [executor.submit(tasks.wait_for_file, str(released)) for _ in range(20)]
    assert futures[-1].cancel()
    assert futures[-1].cancelled()
    released.touch()
    assert {future.result(WAIT) for future in futures[:-1]} == {str(released)}


def test_after_shutdown_nothing_is_taken_and_nothing_is_left_open(tasks: ModuleType) -> None:
    extra = [f"contract.echo={tasks.__name__}:echo"]
    with open_executor("zmq", workers=1, extra_tasks=extra) as backend:
        future = backend.executor.submit(tasks.echo, 1)
        backend.executor.shutdown(wait=True)
        assert future.result(0) == 1
        with pytest.raises(RuntimeError, match="after shutdown"):
            backend.executor.submit(tasks.echo, 2)


@pytest.mark.skipif(UNDER_MPI, reason="of this machine")
@pytest.mark.parametrize("name", ["serial", "threads", POOL])
def test_after_shutdown_no_backend_of_this_machine_takes_a_task(
    name: str, tasks: ModuleType
) -> None:
    with open_executor(name, workers=1) as backend:
        assert backend.executor.submit(tasks.echo, 1).result(WAIT) == 1
        backend.executor.shutdown(wait=True)
        with pytest.raises(RuntimeError, match="after shutdown"):
            backend.executor.submit(tasks.echo, 2)


@pytest.mark.slow
@pytest.mark.skipif(UNDER_MPI, reason="this is the run under MPI")
def test_mpi_keeps_the_contract_too(tasks: ModuleType, run_mpi: RunMpi) -> None:
    done = run_mpi(3, "-m", "pytest", "-q", "-p", "no:cacheprovider", __file__)
    assert done.returncode == 0, done.stdout + done.stderr
    assert " passed" in done.stdout
