"""Policies: which worker gets the next tasks. A policy is a class with one method.

Below a policy, the scheduler cuts what it is given by bytes and by expected time, keeps to the
credit window, and puts tasks of lost workers back into the queue.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

__all__ = ["EqualPolicy", "Load", "Placement", "Policy", "PullPolicy"]


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


@dataclass(frozen=True, slots=True)
class Placement:
    """The policy's choice.

    Parameters
    ----------
    worker : int
        Index into the loads.
    tasks : int
        How many tasks it gets, at most.
    is_fixed : bool
        Whether all of them wait for this worker, even where its credit window is full;
        otherwise one batch of them leaves now, and what does not fit stays with the others.
    """

    worker: int
    tasks: int
    is_fixed: bool = False


class Policy(Protocol):
    """The seam: one way to spread tasks over workers."""

    def place(self, waiting: int, loads: Sequence[Load]) -> Placement | None:
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

    def place(self, waiting: int, loads: Sequence[Load]) -> Placement | None:
        """Choose the worker that has been given the fewest tasks."""
        del waiting
        fewest = min(range(len(loads)), key=lambda i: loads[i].placed)
        return Placement(fewest, 1, is_fixed=True)


class PullPolicy:
    """Workers are given work as they finish it, in levelled queues.

    Every worker gets one batch before any gets a second: filling one worker's queue first puts
    all large batches there. Batches shrink as the queue does (guided self-scheduling).

    Parameters
    ----------
    depth : int
        Batches that a worker holds at most: one runs, the others hide the way.
    """

    def __init__(self, depth: int = 2) -> None:
        self.depth = depth

    def place(self, waiting: int, loads: Sequence[Load]) -> Placement | None:
        """Choose the worker with the shortest queue, unless that is full too."""
        shortest = min(range(len(loads)), key=lambda i: loads[i].queued)
        if loads[shortest].queued >= self.depth:
            return None
        return Placement(shortest, -(-waiting // (4 * len(loads))))
