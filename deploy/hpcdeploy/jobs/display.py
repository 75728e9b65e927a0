"""How a job is shown while somebody watches: what it says, and on a terminal a bar as well."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TextIO
from urllib.parse import urlsplit

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

__all__ = ["ForwardingDisplay", "JobDisplay", "open_display"]

log = logging.getLogger("hpcapp")


class JobDisplay:
    """Shows what a job says, line by line."""

    def show_log(self, line: str) -> None:
        """Show a line that the job has written.

        Parameters
        ----------
        line : str
        """
        log.info("%s", line)

    def show_event(self, event: dict[str, Any]) -> None:
        """Show how far a stage has come.

        Parameters
        ----------
        event : dict
            ``stage``, and how much of it is ``done`` of ``total``; ``is_bytes`` where that is
            bytes; or ``dashboard``, the address of the job's page on the head.
        """

    def show_bytes(self, stage: str, done: int, total: int) -> None:
        """Show how much of a file has been sent or fetched.

        Parameters
        ----------
        stage : str
            What the bar is called.
        done, total : int
            In bytes.
        """
        self.show_event({"stage": stage, "done": done, "total": total, "is_bytes": True})


class BarDisplay(JobDisplay):
    """Shows a bar for the present stage too, drawn by rich."""

    def __init__(self, bars: Progress) -> None:
        self._bars = bars
        self._task: TaskID | None = None
        self._stage = ""

    def show_event(self, event: dict[str, Any]) -> None:
        """Move the bar; the next stage takes the place of the one that has ended.

        Parameters
        ----------
        event : dict
            As `JobDisplay.show_event` takes it; without ``done`` the bar stays as it is.
        """
        if "done" not in event:
            return
        if self._task is None or self._stage != event["stage"]:
            if self._task is not None:
                self._bars.remove_task(self._task)
            self._stage = event["stage"]
            is_bytes = event.get("is_bytes", False)
            self._task = self._bars.add_task(self._stage, total=None, is_bytes=is_bytes)
        self._bars.update(self._task, completed=event["done"], total=event["total"] or None)


class ForwardingDisplay(JobDisplay):
    """Makes the job's page on the head one of this machine, beside another display.

    Parameters
    ----------
    display : JobDisplay
        The other one.
    forward : callable
        From a port on the head's loopback to one here that leads there.
    """

    def __init__(self, display: JobDisplay, forward: Callable[[int], int]) -> None:
        self._display = display
        self._forward = forward
        self.has_page = False

    def show_log(self, line: str) -> None:
        """Show a line that the job has written.

        Parameters
        ----------
        line : str
        """
        self._display.show_log(line)

    def show_event(self, event: dict[str, Any]) -> None:
        """Show how far a stage has come, or where the page is.

        Parameters
        ----------
        event : dict
            As `JobDisplay.show_event` takes it.
        """
        if "dashboard" not in event:
            self._display.show_event(event)
            return
        parts = urlsplit(str(event["dashboard"]))
        port = self._forward(parts.port or 0)
        log.info("dashboard: http://127.0.0.1:%d/?%s", port, parts.query)
        self.has_page = True


@contextmanager
def open_display(stream: TextIO) -> Iterator[JobDisplay]:
    """Yield the display that fits `stream`.

    Parameters
    ----------
    stream : TextIO

    Yields
    ------
    JobDisplay
        With a bar where `stream` is a terminal.
    """
    if not stream.isatty():
        yield JobDisplay()
        return
    from hpccomponent.bars import make_bars

    with make_bars(stream, is_transient=True) as bars:
        yield BarDisplay(bars)
