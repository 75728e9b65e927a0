"""What a page can know of a job: filled by the job, read by the server's thread."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager

from hpcapp.dashboard.viewers import Viewers
from hpcapp.progress import LoadPart, ProgressObserver
from hpcapp.timeline import Timeline
from hpccomponent.dataclass import dataclass

MOST_LINES = 500  # of the log; older ones are forgotten
MOST_PARTS = 4096  # that are shown; later ones are counted only


@dataclass(frozen=True, slots=True)
class Stage:
    """The stage that a job is in, which begins so many seconds after the job's start.

    Of `total` parts `done` are done; 0 where it does not tell.
    """

    name: str
    done: int
    total: int
    begin: float


class WatchedJob(ProgressObserver):
    """A job that is watched, and fills the timeline.

    Its title is what it does, in a few words; `state` is ``running``, ``done`` or ``failed``.
    `lines` are the last of the log, each with its number. `loads` return a part of the mesh each,
    of the `parts` that have come; `viewers` are the pages that are open.
    """

    shows_parts = True

    def __init__(self, timeline: Timeline, title: str) -> None:
        self.timeline = timeline
        self.title = title
        self.state = "running"
        self.stage: Stage | None = None
        self.lines: deque[tuple[int, str]] = deque(maxlen=MOST_LINES)
        self.loads: list[LoadPart] = []
        self.parts = 0
        self.viewers = Viewers()
        self._count = 0

    def say(self, line: str) -> None:
        """Take a line of the log."""
        self._count += 1
        self.lines.append((self._count, line))

    def on_begin(self, stage: str) -> None:
        """Show a new stage."""
        self.stage = Stage(stage, 0, 0, self.timeline.now())

    def on_advance(self, stage: str, done: int, total: int) -> None:
        """Show how far the stage has come."""
        if self.stage is not None:
            self.stage = Stage(stage, done, total, self.stage.begin)

    def on_end(self, stage: str, seconds: float) -> None:
        """Show that a stage is over."""
        del stage, seconds
        self.stage = None

    def on_part(self, load: LoadPart) -> None:
        """Show a part of the mesh, which is loaded when a page asks for it, if ever."""
        if len(self.loads) < MOST_PARTS:
            self.loads.append(load)
        self.parts += 1

    def on_last_part(self) -> None:
        """Wait, for a bounded time, until open pages have all parts."""
        self.viewers.wait(len(self.loads))

    @contextmanager
    def running(self) -> Iterator[None]:
        """Take what the program logs, while the job runs in the block, and how the job ends."""
        handler = _LogRelay(self)
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


class _LogRelay(logging.Handler):
    """Hands what is logged to a watched job."""

    def __init__(self, job: WatchedJob) -> None:
        super().__init__(logging.INFO)
        self._job = job

    def emit(self, record: logging.LogRecord) -> None:
        """Hand one record on."""
        self._job.say(record.getMessage())
