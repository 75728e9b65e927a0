"""What waits for a worker, and who gets what of it next.

::

    queue ──policy──> backlog of a worker ──credit window──> batch in flight
    lost, alone ─────────────────────────────────────────────────^

A task that was lost with a worker goes alone, so that no other is blamed with it, and to who may
have it (see `Losses`); it goes before what waits in the queue, as does one that another machine has
answered and that is verified. When nothing waits, idle workers run stragglers a second time (see
`speculation`), if the policy wants that.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence

from hpcapp.communicator.scheduling.assignments import Assignments
from hpcapp.communicator.scheduling.batching import MAX_TASKS, BatchCutter, find_holder
from hpcapp.communicator.scheduling.forecast import Forecast
from hpcapp.communicator.scheduling.losses import Losses
from hpcapp.communicator.scheduling.policy import Policy
from hpcapp.communicator.scheduling.speculation import choose_to_speculate, choose_to_split
from hpcapp.communicator.scheduling.state import Assign, OpenBatch, Task, Worker
from hpccomponent.clock import Clock

CREDIT = 2  # batches in flight per worker


class Dispatcher:
    """Holds the tasks that wait, and places them.

    Parameters
    ----------
    claim : callable
        Called with a task's number right before it first leaves; False if it was cancelled.
    split : callable
        Called with the number of a task that can be split; returns those that replace it, if any.

    Attributes
    ----------
    queue : OrderedDict of int to Task
        What any worker may have, in order.
    lost : OrderedDict of int to Task
        What was lost with a worker, or is to be answered by another one: not for every one.
    """

    def __init__(
        self,
        policy: Policy,
        clock: Clock,
        losses: Losses,
        claim: Callable[[int], bool],
        split: Callable[[int], list[Task]],
    ) -> None:
        self.queue: OrderedDict[int, Task] = OrderedDict()
        self.lost: OrderedDict[int, Task] = OrderedDict()
        self.assignments = Assignments()
        self.forecast = Forecast()
        self._policy = policy
        self._clock = clock
        self._losses = losses
        self._split = split
        self._cutter = BatchCutter(claim, self.forecast)

    def requeue(self, tasks: Iterable[Task]) -> None:
        """Have tasks that had left wait again, before all others.

        Parameters
        ----------
        tasks : iterable of Task
            In order; no worker has them any more.
        """
        for task in reversed(list(tasks)):
            task.holders.clear()
            if task.losses or task.answers:
                self.queue.pop(task.number, None)
                self.lost[task.number] = task
                continue
            self.queue[task.number] = task
            self.queue.move_to_end(task.number, last=False)

    def withdraw(self, number: int) -> None:
        """Have a task not wait any more, if it does."""
        self.queue.pop(number, None)
        self.lost.pop(number, None)

    def dispatch(self, everyone: Iterable[Worker]) -> list[Assign]:
        """Place what waits, and send what the credit windows allow."""
        actions: list[Assign] = []
        everyone = list(everyone)
        workers = [worker for worker in everyone if worker.is_open]
        for task in list(self.lost.values()) if workers else ():
            actions += self._place_lost(task, workers)
        if self._policy.is_speculative:
            self._split_last(workers)
        if self.queue:
            self._estimate(workers)
        while self.queue and workers:
            name = next(iter(self.queue.values())).name
            placement = self._policy.place(len(self.queue), workers)
            if placement is None:
                break
            worker = workers[placement.worker]
            if not placement.is_fixed:
                worker = find_holder(self.queue, workers, worker)
            if placement.is_fixed:
                number, task = self.queue.popitem(last=False)
                task.holders[worker.identity] = -1
                worker.backlog[number] = task
                worker.placed += 1
            else:
                batch = self._cutter.cut(self.queue, min(placement.tasks, MAX_TASKS), worker)
                worker.placed += len(batch)
                actions += self._send(worker, batch)
                if self.queue:
                    is_same = next(iter(self.queue.values())).name == name
                    self._estimate([worker] if is_same else workers)
        for worker in workers:
            while worker.backlog and len(worker.batches) < CREDIT:
                actions += self._send(worker, self._cutter.cut(worker.backlog, MAX_TASKS, worker))
        if self._policy.is_speculative and not self.queue and not self.lost:
            actions += self._speculate(everyone, workers)
        return actions

    def _place_lost(self, task: Task, workers: Sequence[Worker]) -> list[Assign]:
        """Send a lost task, alone, so that no other is blamed with it, to who is free first."""
        now = self._clock.now()
        candidates = self._losses.find_candidates(task, workers)
        worker = min(candidates, key=lambda w: (self.forecast.remaining_s(w, now), len(w.batches)))
        if len(worker.batches) >= CREDIT:
            return []
        del self.lost[task.number]
        worker.placed += 1
        return self._send(worker, [task])

    def _split_last(self, workers: Sequence[Worker]) -> None:
        now = self._clock.now()
        while task := choose_to_split(self.queue.values(), workers, self.forecast, now):
            task.can_split = False  # asked once
            parts = {part.number: part for part in self._split(task.number)}
            if parts:
                del self.queue[task.number]
                self.queue.update(parts)

    def _estimate(self, workers: Sequence[Worker]) -> None:
        name = next(iter(self.queue.values())).name
        for worker in workers:
            self.forecast.estimate(worker, name, self._clock.now())

    def _speculate(self, everyone: Sequence[Worker], workers: Sequence[Worker]) -> list[Assign]:
        idle = [worker for worker in workers if not worker.batches]
        now = self._clock.now()
        actions: list[Assign] = []
        for worker, task in choose_to_speculate(everyone, idle, self.forecast, now):
            worker.placed += 1
            actions += self._send(worker, [task])
        return actions

    def _send(self, worker: Worker, batch: list[Task]) -> list[Assign]:
        if not batch:
            return []
        number = self.assignments.add(worker)
        if not worker.batches:
            worker.since = self._clock.now()
        open_batch = worker.batches[number] = OpenBatch({task.number: task for task in batch})
        for task in batch:
            task.holders[worker.identity] = number
        lacking = {
            blob.key: blob for task in batch for blob in task.blobs if blob.key not in worker.blobs
        }
        worker.blobs.update(lacking)
        open_batch.shared_bytes = sum([blob.size_bytes for blob in lacking.values()])
        numbers = tuple([task.number for task in batch])
        return [Assign(worker.identity, number, numbers, tuple(lacking.values()))]
