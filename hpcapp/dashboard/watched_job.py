"""What a page can know of a job: filled by the job, read by the server's thread."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from hpcapp.dashboard.viewers import Viewers
from hpcapp.progress import Progress
from hpcapp.timeline import Timeline

if TYPE_CHECKING:
    from hpcapp.dashboard.parts import Part

__all__ = ["Stage", "WatchedJob", "WatchedProgress"]

MOST_LINES = 500  # of the log; older ones are forgotten
MOST_PARTS = 4096  # that are shown; later ones are counted only


@dataclass(frozen=True, slots=True)
class Stage:
    """The stage that a job is in.

    Parameters
    ----------
    done, total : int
        Parts; 0 where it does not tell.
    begin : float
        In seconds since the job's start.
    """

    name: str
    done: int
    total: int
    begin: float


class WatchedJob:
    """A job that is watched.

    Parameters
    ----------
    timeline : Timeline
        That the job fills.
    title : str
        What it does, in a few words.

    Attributes
    ----------
    state : str
        ``running``, ``done`` or ``failed``.
    stage : Stage or None
        The present one.
    lines : deque of (int, str)
        The last lines of the log, each with its number.
    loads : list of callable
        Each returns a part of the mesh.
    parts : int
        How many have come.
    viewers : Viewers
        The pages that are open.
    """

    def __init__(self, timeline: Timeline, title: str) -> None:
        self.timeline = timeline
        self.title = title
        self.state = "running"
        self.stage: Stage | None = None
        self.lines: deque[tuple[int, str]] = deque(maxlen=MOST_LINES)
        self.loads: list[Callable[[], Part]] = []
        self.parts = 0
        self.viewers = Viewers()
        self._count = 0

    def say(self, line: str) -> None:
        """Take a line of the log."""
        self._count += 1
        self.lines.append((self._count, line))

    @contextmanager
    def running(self) -> Iterator[None]:
        """Take what the program logs, while the job runs in the block, and how the job ends."""
        handler = _Lines(self)
        logger = logging.getLogger("hpcapp")
        logger.addHandler(handler)
        try:
            yield
            self.state = "done"
        except BaseException as error:
            self.state = "failed"
            self.say(f"{type(error).__name__}: {error}")
            raise
        finally:
            logger.removeHandler(handler)


class _Lines(logging.Handler):
    """Hands what is logged to a watched job."""

    def __init__(self, job: WatchedJob) -> None:
        super().__init__(logging.INFO)
        self._job = job

    def emit(self, record: logging.LogRecord) -> None:
        """Hand one record on."""
        self._job.say(record.getMessage())


class WatchedProgress:
    """Tells a watched job of stages and parts, and another display too."""

    def __init__(self, job: WatchedJob, display: Progress) -> None:
        self._job = job
        self._display = display

    def begin(self, stage: str) -> None:
        """Show a new stage."""
        self._job.stage = Stage(stage, 0, 0, self._job.timeline.now())
        self._display.begin(stage)

    def advance(self, done: int, total: int) -> None:
        """Show how many parts of the current stage are done."""
        stage = self._job.stage
        if stage is not None:
            self._job.stage = replace(stage, done=done, total=total)
        self._display.advance(done, total)

    def end(self, stage: str, seconds: float) -> None:
        """Show that a stage is over."""
        self._job.stage = None
        self._display.end(stage, seconds)

    def show_part(self, load: Callable[[], Part]) -> None:
        """Show a part of the mesh.

        Parameters
        ----------
        load : callable
            Called when a page asks for the part, if ever.
        """
        if len(self._job.loads) < MOST_PARTS:
            self._job.loads.append(load)
        self._job.parts += 1
        self._display.show_part(load)

    def wait_for_viewers(self) -> None:
        """Wait, for a bounded time, until open pages have all parts."""
        self._job.viewers.wait(len(self._job.loads))
        self._display.wait_for_viewers()
