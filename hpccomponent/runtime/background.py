"""Work done while a process waits: for a worker's next task, for the results that a master needs.

A task that returns early lets the master go on with what needs its result; what is left may save
time in a later task, and is never needed. A process that never waits keeps nothing.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future
from contextlib import suppress
from typing import Any, Generic, TypeVar

Result = TypeVar("Result")


class Deferred(Generic[Result]):
    """A value that will be asked for, and may be found in the background before that.

    `find` finds it, from nothing that changes, and is called once, unless it raises.
    """

    def __init__(self, find: Callable[[], Result]) -> None:
        self._find = find
        self._found: list[Result] = []

    def __call__(self) -> Result:
        """Return it, found by now or not."""
        if not self._found:
            self._found.append(self._find())
        return self._found[0]


class Background:
    """Steps of work that wait for time, first come, first served; none is kept unless enabled.

    It is enabled where this process ever waits.
    """

    def __init__(self, is_enabled: bool = False) -> None:
        self._steps: deque[Callable[[], bool]] = deque()
        self._is_enabled = is_enabled

    def enable(self) -> None:
        """Say that this process will call `run_one`."""
        self._is_enabled = True

    def add(self, step: Callable[[], bool]) -> None:
        """Leave some work; it must matter to nobody if it is never done, or fails half-way.

        `step` does a short piece, for which others wait, and returns whether there is more.
        """
        if self._is_enabled:
            self._steps.append(step)

    def defer(self, find: Callable[[], Result]) -> Deferred[Result]:
        """Leave a value to be found; see `Deferred`."""
        deferred = Deferred(find)

        def step() -> bool:
            deferred()
            return False

        self.add(step)
        return deferred

    def __bool__(self) -> bool:
        """Tell whether there is any work."""
        return bool(self._steps)

    def run_one(self) -> None:
        """Do one step."""
        is_more = False
        with suppress(Exception):
            is_more = self._steps[0]()
        if not is_more:
            self._steps.popleft()

    def run_until(self, futures: Iterable[Future[Any]]) -> None:
        """Do steps as long as none of some futures is done."""
        while self and not any(future.done() for future in futures):
            self.run_one()


worker_background = Background()
"""Of this process, where it is a worker."""
