"""Displays of progress: bars on a terminal, a line now and then elsewhere; always on stderr.

Besides, `open_events` writes what another program may read: one JSON object a line, either
``{"stage": NAME, "done": N, "total": N}`` or, at its end, ``{"stage": NAME, "seconds": S}``;
before them ``{"dashboard": ADDRESS}`` where the job has a page.
"""

from __future__ import annotations

import contextlib
import json
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from hpcapp.progress import Progress
from hpccomponent.errors import OutputError

if TYPE_CHECKING:
    from rich.progress import Progress as Bars
    from rich.progress import TaskID

__all__ = [
    "LINE_PERIOD_S",
    "BarProgress",
    "EventProgress",
    "LineProgress",
    "open_events",
    "open_progress",
]

LINE_PERIOD_S = 10.0


class LineProgress:
    """Writes a line when a long stage goes on, and one when it ends.

    Parameters
    ----------
    stream : file
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._stage = ""
        self._start = 0.0
        self._next_line = 0.0

    def begin(self, stage: str) -> None:
        """Remember the stage; a short one is announced at its end only."""
        self._stage, self._start = stage, time.monotonic()
        self._next_line = self._start + LINE_PERIOD_S

    def advance(self, done: int, total: int) -> None:
        """Write a line where `LINE_PERIOD_S` have passed since the last.

        Parameters
        ----------
        done, total : int
            Parts of the current stage.
        """
        now = time.monotonic()
        if now >= self._next_line:
            self._next_line = now + LINE_PERIOD_S
            self._write(
                f"{self._stage}: {done} of {total}{_foresee(done, total, now - self._start)}"
            )

    def end(self, stage: str, seconds: float) -> None:
        """Write how long the stage took."""
        self._write(f"{stage}: done in {seconds:.2f} s")

    def show_part(self, load: Callable[[], Any]) -> None:
        """Show nothing: a part is nothing for a line of text."""

    def wait_for_viewers(self) -> None:
        """Wait for nobody."""

    def _write(self, line: str) -> None:
        with contextlib.suppress(OSError):  # a full or closed stderr must not end the job
            self._stream.write(line + "\n")
            self._stream.flush()


def _foresee(done: int, total: int, elapsed_s: float) -> str:
    """Say how fast a stage is and how long it will take, once something is done."""
    if not done:
        return ""
    from hpccomponent.bars import say_rate, say_seconds

    left_s = elapsed_s / done * (total - done)
    return f", {say_rate(done / elapsed_s)}, {say_seconds(left_s)} left"


class BarProgress:
    """One bar per stage, drawn by rich."""

    def __init__(self, bars: Bars) -> None:
        self._bars = bars
        self._task: TaskID | None = None
        self._total = 1

    def begin(self, stage: str) -> None:
        """Draw a new bar.

        Parameters
        ----------
        stage : str
            The bar's label.
        """
        self._task, self._total = self._bars.add_task(stage, total=None), 1

    def advance(self, done: int, total: int) -> None:
        """Move the bar.

        Parameters
        ----------
        done, total : int
            Parts of the current stage.
        """
        if self._task is not None:
            self._total = total
            self._bars.update(self._task, completed=done, total=total)

    def end(self, stage: str, seconds: float) -> None:
        """Fill the bar.

        Parameters
        ----------
        stage, seconds
            Not shown: the bar counts the time itself.
        """
        del stage, seconds
        if self._task is not None:
            self._bars.update(self._task, completed=self._total, total=self._total)
            self._bars.stop_task(self._task)

    def show_part(self, load: Callable[[], Any]) -> None:
        """Show nothing: a part is nothing for a bar."""

    def wait_for_viewers(self) -> None:
        """Wait for nobody."""


class EventProgress:
    """Writes each step as a line of JSON, and shows it on another display too.

    Parameters
    ----------
    stream : file
    display : Progress
        The other one.
    dashboard : str, optional
        Address of the job's page: the first event.
    """

    def __init__(self, stream: TextIO, display: Progress, dashboard: str | None = None) -> None:
        self._stream = stream
        self._display = display
        self._stage = ""
        if dashboard is not None:
            self._write({"dashboard": dashboard})

    def begin(self, stage: str) -> None:
        """Write that nothing is done yet."""
        self._stage = stage
        self._write({"stage": stage, "done": 0, "total": 0})
        self._display.begin(stage)

    def advance(self, done: int, total: int) -> None:
        """Write how far the stage has come.

        Parameters
        ----------
        done, total : int
            Parts of the current stage.
        """
        self._write({"stage": self._stage, "done": done, "total": total})
        self._display.advance(done, total)

    def end(self, stage: str, seconds: float) -> None:
        """Write how long the stage took.

        Parameters
        ----------
        seconds : float
            Written to the microsecond.
        """
        self._write({"stage": stage, "seconds": round(seconds, 6)})
        self._display.end(stage, seconds)

    def show_part(self, load: Callable[[], Any]) -> None:
        """Pass a part on: it is nothing for a line of JSON."""
        self._display.show_part(load)

    def wait_for_viewers(self) -> None:
        """Let the other display wait."""
        self._display.wait_for_viewers()

    def _write(self, event: dict[str, Any]) -> None:
        with contextlib.suppress(OSError):  # a full disk must not end the job here
            self._stream.write(json.dumps(event) + "\n")
            self._stream.flush()


def _open_if_read(name: str, flags: int) -> int:
    """Open a file; of a pipe that nobody reads it is an error, and not waited for."""
    descriptor = os.open(name, flags | os.O_NONBLOCK, 0o666)
    os.set_blocking(descriptor, True)
    return descriptor


@contextmanager
def open_events(
    path: Path | None, display: Progress, dashboard: str | None = None
) -> Iterator[Progress]:
    """Yield a display that writes events to the file `path` as well, if there is one.

    Parameters
    ----------
    path : Path or None
        A file that is written anew, or a pipe that somebody reads.
    display : Progress
        The one that is yielded where there is no file, else shown to as well.
    dashboard : str, optional
        Address of the job's page: the first event.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    if path is None:
        yield display
        return
    try:
        stream = open(path, "w", encoding="utf-8", opener=_open_if_read)  # noqa: SIM115
    except OSError as error:
        raise OutputError(
            f"{path}: cannot be written ({error.strerror})", "give another --events"
        ) from error
    try:
        yield EventProgress(stream, display, dashboard)
    finally:
        with contextlib.suppress(OSError):  # what is left to write, likewise
            stream.close()


@contextmanager
def open_progress(stream: TextIO) -> Iterator[Progress]:
    """Yield the display that fits `stream`: bars where it is a terminal, lines elsewhere.

    Parameters
    ----------
    stream : file
        For text, such as stderr; stays open.
    """
    if not stream.isatty():
        yield LineProgress(stream)
        return
    from hpccomponent.bars import make_bars

    with make_bars(stream) as bars:
        yield BarProgress(bars)
