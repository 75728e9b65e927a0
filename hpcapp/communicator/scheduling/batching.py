"""Which tasks share a message: enough to hide the way, few enough to keep workers levelled."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Container, Mapping, Sequence
from itertools import islice

from hpcapp.communicator.scheduling.forecast import Forecast
from hpcapp.communicator.scheduling.state import Task, Worker
from hpccomponent.protocol.blobs import Blob

MAX_TASKS = 64
MAX_BATCH_BYTES = 1_000_000  # a larger task travels alone
MAX_BATCH_S = 0.25  # expected work; a task of unknown duration travels alone
MAX_BLOBS = 64  # in a batch of several tasks; the worker's component keeps a file open for each
MOST_DETOUR = 1.5  # times as slow may be who has what a task needs
AFFINITY_WINDOW = 64  # how far from the front a task may be that suits a worker better


class BatchCutter:
    """Takes tasks that may share a batch off a queue.

    `claim` gets a task's number right before it first leaves; it returns False if it was cancelled.
    """

    def __init__(self, claim: Callable[[int], bool], forecast: Forecast) -> None:
        self._claim = claim
        self._forecast = forecast

    def cut(self, source: OrderedDict[int, Task], limit: int, worker: Worker) -> list[Task]:
        """Take at most `limit` tasks off the front of `source`, for `worker`.

        Near the front those come first of whose blobs the worker lacks least: no worker waits for a
        better task, and none gets a blob while it could work without. A blob counts as long as it
        is not there. Return claimed tasks, in order: those that turned out to be cancelled are left
        out.
        """
        batch: list[Task] = []
        size, seconds = 0, 0.0
        added: set[bytes] = set()
        while source and len(batch) < limit:
            task = find_closest(source, worker, added)
            lacking = task.lacking_blobs(worker, added)
            added.update(lacking)
            size += task.size_bytes + _size(lacking)
            seconds += self._forecast.expect(worker.identity, task)
            is_full = size > MAX_BATCH_BYTES or seconds > MAX_BATCH_S or len(added) > MAX_BLOBS
            if batch and is_full:
                break
            del source[task.number]
            if task.is_claimed or self._claim(task.number):
                task.is_claimed = True
                batch.append(task)
        return batch


def _size(blobs: Mapping[bytes, Blob]) -> int:
    return sum([blob.size_bytes for blob in blobs.values()])


def find_closest(
    source: OrderedDict[int, Task], worker: Worker, added: Container[bytes] = ()
) -> Task:
    """Return the task near the front of which the fewest bytes are missing on a worker.

    `added` are keys of blobs that will be there before it.
    """
    best, least = None, -1
    for task in islice(source.values(), AFFINITY_WINDOW):
        lacking = _size(task.lacking_blobs(worker, added))
        if best is None or lacking < least:
            best, least = task, lacking
        if not least:
            break
    assert best is not None  # noqa: S101 - for mypy
    return best


def find_holder(
    source: OrderedDict[int, Task], workers: Sequence[Worker], chosen: Worker
) -> Worker:
    """Return who is idle and has all that the next task needs, if anyone; else the chosen worker.

    Of several the one that has least besides: what the others have is asked for there.
    """
    task = find_closest(source, chosen)
    if not task.blobs:
        return chosen
    holders = [
        worker
        for worker in workers
        if (worker is chosen or not worker.batches)
        and worker.next_s <= MOST_DETOUR * chosen.next_s
        and not task.lacking_blobs(worker)
    ]
    return min(holders, key=lambda worker: len(worker.blobs), default=chosen)
