"""How long work takes on each worker, learned from results.

Tasks of a name take as long per unit of declared work as the last ones did, on the same worker,
with what they spent on their way (large arguments, slow networks) and was not hidden by others;
a worker that has not run any is taken for the mean of the others.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from hpcapp.communicator.roster import Task, Worker

__all__ = ["Forecast"]

SHORTEST_S = 1e-6  # of a unit of work, so that no worker looks infinitely fast


class Forecast:
    """Expected times, all in seconds; infinite where nothing is known yet."""

    def __init__(self) -> None:
        self._unit_s: dict[str, dict[bytes, float]] = {}

    def learn(self, worker: bytes, task: Task, seconds: float, way_s: float = 0.0) -> None:
        """Take note of how long a task took, and its way; recent ones weigh more.

        The first way to a worker does not count: it may contain the import of the task's module.
        """
        known = self._unit_s.setdefault(task.name, {})
        before = known.get(worker)
        unit_s = max(SHORTEST_S, (seconds + (0.0 if before is None else way_s)) / task.work)
        known[worker] = unit_s if before is None else (before + unit_s) / 2.0

    def forget(self, worker: bytes) -> None:
        """Let a lost worker count no more; the last one to know a task leaves what it knew."""
        for known in self._unit_s.values():
            if len(known) > 1:
                known.pop(worker, None)

    def unit_s(self, worker: bytes, name: str) -> float:
        """Return how long a unit of work of a task is expected to take on a worker."""
        known = self._unit_s.get(name)
        if not known:
            return math.inf
        own = known.get(worker)
        return own if own is not None else sum(known.values()) / len(known)

    def expect(self, worker: bytes, task: Task) -> float:
        """Return how long a task is expected to take on a worker."""
        return self.unit_s(worker, task.name) * task.work

    def remaining_s(self, worker: Worker, now: float) -> float:
        """Return how long a worker still has to do with what it holds.

        A task that takes longer than expected is expected to take as long again as it has.
        """
        total = 0.0
        first: Task | None = None
        for flight in worker.batches.values():
            first = first or next(iter(flight.tasks.values()), None)
            for name, work in flight.work.items():
                total += self.unit_s(worker.identity, name) * work
        if first is None or math.isinf(total):
            return total
        expected, elapsed = self.expect(worker.identity, first), now - worker.since
        return max(0.0, total - min(elapsed, expected)) + (elapsed if elapsed > expected else 0.0)

    def ends(self, worker: Worker, now: float) -> Iterator[tuple[Task, float]]:
        """Yield each task that a worker holds, with how long it will be until it is done."""
        left = 0.0
        elapsed: float | None = now - worker.since
        for flight in worker.batches.values():
            for task in flight.tasks.values():
                expected = self.expect(worker.identity, task)
                if elapsed is not None:
                    expected = expected - elapsed if elapsed < expected else elapsed
                    elapsed = None
                left += expected
                yield task, left
