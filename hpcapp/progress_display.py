"""Displays of progress: bars on a terminal, a line now and then elsewhere; always on stderr.

Besides, `open_events` writes what another program may read: one JSON object a line, either
``{"stage": NAME, "done": N, "total": N}`` or, at its end, ``{"stage": NAME, "seconds": S}``;
before them ``{"dashboard": ADDRESS}`` where the job has a page.
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TextIO

from hpcapp.progress import ProgressObserver
from hpccomponent.cli.verbosity import is_quiet
from hpccomponent.errors import OutputError
from hpccomponent.files.private_files import open_if_read

if TYPE_CHECKING:
    from rich.progress import Progress as Bars
    from rich.progress import TaskID


LINE_PERIOD_S = 10.0


class ProgressLines(ProgressObserver):
    """Writes a line now and then while a long stage goes on, and one when a stage ends."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._start = 0.0
        self._next_line = 0.0

    def on_begin(self, stage: str) -> None:
        """Note the time; a short stage is announced at its end only."""
        del stage
        self._start = time.monotonic()
        self._next_line = self._start + LINE_PERIOD_S

    def on_advance(self, stage: str, done: int, total: int) -> None:
        """Write a line where `LINE_PERIOD_S` have passed since the last."""
        now = time.monotonic()
        if now >= self._next_line:
            self._next_line = now + LINE_PERIOD_S
            forecast = _foresee(done, total, now - self._start)
            _write_line(self._stream, f"{stage}: {done} of {total}{forecast}")

    def on_end(self, stage: str, seconds: float) -> None:
        """Write how long the stage took."""
        _write_line(self._stream, f"{stage}: done in {seconds:.2f} s")


def _write_line(stream: TextIO, line: str) -> None:
    with contextlib.suppress(OSError):  # a full disk or a closed stderr must not end the job
        stream.write(line + "\n")
        stream.flush()


def _foresee(done: int, total: int, elapsed_s: float) -> str:
    """Say how fast a stage is and how long it will take, once something is done."""
    if not done:
        return ""
    from hpccomponent.cli.bars import say_rate, say_seconds

    left_s = elapsed_s / done * (total - done)
    return f", {say_rate(done / elapsed_s)}, {say_seconds(left_s)} left"


class ProgressBars(ProgressObserver):
    """Draws one bar per stage, which counts the time itself."""

    def __init__(self, bars: Bars) -> None:
        self._bars = bars
        self._task: TaskID | None = None
        self._total = 1

    def on_begin(self, stage: str) -> None:
        """Draw a new bar."""
        self._task, self._total = self._bars.add_task(stage, total=None), 1

    def on_advance(self, stage: str, done: int, total: int) -> None:
        """Move the bar."""
        del stage
        if self._task is not None:
            self._total = total
            self._bars.update(self._task, completed=done, total=total)

    def on_end(self, stage: str, seconds: float) -> None:
        """Fill the bar."""
        del stage, seconds
        if self._task is not None:
            self._bars.update(self._task, completed=self._total, total=self._total)
            self._bars.stop_task(self._task)


class ProgressEvents(ProgressObserver):
    """Writes each step as a line of JSON.

    The first event has the address of the job's page, the dashboard.
    """

    def __init__(self, stream: TextIO, dashboard: str | None = None) -> None:
        self._stream = stream
        if dashboard is not None:
            self._write(dashboard=dashboard)

    def on_begin(self, stage: str) -> None:
        """Write that nothing is done yet."""
        self._write(stage=stage, done=0, total=0)

    def on_advance(self, stage: str, done: int, total: int) -> None:
        """Write how far the stage has come."""
        self._write(stage=stage, done=done, total=total)

    def on_end(self, stage: str, seconds: float) -> None:
        """Write how long the stage took, to the microsecond."""
        self._write(stage=stage, seconds=round(seconds, 6))

    def _write(self, **event: str | float) -> None:
        _write_line(self._stream, json.dumps(event))


@contextmanager
def open_events(path: Path | None, dashboard: str | None = None) -> Iterator[ProgressObserver]:
    """Yield an observer that writes events to a file, if there is one.

    It is written anew, or a pipe that somebody reads; the first event has the address of the job's
    page, the dashboard. Raise OutputError where the file cannot be written.
    """
    if path is None:
        yield ProgressObserver()
        return
    try:
        stream = open(path, "w", encoding="utf-8", opener=open_if_read)  # noqa: SIM115
    except OSError as error:
        raise OutputError(
            f"{path}: cannot be written ({error.strerror})", "give another --events"
        ) from error
    try:
        yield ProgressEvents(stream, dashboard)
    finally:
        with contextlib.suppress(OSError):  # what is left to write, likewise
            stream.close()


@contextmanager
def open_progress(stream: TextIO) -> Iterator[ProgressObserver]:
    """Yield the display that fits a stream: bars where it is a terminal, lines elsewhere."""
    if is_quiet():
        yield ProgressObserver()
        return
    if not stream.isatty():
        yield ProgressLines(stream)
        return
    from hpccomponent.cli.bars import make_bars

    with make_bars(stream) as bars:
        yield ProgressBars(bars)
