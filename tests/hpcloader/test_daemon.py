"""The loader as a real process over real components: every way that either of them can end."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Start = Callable[..., Any]  # gives the Loader of conftest.py
WaitGone = Callable[[int], None]

READY = "import os, signal, sys; print('ready', os.getpid(), flush=True); "
PATIENT = READY + "signal.pause()"
STUBBORN = (
    "import os, signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); "
    "print('ready', os.getpid(), flush=True); exec('while True: signal.pause()')"
)
ON_LIFELINE = READY + "os.read(int(sys.argv[sys.argv.index('--lifeline-fd') + 1]), 1)"


def test_the_component_gets_its_arguments(start_loader: Start, tmp_path: Path) -> None:
    loader = start_loader(
        "import sys; print('argv', *sys.argv[1:], flush=True)", tasks=["a.b=c.d:e", "f=g:h"]
    )
    words = loader.expect(r"argv (.*)")[1].split()
    assert words[:8] == [
        *("--connection", str(tmp_path / "connection.json"), "--build", "fake"),
        *("--task", "a.b=c.d:e", "--task", "f=g:h"),
    ]
    assert words[8] == "--lifeline-fd"
    assert int(words[9]) > 2


def test_a_killed_component_is_started_again(start_loader: Start) -> None:
    loader = start_loader(PATIENT, restart={"first_s": 0.01, "give_up_after": 9})
    seen = []
    for _ in range(3):
        seen.append(loader.component())
        os.kill(seen[-1], signal.SIGKILL)
        loader.expect(rf"component {seen[-1]} ended, exit code -9")
        loader.expect(r"starting again in 0\.0")
    assert len(set(seen)) == 3


def test_after_failures_in_a_row_it_gives_up(start_loader: Start) -> None:
    loader = start_loader("raise SystemExit(7)")
    loader.expect(r"ERROR loader m1: giving up: .* failed 3 times .* with exit code 7")
    assert loader.exit_code() == 1


def test_a_wrong_configuration_of_the_component_ends_it(start_loader: Start) -> None:
    loader = start_loader("raise SystemExit(2)")
    loader.expect(r"giving up: .* configuration")
    assert loader.exit_code() == 2


def test_clean_exits_are_answered_by_starts_without_end(start_loader: Start) -> None:
    loader = start_loader(READY)
    assert len({loader.component() for _ in range(8)}) == 8
    assert loader.process.poll() is None


@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 0), (signal.SIGINT, 130)])
def test_a_signal_stops_both_in_order(
    start_loader: Start, wait_gone: WaitGone, number: signal.Signals, code: int
) -> None:
    loader = start_loader(PATIENT)
    component = loader.component()
    loader.process.send_signal(number)
    loader.expect(rf"{number.name} received, stopping")
    loader.expect(rf"component {component} ended, exit code -15")
    assert loader.exit_code() == code
    wait_gone(component)


def test_a_stop_while_it_waits_for_the_next_start_ends_it(start_loader: Start) -> None:
    loader = start_loader("raise SystemExit(1)", restart={"first_s": 600, "cap_s": 600})
    loader.expect(r"starting again in 600")
    loader.process.terminate()
    assert loader.exit_code() == 0


@pytest.mark.parametrize("code", [PATIENT, STUBBORN, ON_LIFELINE])
def test_the_end_of_the_lifeline_ends_both(
    start_loader: Start, wait_gone: WaitGone, code: str
) -> None:
    loader = start_loader(code)
    component = loader.component()
    loader.cut_lifeline()
    loader.expect("the master is gone")
    assert loader.exit_code() == 0
    wait_gone(component)


def test_a_frozen_component_does_not_hold_up_the_end(
    start_loader: Start, wait_gone: WaitGone
) -> None:
    loader = start_loader(STUBBORN)
    component = loader.component()
    os.kill(component, signal.SIGSTOP)
    loader.cut_lifeline()
    loader.expect("killing it")
    assert loader.exit_code() == 0
    wait_gone(component)


def test_a_killed_loader_cuts_the_lifeline_of_its_component(
    start_loader: Start, wait_gone: WaitGone
) -> None:
    loader = start_loader(ON_LIFELINE)
    component = loader.component()
    loader.process.kill()
    wait_gone(component)


def test_a_restarted_component_has_a_lifeline_too(start_loader: Start, wait_gone: WaitGone) -> None:
    loader = start_loader(ON_LIFELINE)
    os.kill(loader.component(), signal.SIGKILL)
    second = loader.component()
    loader.process.kill()
    wait_gone(second)


def test_a_command_that_does_not_exist_is_named(start_loader: Start, tmp_path: Path) -> None:
    (tmp_path / "other.yaml").write_text("version: 1\nbuilds: [{name: x, command: [/no/such]}]")
    loader = start_loader("", catalogue="other.yaml")
    loader.expect(r"cannot be started: .*No such file.*/no/such")
    loader.expect(r"giving up")
    assert loader.exit_code() == 1
