"""How a job is shown while somebody watches: what it says, and on a terminal a bar as well."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated, TextIO

from msgspec import Meta

from hpccomponent.cli.verbosity import is_quiet
from hpccomponent.dataclass import dataclass

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID


log = logging.getLogger("hpcapp")

_Amount = Annotated[int, Meta(ge=0, le=1 << 60)]
_PORT = "([1-9][0-9]{0,3}|[1-5][0-9]{4}|6[0-4][0-9]{3}|65[0-4][0-9]{2}|655[0-2][0-9]|6553[0-5])"
_Address = Annotated[
    str,
    Meta(pattern=rf"^http://[0-9A-Za-z.:\[\]-]{{1,260}}:{_PORT}/\?token=[0-9A-Za-z_-]{{1,200}}\Z"),
]


@dataclass(frozen=True, slots=True)
class JobEvent:
    """How far a job has come, or where its page is.

    `done` of `total` are done of the stage, in bytes where `is_bytes`; `total` is 0 where that is
    not known. `dashboard` is the address of the job's page on the head.
    """

    stage: Annotated[str, Meta(pattern=r"^[ -~]{0,80}\Z")] = ""
    done: _Amount | None = None
    total: _Amount = 0
    is_bytes: bool = False
    dashboard: _Address | None = None


class JobDisplay:
    """Shows what a job says, line by line."""

    def show_log(self, line: str) -> None:
        """Show a line that the job has written."""
        log.info("%s", line)

    def show_event(self, event: JobEvent) -> None:
        """Show how far a stage has come."""

    def show_bytes(self, stage: str, done: int, total: int) -> None:
        """Show how many bytes of a file have been sent or fetched."""
        self.show_event(JobEvent(stage, done, total, is_bytes=True))


class BarDisplay(JobDisplay):
    """Shows a bar for the present stage too, drawn by rich."""

    def __init__(self, bars: Progress) -> None:
        self._bars = bars
        self._task: TaskID | None = None
        self._stage = ""

    def show_event(self, event: JobEvent) -> None:
        """Move the bar; the next stage takes the place of the one that has ended.

        Without `done` the bar stays as it is.
        """
        if event.done is None:
            return
        if self._task is None or self._stage != event.stage:
            if self._task is not None:
                self._bars.remove_task(self._task)
            self._stage = event.stage
            self._task = self._bars.add_task(self._stage, total=None, is_bytes=event.is_bytes)
        self._bars.update(self._task, completed=event.done, total=event.total or None)


class ForwardingDisplay(JobDisplay):
    """Makes the job's page on the head one of this machine, beside another display.

    `forward` leads from a port on the head's loopback to one here, which it returns.
    """

    def __init__(self, display: JobDisplay, forward: Callable[[int], int]) -> None:
        self._display = display
        self._forward = forward
        self.has_page = False

    def show_log(self, line: str) -> None:
        """Show a line that the job has written."""
        self._display.show_log(line)

    def show_event(self, event: JobEvent) -> None:
        """Show how far a stage has come, or where the page is; a job has one."""
        if event.dashboard is None or self.has_page:
            self._display.show_event(event)
            return
        place, _, query = event.dashboard.partition("/?")
        port = self._forward(int(place.rpartition(":")[2]))
        log.info("dashboard: http://127.0.0.1:%d/?%s", port, query)
        self.has_page = True


@contextmanager
def open_display(stream: TextIO) -> Iterator[JobDisplay]:
    """Yield the display that fits `stream`: one with a bar where it is a terminal."""
    if is_quiet() or not stream.isatty():
        yield JobDisplay()
        return
    from hpccomponent.cli.bars import make_bars

    with make_bars(stream, is_transient=True) as bars:
        yield BarDisplay(bars)
