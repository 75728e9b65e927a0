"""The makespan of each policy on workers of unequal speed, in exact simulated time."""

from __future__ import annotations

import heapq
import math
from collections import Counter, deque
from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hpcapp.communicator.scheduling.policy import AdaptivePolicy, EqualPolicy, Policy
from hpcapp.communicator.scheduling.scheduler import Scheduler
from hpcapp.communicator.scheduling.state import Action, Assign, Deliver, Task
from hpccomponent.clock import ManualClock
from hpccomponent.protocol.messages import PROTOCOL_VERSION, Register, Result

TICK_S = 0.5


class Race:
    """Workers that need `unit_s[i]` seconds for a unit of work, and nothing for the way."""

    def __init__(self, policy: Policy, unit_s: Sequence[float]) -> None:
        self.clock = ManualClock()
        self.scheduler = Scheduler(policy, self.clock, "1", lambda _: True, split=self.split)
        self.unit_s = {b"%d" % i: seconds for i, seconds in enumerate(unit_s)}
        self.queues: dict[bytes, deque[tuple[int, int, bool]]] = {w: deque() for w in self.unit_s}
        self.busy: set[bytes] = set()
        self.events: list[tuple[float, bytes]] = []
        self.costs: dict[int, float] = {}
        self.can_split = False
        self.runs: Counter[int] = Counter()
        for worker in self.unit_s:
            name = worker.decode()
            register = Register(PROTOCOL_VERSION, "1", name, name, "b", "n", 1, 1, 1 << 20)
            self.carry_out(self.scheduler.register(worker, register))

    def run(self, costs: Sequence[float], name: str = "t") -> float:
        """Return how long it takes until every task is answered."""
        begin = self.clock.now()
        for cost in costs:
            number = len(self.costs)
            self.costs[number] = cost
            self.carry_out(self.scheduler.submit(Task(number, name, 10, (), cost, self.can_split)))
        self.carry_out(self.scheduler.dispatch())
        tick = begin + TICK_S
        while self.scheduler.tasks:
            at = min(tick, self.events[0][0] if self.events else math.inf)
            self.clock.advance(at - self.clock.now())
            while self.events and self.events[0][0] <= at:
                self.finish(heapq.heappop(self.events)[1])
            if at == tick:
                for worker in self.unit_s:
                    self.scheduler.heartbeat(worker, 0, 0, [])
                self.carry_out(self.scheduler.tick())
                tick += TICK_S
        return self.clock.now() - begin

    def split(self, number: int) -> list[Task]:
        """Cut a task in two."""
        parts = [len(self.costs), len(self.costs) + 1]
        self.costs |= dict.fromkeys(parts, self.costs[number] / 2.0)
        return [Task(part, "t", 10, (), self.costs[part], can_split=True) for part in parts]

    def finish(self, worker: bytes) -> None:
        batch, number, is_last = self.queues[worker].popleft()
        self.busy.discard(worker)
        seconds = self.costs[number] * self.unit_s[worker]
        result = Result(number, seconds, b"", [])
        self.begin_next(worker)
        self.carry_out(self.scheduler.results(worker, batch, [result], is_last, lambda _: b""))

    def carry_out(self, actions: Sequence[Action]) -> None:
        for action in actions:
            if isinstance(action, Assign):
                for number in action.tasks:
                    is_last = number == action.tasks[-1]
                    self.queues[action.worker].append((action.batch, number, is_last))
                self.begin_next(action.worker)
            else:
                assert not isinstance(action, Deliver) or action.task not in self.scheduler.tasks

    def begin_next(self, worker: bytes) -> None:
        if self.queues[worker] and worker not in self.busy:
            self.busy.add(worker)
            number = self.queues[worker][0][1]
            self.runs[number] += 1
            seconds = self.costs[number] * self.unit_s[worker]
            heapq.heappush(self.events, (self.clock.now() + seconds, worker))


@pytest.mark.parametrize(("tasks", "equal_s", "best_s"), [(64, 32.0, 9.0), (16, 8.0, 3.0)])
@pytest.mark.parametrize("slow", range(8))
def test_one_slow_worker_of_eight_costs_no_more_than_it_must(
    tasks: int, equal_s: float, best_s: float, slow: int
) -> None:
    unit_s = [1.0] * 8
    unit_s[slow] = 4.0
    assert Race(EqualPolicy(), unit_s).run([1.0] * tasks) == equal_s
    race = Race(AdaptivePolicy(), unit_s)
    assert race.run([1.0] * tasks) == best_s
    assert race.run([1.0] * tasks) == best_s  # what is left of the first lot does not hinder
    assert race.runs.total() <= 2 * tasks + 3


@pytest.mark.parametrize("slow", range(8))
def test_a_worker_known_to_be_slow_gets_no_long_task_of_a_new_name(slow: int) -> None:
    unit_s = [1.0] * 8
    unit_s[slow] = 4.0
    race = Race(AdaptivePolicy(), unit_s)
    race.run([1.0] * 8, "first")
    assert race.run([1.0] * 8, "second") == 2.0  # seven of them, then one of the fast again
    assert race.run([1.0] * 8, "third") == 2.0


def test_a_worker_that_hangs_holds_nobody_up() -> None:
    race = Race(AdaptivePolicy(), [1.0, 1.0, 1.0, 1e6])
    assert race.run([1.0] * 12) <= 6.0
    assert race.run([1.0] * 12) <= 6.0


def test_workers_of_one_speed_run_nothing_twice() -> None:
    race = Race(AdaptivePolicy(), [1.0] * 5)
    assert race.run([1.0] * 60) == 12.0
    assert race.runs.total() == 60
    assert race.scheduler.counts["duplicates"] == 0


def test_the_second_answer_is_counted_and_blames_nobody() -> None:
    race = Race(AdaptivePolicy(), [1.0, 1.0, 4.0])
    race.run([1.0] * 6)
    race.run([1.0] * 30)
    assert race.scheduler.counts["duplicates"] >= 1
    assert race.scheduler.counts["dropped"] == race.scheduler.counts["losses"] == 0


def test_the_last_tasks_are_split_where_workers_are_idle() -> None:
    race = Race(AdaptivePolicy(), [1.0] * 8)
    race.run([1.0] * 8)
    assert race.run([8.0] * 9) == 16.0
    race.can_split = True
    assert race.run([8.0] * 9) <= 9.5
    assert race.scheduler.counts["splits"] >= 4


def test_declared_costs_are_believed() -> None:
    race = Race(AdaptivePolicy(), [1.0, 1.0, 1.0])
    race.run([1.0] * 6)
    assert race.run([8.0, 1.0, 1.0, 1.0, 1.0]) == 8.0
    assert race.runs.total() == 11  # the long one is long, and does not lag


@settings(max_examples=150, deadline=None)
@given(
    st.lists(st.floats(0.25, 8.0), min_size=1, max_size=8),
    st.lists(st.floats(0.1, 4.0), min_size=1, max_size=60),
)
def test_whatever_the_speeds_it_ends_and_runs_nothing_three_times(
    unit_s: list[float], costs: list[float]
) -> None:
    race = Race(AdaptivePolicy(), unit_s)
    race.run(costs)
    assert max(race.runs.values()) <= 2
