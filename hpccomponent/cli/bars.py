"""Bars on a terminal, drawn by rich: how far a stage has come, how fast, and how long it will take.

Imported when there is a terminal, and never on a worker, which has no rich.
"""

from __future__ import annotations

from typing import TextIO

from rich.console import Console
from rich.filesize import decimal
from rich.progress import (
    BarColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
)
from rich.text import Text

_MEMORY_S = 600.0  # of the speed: a tile may take minutes


def make_bars(stream: TextIO, *, is_transient: bool = False) -> Progress:
    """Return bars for a terminal, a context manager.

    A task with the field ``is_bytes`` counts bytes, others count parts.
    """
    columns = (
        TextColumn("{task.description:<12}", markup=False),
        BarColumn(bar_width=24),
        TimeElapsedColumn(),
        _Amount(),
        _Rate(),
        _Remaining(),
    )
    return Progress(
        *columns,
        console=Console(file=stream),
        transient=is_transient,
        speed_estimate_period=_MEMORY_S,
    )


def say_rate(per_second: float) -> str:
    """Return how fast parts are finished, which is above 0, in two digits or more.

    Examples
    --------
    >>> say_rate(0.125), say_rate(2.5), say_rate(1234.5)
    ('8.0 s each', '2.5/s', '1,234/s')
    """
    if per_second < 1.0:
        return f"{1.0 / per_second:.1f} s each"
    return f"{per_second:.1f}/s" if per_second < 100.0 else f"{per_second:,.0f}/s"


def say_seconds(seconds: float) -> str:
    """Return a duration as people say it.

    Examples
    --------
    >>> say_seconds(42.4), say_seconds(90), say_seconds(7260)
    ('42 s', '1:30 min', '2:01 h')
    """
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60}:{whole % 60:02} min"
    return f"{whole // 3600}:{whole % 3600 // 60:02} h"


class _Amount(ProgressColumn):
    """How much is done, of how much."""

    def render(self, task: Task) -> Text:
        """Return it; nothing where a stage does not tell."""
        if not task.total or (task.total == 1 and not task.fields.get("is_bytes")):
            return Text("")
        say = decimal if task.fields.get("is_bytes") else "{:,}".format
        done, total = say(int(task.completed)), say(int(task.total))
        return Text(f"{done} of {total}", style="progress.download")


class _Rate(ProgressColumn):
    """How fast it goes."""

    def render(self, task: Task) -> Text:
        """Return it; nothing while it is not known."""
        speed = task.finished_speed or task.speed
        if not speed or task.total == 1:
            return Text("")
        rate = f"{decimal(int(speed))}/s" if task.fields.get("is_bytes") else say_rate(speed)
        return Text(rate, style="progress.data.speed")


class _Remaining(ProgressColumn):
    """How long it will take."""

    max_refresh = 0.5  # it need not change with every part

    def render(self, task: Task) -> Text:
        """Return it; nothing while it is not known, and in the end."""
        seconds = task.time_remaining
        if task.finished or seconds is None:
            return Text("")
        return Text(f"{say_seconds(seconds)} left", style="progress.remaining")
