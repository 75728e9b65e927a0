"""Which worker was given which batch: what tells a late answer from one that nobody asked for."""

from __future__ import annotations

from collections.abc import Container, Iterable

from hpcapp.communicator.scheduling.state import OpenBatch, Worker
from hpccomponent.errors import ProtocolError

MOST_TAKEN_BACK = 1000  # then those are forgotten whose tasks are all done


class Assignments:
    """Every batch since the start, by its number, which counts from 1."""

    def __init__(self) -> None:
        self._owners: list[bytes] = []
        self._taken_back: dict[int, OpenBatch] = {}

    @property
    def last(self) -> int:
        """Return the number of the last batch."""
        return len(self._owners)

    def add(self, worker: Worker) -> int:
        """Return the number of a new batch for a worker."""
        self._owners.append(worker.identity)
        return self.last

    def take_back(self, batch: int, open_batch: OpenBatch) -> None:
        """Note that a batch was given up; whoever had it may still answer."""
        if open_batch.limits:
            self._taken_back[batch] = open_batch
        if len(self._taken_back) > MOST_TAKEN_BACK:
            self._taken_back = {
                number: open_batch
                for number, open_batch in self._taken_back.items()
                if any(not task.is_done for task in open_batch.tasks.values())
            }

    def most_bytes(
        self, worker: Worker, batch: int, numbers: Iterable[int], waiting: Container[int]
    ) -> list[int]:
        """Return how many bytes each answer to a batch may have; 0 where nobody waits any more.

        `waiting` are all tasks that have no answer yet. Raise ProtocolError where the worker was
        not given this batch, or a task is not in it.
        """
        if not 0 < batch <= self.last or self._owners[batch - 1] != worker.identity:
            raise ProtocolError(f"it answers batch {batch}, which it was not given")
        open_batch = worker.batches.get(batch) or self._taken_back.get(batch)
        limits = []
        for number in numbers:
            limit = open_batch.limits.get(number) if open_batch is not None else None
            if limit is None and (open_batch is not None or number in waiting):
                raise ProtocolError(f"it answers task {number}, which batch {batch} does not hold")
            limits.append(limit if limit is not None else 0)
        return limits
