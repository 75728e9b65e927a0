"""Which tasks share a message: enough to hide the way, few enough to keep workers levelled."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable

from hpcapp.communicator.roster import Task

__all__ = ["MAX_BATCH_BYTES", "MAX_BATCH_S", "MAX_TASKS", "BatchCutter"]

MAX_TASKS = 64
MAX_BATCH_BYTES = 1_000_000  # a larger task travels alone
MAX_BATCH_S = 0.25  # expected work; a task of unknown duration travels alone


class BatchCutter:
    """Takes tasks that may share a batch off a queue, and learns how long tasks take.

    Parameters
    ----------
    claim : callable
        Called with a task's number right before it first leaves; False if it was cancelled.
    """

    def __init__(self, claim: Callable[[int], bool]) -> None:
        self._claim = claim
        self._mean_s: dict[str, float] = {}

    def learn(self, name: str, seconds: float) -> None:
        """Take note of how long a task of this name took; recent ones weigh more."""
        self._mean_s[name] = (self._mean_s.get(name, seconds) + seconds) / 2.0

    def cut(self, source: OrderedDict[int, Task], limit: int) -> tuple[list[Task], list[Task]]:
        """Take at most `limit` tasks off the front of `source`.

        A task that was lost with a worker before travels alone, so that the one that kills its
        workers is found, and no other is blamed with it.

        Parameters
        ----------
        source : OrderedDict of int to Task
            The queue; what is returned is no longer in it.
        limit : int
            How many tasks the batch may hold.

        Returns
        -------
        batch : list of Task
            Claimed tasks, in order.
        cancelled : list of Task
            What turned out to be cancelled meanwhile.
        """
        batch: list[Task] = []
        cancelled: list[Task] = []
        size, seconds = 0, 0.0
        while source and len(batch) < limit:
            number, task = next(iter(source.items()))
            size += task.size_bytes
            seconds += self._mean_s.get(task.name, MAX_BATCH_S)
            if batch and (size > MAX_BATCH_BYTES or seconds > MAX_BATCH_S or task.losses):
                break
            source.popitem(last=False)
            if not task.is_claimed and not self._claim(number):
                cancelled.append(task)
                continue
            task.is_claimed = True
            batch.append(task)
            if task.losses:
                break
        return batch, cancelled
