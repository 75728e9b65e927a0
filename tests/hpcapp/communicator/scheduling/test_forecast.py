from __future__ import annotations

import itertools
import math

import pytest

from hpcapp.communicator.scheduling.forecast import Forecast
from hpcapp.communicator.scheduling.state import OpenBatch, Task, Worker
from hpccomponent.protocol.messages import PROTOCOL_VERSION, Register

REGISTER = Register(PROTOCOL_VERSION, "1", "w", "i", "b", "n", 1, 1, 1 << 20)


def task(number: int = 0, work: float = 1.0, name: str = "t") -> Task:
    return Task(number, name, 10, (), work)


def worker_with(*tasks: Task, since: float = 0.0) -> Worker:
    worker = Worker(b"w", REGISTER, "", 0.0, since=since)
    worker.batches[1] = OpenBatch({task.number: task for task in tasks})
    return worker


def test_each_worker_has_its_own_pace_and_a_new_one_the_mean() -> None:
    forecast = Forecast()
    assert math.isinf(forecast.expect(b"a", task()))
    forecast.learn(b"a", task(work=2.0), 2.0)
    forecast.learn(b"b", task(work=2.0), 6.0)
    assert forecast.expect(b"a", task(work=3.0)) == 3.0
    assert forecast.expect(b"b", task()) == 3.0
    assert forecast.expect(b"new", task()) == 2.0
    assert math.isinf(forecast.expect(b"a", task(name="other")))


@pytest.mark.parametrize("order", list(itertools.permutations([b"a", b"b", b"slow"])))
def test_who_was_slow_with_other_tasks_is_expected_to_be_slow_with_new_ones(
    order: tuple[bytes, ...],
) -> None:
    unit_s = {b"a": 10.0, b"b": 10.0, b"slow": 40.0}
    forecast = Forecast()
    for worker in order:
        forecast.learn(worker, task(work=2.0, name="first"), 2.0 * unit_s[worker])
    forecast.learn(order[0], task(name="second"), 0.3 * unit_s[order[0]])
    forecast.learn(order[0], task(name="third"), 0.1 * unit_s[order[0]])
    for worker in order:
        assert forecast.expect(worker, task(name="second")) == pytest.approx(0.3 * unit_s[worker])
        assert forecast.expect(worker, task(name="third")) == pytest.approx(0.1 * unit_s[worker])
    forecast.learn(b"slow", task(name="fourth"), 5.0)
    forecast.learn(b"a", task(name="fourth"), 5.0)  # known now, whatever they did before
    assert forecast.expect(b"slow", task(name="fourth")) == 5.0
    assert forecast.expect(b"a", task(name="fourth")) == 5.0


def test_what_is_answered_leaves_nothing_to_wait_for() -> None:
    """Of tasks that nobody has run the like of, too: the answer may have been a failure."""
    worker = worker_with(task(0, 0.1), task(1, 0.2), task(2, 0.3), task(3, name="known"))
    forecast = Forecast()
    forecast.learn(b"w", task(name="known"), 2.0)
    assert math.isinf(forecast.remaining_s(worker, 0.0))
    for number in range(3):
        worker.batches[1].pop(number)
    assert forecast.remaining_s(worker, 0.0) == 2.0
    worker.batches[1].pop(3)
    assert forecast.remaining_s(worker, 0.0) == 0.0


def test_tasks_that_grow_do_not_make_the_only_worker_slow() -> None:
    forecast = Forecast()
    for seconds in (1.0, 2.0, 4.0):
        forecast.learn(b"a", task(name="grows"), seconds)
    forecast.learn(b"b", task(name="other"), 3.0)
    forecast.learn(b"b", task(name="grows"), 3.75)
    assert forecast.expect(b"a", task(name="other")) < 3.0


def test_what_took_milliseconds_tells_nothing_of_what_takes_longer() -> None:
    forecast = Forecast()
    forecast.learn(b"a", task(name="short"), 0.001)
    forecast.learn(b"b", task(name="short"), 0.010)
    forecast.learn(b"a", task(), 5.0)
    assert forecast.expect(b"b", task()) == 5.0


def test_new_figures_weigh_more_than_old_ones() -> None:
    forecast = Forecast()
    forecast.learn(b"a", task(), 1.0)
    for _ in range(10):
        forecast.learn(b"a", task(), 4.0)
    assert forecast.expect(b"a", task()) == pytest.approx(4.0, rel=0.01)


def test_the_way_counts_but_for_the_first() -> None:
    forecast = Forecast()
    forecast.learn(b"a", task(), 1.0, transit_s=7.0)
    assert forecast.expect(b"a", task()) == 1.0
    forecast.learn(b"a", task(), 1.0, transit_s=2.0)
    assert forecast.expect(b"a", task()) == 2.0


def test_the_way_of_a_name_is_that_of_its_last_tasks() -> None:
    forecast = Forecast()
    assert forecast.transit_s("t") == 0.0
    forecast.learn(b"a", task(), 1.0, transit_s=4.0)
    assert forecast.transit_s("t") == 4.0
    forecast.learn(b"b", task(), 1.0, transit_s=2.0)
    assert forecast.transit_s("t") == 3.0


def test_a_lost_worker_counts_no_more_unless_nobody_else_knows() -> None:
    forecast = Forecast()
    forecast.learn(b"a", task(), 1.0)
    forecast.learn(b"b", task(), 9.0)
    forecast.forget(b"b")
    assert forecast.expect(b"b", task()) == 1.0
    forecast.forget(b"a")
    assert forecast.expect(b"new", task()) == 1.0


def test_what_takes_longer_than_expected_is_expected_to_take_as_long_again() -> None:
    forecast = Forecast()
    worker = worker_with(task(1), task(2, work=2.0), since=10.0)
    assert math.isinf(forecast.remaining_s(worker, 10.0))
    forecast.learn(b"w", task(), 1.0)
    for now, first_s in ((10.0, 1.0), (10.75, 0.25), (13.0, 3.0)):
        assert forecast.remaining_s(worker, now) == pytest.approx(first_s + 2.0)
        assert [left for _, left in forecast.ends(worker, now)] == pytest.approx(
            [first_s, first_s + 2.0]
        )
    assert forecast.remaining_s(worker_with(), 10.0) == 0.0
