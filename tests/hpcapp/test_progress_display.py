from __future__ import annotations

import errno
import io
import os

import pytest

from hpcapp.progress import Progress
from hpcapp.progress_display import ProgressLines, open_progress


def run_stages(progress: Progress) -> None:
    progress.begin("fit")
    progress.advance(1, 4)
    progress.advance(4, 4)
    progress.end("fit", 1.25)


def test_elsewhere_a_short_stage_is_one_line() -> None:
    stream = io.StringIO()
    with open_progress(stream) as display:
        run_stages(Progress(display))
    assert stream.getvalue() == "fit: done in 1.25 s\n"


def test_elsewhere_a_long_stage_speaks_now_and_then(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr("hpcapp.progress_display.time.monotonic", lambda: now[0])
    stream = io.StringIO()
    progress = Progress(ProgressLines(stream))
    progress.begin("fit")
    for done in range(1, 26):
        now[0] += 1.0
        progress.advance(done, 30)
    assert stream.getvalue() == (
        "fit: 10 of 30, 1.0/s, 20 s left\nfit: 20 of 30, 1.0/s, 10 s left\n"
    )


def test_a_full_stream_does_not_end_the_job() -> None:
    class FullStream(io.StringIO):
        def write(self, text: str) -> int:
            raise OSError(errno.ENOSPC, "full")

    run_stages(Progress(ProgressLines(FullStream())))


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.delenv("NO_COLOR", raising=False)
    return Terminal()


def test_a_terminal_gets_bars(terminal: io.StringIO) -> None:
    with open_progress(terminal) as display:
        run_stages(Progress(display))
    drawn = terminal.getvalue()
    assert "fit" in drawn
    assert "━" in drawn
    assert "\x1b[3" in drawn  # a colour
    assert "4 of 4" in drawn


def test_no_color_is_heeded(terminal: io.StringIO, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    with open_progress(terminal) as display:
        run_stages(Progress(display))
    assert "\x1b[3" not in terminal.getvalue()


def test_the_cursor_comes_back_when_the_job_fails(terminal: io.StringIO) -> None:
    def interrupted() -> None:
        with open_progress(terminal) as display:
            Progress(display).begin("fit")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    drawn = terminal.getvalue()
    assert drawn.rindex("\x1b[?25h") > drawn.rindex("\x1b[?25l")
    assert os.linesep in drawn
