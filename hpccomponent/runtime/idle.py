"""What is left to be done while a worker has nothing else to do.

A task that returns early lets the master go on with what needs its result; what is left may save
time in a later task, and is never needed. A worker that has had no task yet imports all of them.
A worker process has such time, and a master that waits for results; elsewhere nothing is kept.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import suppress

__all__ = ["IdleWork", "idle_work"]


class IdleWork:
    """Work that waits for time, first come, first served."""

    def __init__(self) -> None:
        self._waiting: deque[Callable[[], bool]] = deque()
        self._is_served = False

    def serve(self) -> None:
        """Say that this process will call `run_one`."""
        self._is_served = True

    def add(self, step: Callable[[], bool]) -> None:
        """Leave some work; it must matter to nobody if it is never done, or fails half-way.

        Parameters
        ----------
        step : callable
            Does a short piece of it, and returns whether there is more: a task that comes meanwhile
            waits for the piece.
        """
        if self._is_served:
            self._waiting.append(step)

    def __bool__(self) -> bool:
        """Tell whether there is any."""
        return bool(self._waiting)

    def run_one(self) -> None:
        """Do one piece of work."""
        is_more = False
        with suppress(Exception):
            is_more = self._waiting[0]()
        if not is_more:
            self._waiting.popleft()


idle_work = IdleWork()
"""Of this process, where it is a worker."""
