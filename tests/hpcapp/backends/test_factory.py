"""Executors by the name of a function, with every way in which that can be wrong."""

from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType

import pytest

from hpcapp.backends.factory import is_factory
from hpcapp.backends.selection import open_executor
from hpcapp.workforce import map_batches
from hpccomponent.errors import UsageError, WorkerLostError
from hpccomponent.limits import available_cores

MODULE = '''
"""Factories for a test."""

from concurrent.futures import Executor, Future, ThreadPoolExecutor

NUMBER = 3


class Silent(Executor):
    def submit(self, fn, /, *args):
        future = Future()
        future.set_result(fn(*args))
        return future


def plain():
    return ThreadPoolExecutor(3)


def sized(workers):
    return Silent()


def demanding(workers, queue):
    return Silent()


def silent():
    return Silent()


def failing():
    raise OSError("no licence")


def wrong():
    return [1, 2]
'''


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "made_for_test.py").write_text(MODULE)
    (tmp_path / "broken_for_test.py").write_text("1 / 0")
    monkeypatch.syspath_prepend(tmp_path)
    return "made_for_test"


@pytest.mark.parametrize(
    ("name", "workers", "words"),
    [
        ("no_such_module:pool", None, "no_such_module cannot be imported .* PYTHONPATH"),
        ("broken_for_test:pool", None, "cannot be imported .ZeroDivisionError"),
        ("made_for_test:pool", None, "the module made_for_test has no pool"),
        ("made_for_test:NUMBER", None, "it is 3, not a function"),
        ("made_for_test:plain", 4, "cannot be called with workers=4: .* leave workers out"),
        ("made_for_test:demanding", None, "cannot be called without arguments: .*'workers'"),
        ("made_for_test:demanding", 4, "cannot be called with workers=4: .*'queue'"),
        ("made_for_test:failing", None, "failed .OSError: no licence"),
        ("made_for_test:wrong", None, "made a list, not a concurrent.futures.Executor"),
        ("made_for_test:", None, "unknown backend"),
        ("made for:test", None, "unknown backend"),
    ],
)
def test_what_makes_no_executor_is_refused(
    module: str, name: str, workers: int | None, words: str
) -> None:
    with pytest.raises(UsageError, match=words), open_executor(name, workers=workers):
        pass


@pytest.mark.parametrize(
    ("function", "given", "workers"),
    [("plain", None, 3), ("sized", 5, 5), ("silent", None, available_cores())],
)
def test_the_number_of_workers_is_given_told_or_guessed(
    module: str, function: str, given: int | None, workers: int
) -> None:
    with open_executor(f"{module}:{function}", workers=given) as backend:
        assert backend.name == f"{module}:{function}"
        assert backend.workforce.workers == workers
        assert map_batches(backend.workforce, pow, [(2, 3)]) == [8]


def test_addresses_are_no_names_of_functions() -> None:
    assert is_factory("a.b.c:d")
    for name in ("tcp://host:1", "a:b:c", "1a:b", "dask=a:b", "a-b:c", "a.:b", "C:\\x"):
        assert not is_factory(name)


@pytest.mark.leaks_allowed  # loky keeps its resource tracker
def test_a_pool_of_loky_that_has_lost_a_worker_is_made_anew(tasks: ModuleType) -> None:
    pytest.importorskip("loky", reason="loky is not installed")
    with open_executor("loky:ProcessPoolExecutor") as backend:
        first = backend.executor.submit(os.getpid).result(60)
        with pytest.raises(WorkerLostError, match=r"4 worker\(s\) died"):
            map_batches(backend.workforce, tasks.kill_worker, [()])
        assert backend.executor.submit(os.getpid).result(60) != first
