"""Bars: what they say of a stage, on a terminal with a clock of its own."""

from __future__ import annotations

import io

import pytest
from rich.progress import Progress

from hpccomponent.cli.bars import make_bars
from hpccomponent.clock import ManualClock


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
def bars(monkeypatch: pytest.MonkeyPatch, clock: ManualClock) -> Progress:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    made = make_bars(Terminal())
    made.get_time = clock.now
    return made


def say(bars: Progress) -> str:
    """Return the text of the bars, not started: nothing is drawn by itself."""
    with bars.console.capture() as capture:
        bars.console.print(bars.get_renderable())
    return capture.get()


def test_rate_and_remaining_time_are_told(bars: Progress, clock: ManualClock) -> None:
    task = bars.add_task("extract", total=100)
    for done in range(1, 21):
        clock.advance(2.0)
        bars.update(task, completed=done)
    said = say(bars)
    assert "20 of 100" in said
    assert "2.0 s each" in said
    assert "2:40 min left" in said


def test_a_stage_without_parts_shows_its_time_only(bars: Progress, clock: ManualClock) -> None:
    bars.add_task("read", total=None)
    clock.advance(3.0)
    said = say(bars)
    assert "0:00:03" in said
    assert "left" not in said
    assert " of " not in said


def test_bytes_are_told_as_such(bars: Progress, clock: ManualClock) -> None:
    task = bars.add_task("send", total=8_000_000, is_bytes=True)
    for done in (0, 2_000_000, 4_000_000):
        bars.update(task, completed=done)
        clock.advance(1.0)
    said = say(bars)
    assert "4.0 MB of 8.0 MB" in said
    assert "MB/s" in said
