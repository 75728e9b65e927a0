"""How a job is shown while somebody watches: what it says, and on a terminal a bar as well."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

__all__ = ["JobDisplay", "open_display"]

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
            ``stage``, and how much of it is ``done`` of ``total``.
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
        self.show_event({"stage": stage, "done": done, "total": total})


class BarDisplay(JobDisplay):
    """Shows a bar for the present stage too, drawn by rich."""

    def __init__(self, bars: Progress) -> None:
        self._bars = bars
        self._task: TaskID | None = None

    def show_event(self, event: dict[str, Any]) -> None:
        """Move the bar; the next stage takes the place of the one that has ended.

        Parameters
        ----------
        event : dict
            As `JobDisplay.show_event` takes it; without ``done`` the bar stays as it is.
        """
        if self._task is None:
            self._task = self._bars.add_task("", total=None)
        if "done" in event:
            self._bars.update(
                self._task,
                description=event["stage"],
                completed=event["done"],
                total=event["total"] or None,
            )


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
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description:<12}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(file=stream), transient=True) as bars:
        yield BarDisplay(bars)
