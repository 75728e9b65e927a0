"""An Executor of this process whose tasks are recorded in a job's timeline."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import TypeVar

from hpcapp.timeline import ANY_WORKER, Timeline, WorkerState

T = TypeVar("T")


class RecordedExecutor(Executor):
    """Submits to another Executor of this process, whose threads are the workers of the timeline.

    That one stays open.
    """

    def __init__(self, executor: Executor, timeline: Timeline) -> None:
        self._executor = executor
        self._timeline = timeline
        self._running: dict[str, str] = {}
        timeline.list_workers = self._list_workers

    def submit(self, fn: Callable[..., T], /, *args: object, **kwargs: object) -> Future[T]:
        """Have a task run, and recorded."""
        submitter, name = threading.get_ident(), getattr(fn, "__name__", repr(fn))

        def run() -> T:
            timeline, begin, outcome = self._timeline, self._timeline.now(), "failed"
            is_here = threading.get_ident() == submitter
            worker = ANY_WORKER if is_here else threading.current_thread().name
            self._running[worker] = name
            try:
                result = fn(*args, **kwargs)
                outcome = "done"
                return result
            finally:
                self._running[worker] = ""
                timeline.record(name, worker, timeline.now() - begin, outcome)

        return self._executor.submit(run)

    def _list_workers(self) -> list[WorkerState]:
        running = sorted(dict(self._running).items())
        return [WorkerState(worker, "busy" if task else "idle", task) for worker, task in running]
