"""An Executor that remembers its tasks."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import ParamSpec, TypeVar, cast

P = ParamSpec("P")
R = TypeVar("R")


class Recorder(ThreadPoolExecutor):
    """Runs tasks on threads, and remembers their names and what comes of each."""

    def __init__(self, workers: int) -> None:
        super().__init__(workers)
        self.tasks: list[tuple[str, Future[object]]] = []

    def submit(self, fn: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        future = super().submit(fn, *args, **kwargs)
        self.tasks.append((fn.__name__, cast("Future[object]", future)))
        return future
