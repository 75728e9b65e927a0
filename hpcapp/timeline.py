"""What a job did and when: the master's stages, and every task with its worker, as spans.

::

    StageClock ─────────── the master's stages ───┐
    communicator ── answers, losses, refusals ────┼──> Timeline ──> report, Chrome trace, dashboard
    other backends ── answers, losses ────────────┘

Spans are recorded when they end, from any thread, and read at any time: one append each.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import asdict
from typing import Any

from hpccomponent.dataclass import dataclass

MASTER = "master"
"""The worker of the master's own stages."""

ANY_WORKER = "worker"
"""The worker of a task where the backend does not tell which one it was."""


@dataclass(frozen=True, slots=True)
class Span:
    """A stage of the master, or a task on a worker.

    Parameters
    ----------
    worker : str
        `MASTER`, a worker's name, or `ANY_WORKER`.
    begin, end : float
        In seconds since the job's start.
    outcome : str
        ``done``; ``failed`` where it raised; ``lost`` where its worker was lost, so that it ran
        again; ``repeated`` where another worker had answered before; ``refused`` where the worker,
        or what it sent, was not accepted.
    bytes_in, bytes_out : int
        What the master received for it and sent for it, in bytes; 0 where nothing travels.
    """

    name: str
    worker: str
    begin: float
    end: float
    outcome: str = "done"
    bytes_in: int = 0
    bytes_out: int = 0


@dataclass(frozen=True, slots=True)
class WorkerState:
    """What a worker does at the moment.

    It is ``busy``, ``idle``, ``leaving`` (it gets nothing new) or ``retired`` (for the job). The
    task is the one at hand, or the last without an answer; empty where it has nothing.
    """

    name: str
    state: str
    task: str = ""


def _nobody() -> list[WorkerState]:
    return []


class Timeline:
    """The spans of one job, in the order in which they ended.

    Attributes
    ----------
    list_workers : callable
        Returns a `WorkerState` for each worker that the backend knows now; set by the backend.

    Examples
    --------
    >>> timeline = Timeline(iter([10.0, 12.5]).__next__)
    >>> timeline.record("fit_tile", "worker-1", 2.0)
    >>> timeline.spans[0].begin, timeline.spans[0].end
    (0.5, 2.5)
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.spans: list[Span] = []
        self.list_workers: Callable[[], list[WorkerState]] = _nobody
        self._clock = clock
        self._start = clock()

    def now(self) -> float:
        """Return the seconds since the job's start."""
        return self._clock() - self._start

    def record(
        self,
        name: str,
        worker: str,
        seconds: float,
        outcome: str = "done",
        *,
        ago: float = 0.0,
        bytes_in: int = 0,
        bytes_out: int = 0,
    ) -> None:
        """Add a span that ended some seconds ago.

        It took so many seconds by the worker's own clock; it begins with the job at the earliest.
        """
        end = max(0.0, self.now() - ago)
        begin = max(0.0, end - max(0.0, seconds))
        self.spans.append(Span(name, worker, begin, end, outcome, bytes_in, bytes_out))

    def to_json(self) -> dict[str, list[dict[str, Any]]]:
        """Return the spans as JSON values: ``spans``, times rounded to the microsecond."""
        spans = [asdict(span) for span in list(self.spans)]
        for span in spans:
            span["begin"], span["end"] = round(span["begin"], 6), round(span["end"], 6)
        return {"spans": spans}


def note_worker(future: Future[Any], worker: str | None) -> None:
    """Note at a future who has done its task, before it is done."""
    vars(future)["worker"] = worker


def find_worker(future: Future[Any]) -> str | None:
    """Return who has done the task of a future."""
    worker: str | None = vars(future).get("worker")
    return worker
