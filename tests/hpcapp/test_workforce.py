from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import BrokenExecutor, Future, ThreadPoolExecutor
from threading import Event
from typing import ParamSpec, TypeVar

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hpcapp.backends.serial import SerialExecutor
from hpcapp.workforce import Workforce, begin_batch, map_batches
from hpccomponent.cutting import cut_equal
from hpccomponent.errors import InputError, TaskError, WorkerLostError

P = ParamSpec("P")
R = TypeVar("R")


@given(rows=st.integers(0, 10_000), batches=st.integers(1, 64))
def test_cut_equal_covers_every_row_once_in_order_and_evenly(rows: int, batches: int) -> None:
    slices = cut_equal(rows, batches)
    assert [i for s in slices for i in range(s.start, s.stop)] == list(range(rows))
    sizes = [s.stop - s.start for s in slices]
    assert len(sizes) == min(rows, batches)
    assert not sizes or max(sizes) - min(sizes) <= 1


def test_workforce_cuts_for_all_its_workers() -> None:
    assert len(Workforce(SerialExecutor(), workers=3, batches_per_worker=4).cut(1000)) == 12


def test_results_come_in_the_order_of_the_batches() -> None:
    with ThreadPoolExecutor(4) as pool:
        results = map_batches(Workforce(pool, 4), pow, [(i, 2) for i in range(100)])
    assert results == [i**2 for i in range(100)]


def test_progress_counts_every_batch() -> None:
    seen: list[tuple[int, int]] = []
    map_batches(
        Workforce(SerialExecutor()),
        abs,
        [(1,), (2,)],
        lambda done, total: seen.append((done, total)),
    )
    assert seen == [(1, 2), (2, 2)]


def divide(a: float, b: float) -> float:
    return a / b


def refuse(message: str) -> None:
    raise InputError(message, "mend it")


def test_a_foreign_exception_is_translated_and_names_the_task() -> None:
    with pytest.raises(TaskError, match="divide failed: ZeroDivisionError") as caught:
        map_batches(Workforce(SerialExecutor()), divide, [(1.0, 0.0)])
    assert isinstance(caught.value.__cause__, ZeroDivisionError)


def test_our_own_errors_pass_as_they_are() -> None:
    with pytest.raises(InputError, match="mend it"):
        map_batches(Workforce(SerialExecutor()), refuse, [("bad",)])


class BrokenPool(SerialExecutor):
    def submit(self, fn: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        raise BrokenExecutor


def test_a_broken_pool_is_a_lost_worker() -> None:
    with pytest.raises(WorkerLostError, match="died while it ran divide"):
        map_batches(Workforce(BrokenPool()), divide, [(1.0, 2.0)])


def test_one_batch_runs_while_its_caller_goes_on() -> None:
    with ThreadPoolExecutor(1) as pool:
        asked = Event()
        with begin_batch(Workforce(pool), asked.wait, (30.0,)) as found:
            asked.set()  # would come too late if it had been waited for
            assert found()
        with begin_batch(Workforce(pool), divide, (3.0, 2.0)) as found:
            assert found() == 1.5


def test_one_batch_fails_like_many() -> None:
    serial = Workforce(SerialExecutor())
    with begin_batch(serial, divide, (1.0, 0.0)) as found, pytest.raises(TaskError, match="divide"):
        found()
    with begin_batch(serial, refuse, ("bad",)) as found, pytest.raises(InputError, match="mend it"):
        found()
    lost = pytest.raises(WorkerLostError, match="died while it ran divide")
    with lost, begin_batch(Workforce(BrokenPool()), divide, (1.0, 2.0)):
        raise AssertionError("it was never begun")


def test_one_batch_is_given_up_where_its_caller_fails() -> None:
    done: list[int] = []
    with ThreadPoolExecutor(1) as pool:
        released = Event()
        pool.submit(released.wait, 30.0)
        with pytest.raises(RuntimeError), begin_batch(Workforce(pool), done.append, (1,)):
            raise RuntimeError
        released.set()
    assert not done


def test_what_is_left_for_later_is_found_while_results_are_awaited() -> None:
    found: list[str] = []
    with ThreadPoolExecutor(1) as pool:
        workforce, asked = Workforce(pool), Event()

        def find() -> list[str]:
            found.append("once")
            asked.set()
            return found

        later = workforce.defer(find)
        assert map_batches(workforce, asked.wait, [(30.0,)]) == [True]
        assert later() == later()
    assert found == ["once"]


def test_what_is_left_for_later_is_found_when_it_is_asked_for() -> None:
    found: list[str] = []
    for workforce in (Workforce(SerialExecutor()), Workforce(SerialExecutor(), in_process=True)):
        later = workforce.defer(lambda: found.append("once"))
        assert map_batches(workforce, abs, [(-1,)]) == [1]
        assert not found
        later()
        assert found.pop() == "once"


def test_what_cannot_be_found_says_so_to_whom_asks_for_it() -> None:
    with ThreadPoolExecutor(1) as pool:
        workforce, asked = Workforce(pool), Event()

        def find() -> float:
            asked.set()
            return divide(1.0, 0.0)

        later = workforce.defer(find)
        assert map_batches(workforce, asked.wait, [(30.0,)]) == [True]
        with pytest.raises(ZeroDivisionError):
            later()


class SharingPool(SerialExecutor):
    def share(self, value: object) -> tuple[str, object]:
        return ("shared", value)


def test_a_value_is_shared_where_the_executor_can_and_itself_where_it_cannot() -> None:
    value = [1.0]
    assert Workforce(SharingPool()).share(value) == ("shared", value)
    assert Workforce(SerialExecutor()).share(value) is value
