"""Policies: which worker gets the next tasks. A policy is a class with one method.

Below a policy, the scheduler cuts what it is given by bytes and by expected time, keeps to the
credit window, and puts tasks of lost workers back into the queue.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Mapping, Sequence
from typing import ClassVar, Protocol

from hpccomponent.dataclass import dataclass

DEPTH = 2  # batches that a worker holds at most, the adaptive way
AHEAD_S = 1.0  # so long before its end the next batch may leave


class Load(Protocol):
    """What a policy sees of a worker."""

    @property
    def queued(self) -> int:
        """Return how many batches the worker holds, at work or on their way."""
        ...

    @property
    def placed(self) -> int:
        """Return how many tasks the worker has been given since it came."""
        ...

    @property
    def remaining_s(self) -> float:
        """Return how long it is expected to have to do, in seconds; infinite if unknown."""
        ...

    @property
    def next_s(self) -> float:
        """Return how long the next task would take on it, in seconds; infinite if unknown."""
        ...

    @property
    def slowness(self) -> float:
        """Return how long it has taken so far, in a unit that all loads share; 1 if unknown."""
        ...


@dataclass(frozen=True, slots=True)
class TaskPlacement:
    """The policy's choice.

    With `is_fixed` all of the tasks wait for this worker, even where its credit window is full;
    else one batch of them leaves now, and what does not fit stays with the others.
    """

    worker: int
    tasks: int
    is_fixed: bool = False


class Policy(Protocol):
    """The seam: one way to spread tasks over workers."""

    batches_per_worker: ClassVar[int]
    """Into so many batches for each worker an application cuts its work."""

    @property
    def is_speculative(self) -> bool:
        """Tell whether idle workers run stragglers a second time."""
        ...

    def place(self, waiting: int, loads: Sequence[Load]) -> TaskPlacement | None:
        """Choose the worker for the next of `waiting` tasks, or nobody for now.

        Called until it says nobody, or nothing waits; `loads` is in the order of registration
        and never empty.
        """
        ...


class EqualPolicy:
    """The paper's: every worker gets the same number of tasks, fixed in advance.

    Tasks go round robin to the workers that are there when they are submitted, so wait for all
    workers first. Only what a lost worker leaves is spread anew.
    """

    is_speculative = False
    batches_per_worker: ClassVar[int] = 1

    def place(self, waiting: int, loads: Sequence[Load]) -> TaskPlacement | None:
        """Choose the worker that has been given the fewest tasks."""
        del waiting
        fewest = min(range(len(loads)), key=lambda i: loads[i].placed)
        return TaskPlacement(fewest, 1, is_fixed=True)


class PullPolicy:
    """Workers are given work as they finish it, in levelled queues.

    Every worker gets one batch before any gets a second: filling one worker's queue first puts all
    large batches there. Batches shrink as the queue does (guided self-scheduling). A worker holds
    at most `depth` batches: one runs, the others hide the way.
    """

    is_speculative = False
    batches_per_worker: ClassVar[int] = 4

    def __init__(self, depth: int = 2) -> None:
        self.depth = depth

    def place(self, waiting: int, loads: Sequence[Load]) -> TaskPlacement | None:
        """Choose the worker with the shortest queue, unless that is full too."""
        shortest = min(range(len(loads)), key=lambda i: loads[i].queued)
        if loads[shortest].queued >= self.depth:
            return None
        return TaskPlacement(shortest, -(-waiting // (4 * len(loads))))


class AdaptivePolicy:
    """Workers are given work by how fast they have shown to be.

    The worker that would have the next task done first gets it, with others that share its
    batch: a quarter of what is its share by speed. A second batch follows only when the first is
    about to end: it hides the way, and what waits here can still go to anyone; towards the end,
    when there is less than a task for each worker, none follows. A worker that
    would be done with a task after the others have done all of them gets none.
    """

    is_speculative = True
    batches_per_worker: ClassVar[int] = 4

    def place(self, waiting: int, loads: Sequence[Load]) -> TaskPlacement | None:
        """Choose the worker that has the next task done first, if any has room for it."""
        most = DEPTH if waiting >= len(loads) else 1  # the last ones go to whoever is idle first
        free = [i for i, load in enumerate(loads) if _has_room(load, most)]
        if not free:
            return None
        chosen = min(free, key=lambda i: (loads[i].remaining_s + loads[i].next_s, loads[i].queued))
        load = loads[chosen]
        if math.isinf(load.next_s):  # nothing is known of such tasks: one each
            idle = [i for i in free if loads[i].queued == 0]
            return TaskPlacement(min(idle, key=lambda i: loads[i].slowness), 1) if idle else None
        others = [*loads[:chosen], *loads[chosen + 1 :]]
        if load.remaining_s + load.next_s > _time_of(others, waiting):
            return None
        share = 1.0 / load.next_s / sum(1.0 / load.next_s for load in loads)
        return TaskPlacement(chosen, max(1, math.ceil(waiting * share / 4.0)))


def _has_room(load: Load, most: int) -> bool:
    """Tell whether one of at most so many batches may leave for a worker."""
    return load.queued == 0 or (load.queued < most and load.remaining_s < AHEAD_S)


def _time_of(loads: Sequence[Load], waiting: int) -> float:
    """Return when these workers would be done with what they have and all that waits."""
    if not loads:
        return math.inf
    if waiting > 2 * len(loads):  # many: as if they could be cut at will
        work = sum(load.remaining_s / load.next_s for load in loads) + waiting
        return work / sum(1.0 / load.next_s for load in loads)
    ends = [(load.remaining_s + load.next_s, load.next_s) for load in loads]
    heapq.heapify(ends)
    last_s = 0.0
    for _ in range(waiting):
        last_s, next_s = ends[0]
        heapq.heapreplace(ends, (last_s + next_s, next_s))
    return last_s


POLICIES: Mapping[str, type[Policy]] = {
    "adaptive": AdaptivePolicy,
    "pull": PullPolicy,
    "equal": EqualPolicy,
}
DEFAULT_POLICY = "adaptive"
