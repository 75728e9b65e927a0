"""The script that runs the tests: what is kept and what is left where it is interrupted."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from process_tree import are_gone

CLONE = Path(__file__).parents[1]
HANGING = ("tests/e2e/test_e2e.py", "tests/machines/test_machines.py")
HIDDEN = (
    "VENV",
    "NO_SET_UP",
    "PYTEST_XDIST_WORKER",
    "PYTEST_XDIST_WORKER_COUNT",
    "PYTEST_CURRENT_TEST",
)
TESTS = """
import os, signal, subprocess, sys
import pytest

@pytest.fixture
def child():
    process = subprocess.Popen(["sleep", "1000"])
    yield process
    process.kill()
    process.wait()

def test_ends():
    pass

def test_hangs(child):
    with open({fifo!r}, "w") as told:
        told.write(f"{{os.getpid()}} {{child.pid}}\\n")
    signal.pause()

def test_is_never_run():
    pass
"""


@pytest.fixture
def clone(tmp_path: Path) -> Path:
    """Make a clone in which two files of tests hang; its environment is the one that runs."""
    for folder in ("tests/e2e", "tests/machines", "examples", ".venv/bin"):
        (tmp_path / folder).mkdir(parents=True)
    for name in ("tests/run", "examples/set-up"):
        shutil.copy(CLONE / name, tmp_path / name)
    for name in HANGING:
        text = TESTS.format(fifo=str(tmp_path / "fifo"))
        (tmp_path / name).write_text(text)
    (tmp_path / "pytest.ini").write_text(
        "[pytest]\nmarkers = slow\n    long\naddopts = -p no:cacheprovider\n"
    )
    for name, does in (("python", "exit 0"), ("pytest", f'exec {sys.executable} -m pytest "$@"')):
        program = tmp_path / ".venv/bin" / name
        program.write_text(f"#!/bin/sh\n{does}\n")
        program.chmod(0o755)
    os.mkfifo(tmp_path / "fifo")
    return tmp_path


@pytest.mark.slow
@pytest.mark.parametrize(("number", "code"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)])
def test_what_was_run_before_an_interrupt_is_kept_and_nothing_runs_on(
    clone: Path, number: signal.Signals, code: int
) -> None:
    with subprocess.Popen(
        [clone / "tests/run"],
        env={name: text for name, text in os.environ.items() if name not in HIDDEN},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        running: set[int] = set()
        while len(running) < 2 * len(HANGING):
            with (clone / "fifo").open() as told:
                running.update(int(pid) for line in told for pid in line.split())
        process.send_signal(number)
        _, said = process.communicate()
    assert process.returncode == code
    assert said == f"interrupted: {clone}/logs has what was run so far\n"
    assert are_gone(running)
    log = (clone / "logs/tests.log").read_text()
    for name in HANGING:
        assert f"PASSED {name}::test_ends" in log
    assert "test_is_never_run" not in log
    assert "KeyboardInterrupt" in log
