"""An Executor of this process whose tasks are recorded in a job's timeline."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future
from typing import TypeVar

from hpcapp.timeline import ANY_WORKER, Timeline

__all__ = ["RecordedExecutor"]

T = TypeVar("T")


class RecordedExecutor(Executor):
    """Submits to another Executor, whose threads are the workers of the timeline.

    Parameters
    ----------
    executor : concurrent.futures.Executor
        Of this process; stays open.
    timeline : Timeline
    """

    def __init__(self, executor: Executor, timeline: Timeline) -> None:
        self._executor = executor
        self._timeline = timeline

    def submit(self, fn: Callable[..., T], /, *args: object, **kwargs: object) -> Future[T]:
        """Have a task run, and recorded.

        Parameters
        ----------
        fn : callable
        *args, **kwargs
            Its arguments.

        Returns
        -------
        concurrent.futures.Future
        """
        submitter = threading.get_ident()

        def run() -> T:
            timeline, begin, outcome = self._timeline, self._timeline.now(), "failed"
            is_here = threading.get_ident() == submitter
            worker = ANY_WORKER if is_here else threading.current_thread().name
            try:
                result = fn(*args, **kwargs)
                outcome = "done"
                return result
            finally:
                timeline.record(_name(fn), worker, timeline.now() - begin, outcome)

        return self._executor.submit(run)


def _name(task: Callable[..., object]) -> str:
    return getattr(task, "__name__", repr(task))
