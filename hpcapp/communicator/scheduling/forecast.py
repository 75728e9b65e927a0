"""How long work takes on each worker, learned from results.

Tasks of a name take as long per unit of declared work as the last ones did, on the same worker,
with what they spent on their way (large arguments, slow networks) and was not hidden by others.
A worker that has not run any is taken to be as much slower or faster than the others as it was
with tasks of other names (a time is modelled as the name's, times the worker's slowness), and one
that has run nothing is taken for the mean of the others.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from hpcapp.communicator.scheduling.state import Task, Worker

SHORTEST_S = 1e-6  # of a unit of work, so that no worker looks infinitely fast
TELLING_S = 0.05  # shorter tasks say nothing of how fast a worker is with others


class Forecast:
    """Expected times, all in seconds; infinite where nothing is known yet."""

    def __init__(self) -> None:
        self._unit_s: dict[str, dict[bytes, float]] = {}
        self._common_s: dict[str, float] = {}  # see `_common`; until more is learned of a name
        self._spent_s: dict[bytes, tuple[float, float]] = {}  # and at slowness 1
        self._transit_s: dict[str, float] = {}

    def learn(self, worker: bytes, task: Task, seconds: float, transit_s: float = 0.0) -> None:
        """Take note of how long a task took, and its way; recent ones weigh more.

        The first way to a worker does not count: it may contain the import of the task's module.
        """
        unit_times = self._unit_s.setdefault(task.name, {})
        before = unit_times.get(worker)
        taken_s = seconds + (0.0 if before is None else transit_s)
        if taken_s > TELLING_S:
            if unit_times.keys() - {worker}:
                common_s = self._common(task.name) * task.work
            else:  # nobody to compare it with
                common_s = taken_s / self.slowness(worker)
            spent_s, before_s = self._spent_s.get(worker, (0.0, 0.0))
            self._spent_s[worker] = spent_s + taken_s, before_s + common_s
        unit_s = max(SHORTEST_S, taken_s / task.work)
        unit_times[worker] = unit_s if before is None else (before + unit_s) / 2.0
        self._common_s.pop(task.name, None)
        self._transit_s[task.name] = (self._transit_s.get(task.name, transit_s) + transit_s) / 2.0

    def forget(self, worker: bytes) -> None:
        """Let a lost worker count no more; the last one to know a task leaves what it knew."""
        for name, unit_times in self._unit_s.items():
            if len(unit_times) > 1:
                unit_times.pop(worker, None)
                self._common_s.pop(name, None)
        self._spent_s.pop(worker, None)

    def unit_s(self, worker: bytes, name: str) -> float:
        """Return the seconds expected for a unit of work; infinite where no worker has run it."""
        unit_times = self._unit_s.get(name)
        if not unit_times:
            return math.inf
        if worker in unit_times:
            return unit_times[worker]
        if worker in self._spent_s:
            return self._common(name) * self.slowness(worker)
        return sum(unit_times.values()) / len(unit_times)

    def _common(self, name: str) -> float:
        """Return how long a unit of work takes on a worker of slowness 1."""
        if name not in self._common_s:
            unit_times = self._unit_s[name]
            slowness = sum([self.slowness(worker) for worker in unit_times])
            self._common_s[name] = sum(unit_times.values()) / slowness
        return self._common_s[name]

    def slowness(self, worker: bytes) -> float:
        """Return how many times as long as the first worker a worker takes; 1 if unknown."""
        spent_s, common_s = self._spent_s.get(worker, (1.0, 1.0))
        return spent_s / common_s

    def transit_s(self, name: str) -> float:
        """Return how long tasks of a name have lately been on their way, whatever the worker.

        To it, in its queue, and back until this process has taken the result: of many at once the
        last one waits for the others. In seconds; 0 where there were none.
        """
        return self._transit_s.get(name, 0.0)

    def expect(self, worker: bytes, task: Task) -> float:
        """Return the seconds expected for a task; infinite where no worker has run its like."""
        return self.unit_s(worker, task.name) * task.work

    def remaining_s(self, worker: Worker, now: float) -> float:
        """Return how long a worker still has to do with what it holds.

        A task that takes longer than expected is expected to take as long again as it has. In
        seconds; infinite where it holds a task that no worker has run the like of.
        """
        total = 0.0
        first: Task | None = None
        for open_batch in worker.batches.values():
            first = first or next(iter(open_batch.tasks.values()), None)
            for name, work in open_batch.work.items():
                total += self.unit_s(worker.identity, name) * work
        if first is None or math.isinf(total):
            return total
        expected, elapsed = self.expect(worker.identity, first), now - worker.since
        return max(0.0, total - min(elapsed, expected)) + (elapsed if elapsed > expected else 0.0)

    def estimate(self, worker: Worker, name: str, now: float) -> None:
        """Set a worker's `remaining_s`, `next_s` (by a task's name), `slowness`: for policies."""
        worker.remaining_s = self.remaining_s(worker, now)
        worker.next_s = self.unit_s(worker.identity, name)
        worker.slowness = self.slowness(worker.identity)

    def ends(self, worker: Worker, now: float) -> Iterator[tuple[Task, float]]:
        """Yield the tasks that a worker holds, in order, each with the seconds until it is done."""
        remaining_s = 0.0
        elapsed: float | None = now - worker.since
        for open_batch in worker.batches.values():
            for task in open_batch.tasks.values():
                expected = self.expect(worker.identity, task)
                if elapsed is not None:
                    expected = expected - elapsed if elapsed < expected else elapsed
                    elapsed = None
                remaining_s += expected
                yield task, remaining_s
