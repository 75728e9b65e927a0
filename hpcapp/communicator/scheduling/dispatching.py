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
from hpccomponent.protocol.blobs import Blob

CREDIT = 2  # batches in flight per worker


class Dispatcher:
    """Holds the tasks that wait, and places them.

    `claim` is that of `BatchCutter`; `split` gets the number of a task that can be split, and
    returns those that replace it, if any. In order, `queue` holds what any worker may have, and
    `lost` what was lost with a worker, or is to be answered by another one: not for every one.
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
        """Have tasks, in order, that no worker has any more wait again, before all others."""
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
        everyone = list(everyone)
        workers = [worker for worker in everyone if worker.is_open]
        if not workers:
            return []
        actions = self._place_lost(workers)
        if self._policy.is_speculative:
            self._split_last(workers)
        actions += self._place_queue(workers)
        actions += self._send_backlogs(workers)
        if self._policy.is_speculative and not self.queue and not self.lost:
            actions += self._speculate(everyone, workers)
        return actions

    def _place_lost(self, workers: Sequence[Worker]) -> list[Assign]:
        """Send lost tasks, each alone, so that no other is blamed with it, to who is free first."""
        actions: list[Assign] = []
        for task in list(self.lost.values()):
            now = self._clock.now()
            worker = min(
                self._losses.find_candidates(task, workers),
                key=lambda worker: (self.forecast.remaining_s(worker, now), len(worker.batches)),
            )
            if len(worker.batches) < CREDIT:
                del self.lost[task.number]
                worker.placed += 1
                actions += self._send(worker, [task])
        return actions

    def _place_queue(self, workers: Sequence[Worker]) -> list[Assign]:
        """Send what waits to whom the policy names, or have it wait for them."""
        actions: list[Assign] = []
        estimated = None  # the name of the tasks of which the workers' times are known
        while self.queue:
            name = next(iter(self.queue.values())).name
            if name != estimated:
                self._estimate(workers, name)
                estimated = name
            placement = self._policy.place(len(self.queue), workers)
            if placement is None:
                break
            worker = workers[placement.worker]
            if placement.is_fixed:
                number, task = self.queue.popitem(last=False)
                task.holders[worker.identity] = -1
                worker.backlog[number] = task
                worker.placed += 1
                continue
            worker = find_holder(self.queue, workers, worker)
            batch = self._cutter.cut(self.queue, min(placement.tasks, MAX_TASKS), worker)
            worker.placed += len(batch)
            actions += self._send(worker, batch)
            self._estimate([worker], name)
        return actions

    def _send_backlogs(self, workers: Sequence[Worker]) -> list[Assign]:
        actions: list[Assign] = []
        for worker in workers:
            while worker.backlog and len(worker.batches) < CREDIT:
                actions += self._send(worker, self._cutter.cut(worker.backlog, MAX_TASKS, worker))
        return actions

    def _split_last(self, workers: Sequence[Worker]) -> None:
        now = self._clock.now()
        while task := choose_to_split(self.queue.values(), workers, self.forecast, now):
            task.can_split = False  # asked once
            parts = {part.number: part for part in self._split(task.number)}
            if parts:
                del self.queue[task.number]
                self.queue.update(parts)

    def _estimate(self, workers: Sequence[Worker], name: str) -> None:
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
        lacking: dict[bytes, Blob] = {}
        for task in batch:
            lacking |= task.lacking_blobs(worker)
        worker.blobs.update(lacking)
        open_batch.shared_bytes = sum([blob.size_bytes for blob in lacking.values()])
        numbers = tuple([task.number for task in batch])
        return [Assign(worker.identity, number, numbers, tuple(lacking.values()))]
