"""What surrounds every foreign engine, on engines that fail as they are told to."""

from __future__ import annotations

import errno
import os
import platform
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from typing import ParamSpec, TypeVar, cast

import numpy as np
import pytest
from numpy.typing import NDArray

from hpcapp.backends.calls import TaskOutcome, align, run_task
from hpcapp.backends.retrying import MOST_LOSSES, RetryingExecutor
from hpcapp.workforce import Workforce, map_batches
from hpccomponent.errors import JobError, WorkerLostError
from hpccomponent.runtime.numerics import numerics_id

P = ParamSpec("P")
R = TypeVar("R")


class FailingEngine(Executor):
    """Keeps tasks until it is told what becomes of them."""

    def __init__(self) -> None:
        self.waiting: list[tuple[Future[object], Callable[..., object], tuple[object, ...]]] = []
        self.came = threading.Semaphore(0)

    def submit(self, fn: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        future: Future[R] = Future()
        self.waiting.append((cast("Future[object]", future), fn, args))
        self.came.release()
        return future

    def wait_for(self, count: int) -> None:
        for _ in range(count):
            assert self.came.acquire(timeout=60)

    def run_all(self) -> None:
        for future, fn, args in self.waiting:
            if future.set_running_or_notify_cancel():
                future.set_result(fn(*args))
        self.waiting.clear()

    def fail_all(self, error: BaseException) -> None:
        waiting, self.waiting = self.waiting, []
        for future, _, _ in waiting:
            future.set_running_or_notify_cancel()
            future.set_exception(error)


class Engines:
    """Opens one engine after the other."""

    def __init__(self) -> None:
        self.opened: list[FailingEngine] = []
        self.open = 0
        self.is_refusing = False
        self.reopened = threading.Semaphore(0)

    @contextmanager
    def __call__(self) -> Iterator[Executor]:
        if self.is_refusing:
            raise RuntimeError("no machine is left")
        self.opened.append(FailingEngine())
        self.open += 1
        self.reopened.release()
        yield self.opened[-1]
        self.open -= 1

    def wait_for(self, count: int) -> FailingEngine:
        """Wait until as many engines have been opened since the last call; return the last."""
        for _ in range(count):
            assert self.reopened.acquire(timeout=60)
        return self.opened[-1]


@pytest.fixture
def engines() -> Engines:
    return Engines()


@pytest.fixture
def executor(engines: Engines) -> Iterator[RetryingExecutor]:
    executor = RetryingExecutor(engines, 2)
    engines.wait_for(1)
    yield executor
    executor.shutdown(wait=True, cancel_futures=True)
    assert engines.open == 0


def test_a_broken_engine_is_opened_anew_once_and_all_its_tasks_run_again(
    executor: RetryingExecutor, engines: Engines
) -> None:
    futures = [executor.submit(pow, 2, power) for power in range(5)]
    engines.opened[0].fail_all(BrokenExecutor("a worker died"))
    second = engines.wait_for(1)
    second.wait_for(5)
    second.run_all()
    assert [future.result(60) for future in futures] == [1, 2, 4, 8, 16]
    assert len(engines.opened) == 2
    assert engines.open == 1


def test_a_task_is_given_up_with_the_loss_after_the_third(
    executor: RetryingExecutor, engines: Engines
) -> None:
    future = executor.submit(pow, 2, 3)
    for loss in range(MOST_LOSSES + 1):
        engines.opened[-1].fail_all(BrokenExecutor("a worker died"))
        if loss < MOST_LOSSES:
            engines.wait_for(1).wait_for(1)
    with pytest.raises(
        WorkerLostError, match=r"pow was not finished: 4 worker\(s\) died"
    ) as caught:
        future.result(60)
    assert isinstance(caught.value.__cause__, BrokenExecutor)


@pytest.mark.parametrize("most_losses", [0, MOST_LOSSES])
def test_what_one_worker_lacks_another_may_have(engines: Engines, most_losses: int) -> None:
    executor = RetryingExecutor(engines, 2, most_losses=most_losses)
    saved, gone = executor.submit(pow, 2, 3), executor.submit(pow, 2, 4)
    engine = engines.opened[0]
    engine.wait_for(2)
    (first, _, _), (second, function, arguments) = engine.waiting
    engine.waiting.clear()
    first.set_exception(MemoryError("no room"))
    engine.wait_for(1)
    engine.run_all()
    assert saved.result(60) == 8
    engine.waiting.append((second, function, arguments))
    for loss in range(MOST_LOSSES + 1):
        engine.fail_all(OSError(errno.ENOSPC, "no room"))
        if loss < MOST_LOSSES:
            engine.wait_for(1)
    with pytest.raises(WorkerLostError, match=r"4 worker\(s\) lacked what it needs \(OSError"):
        gone.result(60)
    executor.shutdown()
    assert len(engines.opened) == 1


def test_an_engine_that_retries_by_itself_says_how_many_workers_it_lost(engines: Engines) -> None:
    executor = RetryingExecutor(engines, 2, count_losses=lambda error: error.args[0], advice="look")
    gone, saved = executor.submit(pow, 2, 3), executor.submit(pow, 2, 4)
    engine = engines.opened[0]
    engine.wait_for(2)
    (first, _, _), (second, _, _) = engine.waiting
    engine.waiting.clear()
    first.set_exception(OSError(4))
    second.set_exception(OSError(3))
    engine.wait_for(1)  # it is not broken: the same one gets the task once more
    engine.run_all()
    assert saved.result(60) == 16
    with pytest.raises(WorkerLostError, match=r"4 worker\(s\) died while it ran or waited; look"):
        gone.result(60)
    executor.shutdown()
    assert len(engines.opened) == 1


def test_an_engine_that_cannot_be_opened_anew_fails_its_tasks(
    executor: RetryingExecutor, engines: Engines
) -> None:
    futures = [executor.submit(pow, 2, 3) for _ in range(3)]
    engines.is_refusing = True
    engines.opened[0].fail_all(BrokenExecutor("a worker died"))
    for future in futures:
        with pytest.raises(RuntimeError, match="no machine is left"):
            future.result(60)


def test_what_the_task_itself_raises_is_passed_on(
    executor: RetryingExecutor, engines: Engines
) -> None:
    future = executor.submit(pow, 2, 3)
    engines.opened[0].fail_all(ValueError("no luck"))
    with pytest.raises(ValueError, match="no luck"):
        future.result(60)


def test_a_task_that_the_engine_drops_is_lost(executor: RetryingExecutor, engines: Engines) -> None:
    future = executor.submit(pow, 2, 3)
    engines.opened[0].waiting[0][0].cancel()
    with pytest.raises(WorkerLostError, match="its engine gave it up"):
        future.result(60)


def test_a_cancelled_task_wakes_those_who_wait_and_does_not_run(
    executor: RetryingExecutor, engines: Engines
) -> None:
    kept, dropped = executor.submit(pow, 2, 3), executor.submit(pow, 2, 4)
    assert dropped.cancel()
    assert dropped.cancel()
    engines.opened[0].run_all()
    assert set(as_completed([kept, dropped], timeout=60)) == {kept, dropped}
    assert dropped.cancelled()
    assert kept.result() == 8
    assert not kept.cancel()


def test_a_task_that_runs_cannot_be_cancelled(executor: RetryingExecutor, engines: Engines) -> None:
    future = executor.submit(pow, 2, 3)
    inner, function, arguments = engines.opened[0].waiting[0]
    inner.set_running_or_notify_cancel()
    assert not future.cancel()
    inner.set_result(function(*arguments))
    assert future.result(60) == 8


def test_after_shutdown_nothing_is_taken(engines: Engines) -> None:
    executor = RetryingExecutor(engines, 2)
    executor.shutdown()
    executor.shutdown()
    with pytest.raises(RuntimeError, match="after shutdown"):
        executor.submit(pow, 2, 3)


def test_an_engine_that_breaks_at_the_end_is_not_opened_anew(engines: Engines) -> None:
    executor = RetryingExecutor(engines, 2)
    future = executor.submit(pow, 2, 3)
    inner = engines.opened[0].waiting[0][0]
    inner.set_running_or_notify_cancel()
    closer = threading.Thread(target=executor.shutdown, kwargs={"cancel_futures": True})
    closer.start()
    while not executor._gives_up:
        pass
    inner.set_exception(BrokenExecutor("a worker died"))
    closer.join()
    with pytest.raises(WorkerLostError):
        future.result(0)
    assert len(engines.opened) == 1


def test_keywords_are_refused_and_values_shared_as_they_are(executor: RetryingExecutor) -> None:
    with pytest.raises(TypeError, match=r"\['mod'\] must be given by position"):
        executor.submit(pow, 2, 3, mod=5)
    value = np.ones(3)
    assert executor.share(value) is value


def test_as_many_workers_as_the_engine_tells(engines: Engines) -> None:
    with ThreadPoolExecutor(5) as pool:

        @contextmanager
        def lend() -> Iterator[Executor]:
            yield pool

        with RetryingExecutor(lend) as executor:
            assert executor.workers == 5
            assert map_batches(Workforce(executor), pow, [(2, 3), (2, 4)]) == [8, 16]


def test_a_worker_with_other_kernels_refuses() -> None:
    ran = run_task(numerics_id(), pow, 2, 3)
    assert ran.value == 8
    assert ran.worker.startswith(f"{platform.node()}:{os.getpid()}")
    assert ran.seconds >= 0.0
    with pytest.raises(JobError, match=r"computes with .*, the master with native-other"):
        run_task("native-other", pow, 2, 3)


def unaligned(values: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return an equal array whose numbers start at odd addresses."""
    raw = np.empty(values.nbytes + 1, np.uint8)
    there = raw[1:].view(values.dtype)
    there[:] = values
    assert not there.flags.aligned
    found: NDArray[np.generic] = there
    return found


def test_unaligned_arrays_are_copied_wherever_they_stand() -> None:
    values = np.random.default_rng(3).standard_normal(100_001)
    odd = unaligned(values)
    found = align({"a": (odd, [odd, 1]), "b": values})
    assert found["b"] is values
    for array in (found["a"][0], found["a"][1][0]):
        assert array.flags.aligned
        assert np.add.reduce(array) == np.add.reduce(values)


def test_tasks_get_and_give_aligned_arrays(executor: RetryingExecutor, engines: Engines) -> None:
    odd = unaligned(np.arange(9.0))
    future = executor.submit(np.positive, odd)
    inner, function, arguments = engines.opened[0].waiting[0]
    ran = function(*arguments)
    assert isinstance(ran, TaskOutcome)
    assert ran.value.flags.aligned
    inner.set_result(TaskOutcome(odd, "worker", 0.0))
    assert future.result(60).flags.aligned
