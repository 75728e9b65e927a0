"""Real signals at several moments: the first ends in order, the second at once."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from process_tree import are_gone
from stopping import await_stop, go_on, read_until

StartCommand = Callable[..., "subprocess.Popen[str]"]
StopAfter = Callable[[str], None]

ZMQ = ("--backend", "zmq", "--workers", "3")
SECOND = "a second signal (Ctrl-C) ends at once"  # said when the end takes long
SIGNALS = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP]


def check_end(process: subprocess.Popen[str], helpers: set[int], folder: Path) -> None:
    """See that the command has left in order, and left nothing."""
    stderr = process.communicate()[1]
    assert process.returncode == 130, stderr
    said = [line for line in stderr.splitlines() if line.startswith("hpcapp: ")]
    assert [line for line in said if SECOND not in line] == ["hpcapp: interrupted"]
    assert "Traceback" not in stderr
    assert are_gone(helpers)
    assert {path.name for path in folder.iterdir()} == {"sphere.ply"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("moment", "options", "signum"),
    [
        ("build native chosen", ZMQ, signal.SIGINT),  # by the first loader
        ("component", ZMQ, signal.SIGTERM),
        *(("fit: done", ZMQ, signum) for signum in SIGNALS),
        ("clean: done", ("--backend", "processes", "--workers", "2"), signal.SIGINT),
    ],
)
def test_the_first_signal_ends_in_order(
    start_command: StartCommand,
    stop_after: StopAfter,
    sphere_file: Path,
    tmp_path: Path,
    moment: str,
    options: tuple[str, ...],
    signum: signal.Signals,
) -> None:
    stop_after(moment)
    job = ("--debug", "reconstruct", "sphere.ply", "-o", "mesh.ply", "--grid", "256", *options)
    with start_command(*job) as process:
        helpers = await_stop(process, moment)
        go_on(process, signum)
        check_end(process, helpers, tmp_path)


@pytest.mark.parametrize("moment", ["build native chosen", "component"])
def test_nothing_outlives_a_master_that_is_killed_while_workers_start(
    start_command: StartCommand, stop_after: StopAfter, sphere_file: Path, moment: str
) -> None:
    stop_after(moment)
    job = ("--debug", "reconstruct", "sphere.ply", "-o", "mesh.ply", "--grid", "256", *ZMQ)
    with start_command(*job) as process:
        helpers = await_stop(process, moment)
        process.kill()
        process.communicate()
    assert helpers
    assert are_gone(helpers)


def test_a_signal_that_comes_twice_at_once_is_one(
    start_command: StartCommand,
    stop_after: StopAfter,
    sphere_file: Path,
    tmp_path: Path,
) -> None:
    """As `timeout` sends it: to the process, and to its group."""
    stop_after("fit: done")
    job = ("reconstruct", "sphere.ply", "-o", "mesh.ply", "--grid", "256", *ZMQ)
    with start_command(*job) as process:
        helpers = await_stop(process, "fit: done")
        go_on(process, signal.SIGTERM)
        os.killpg(process.pid, signal.SIGTERM)
        check_end(process, helpers, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM])
def test_the_second_signal_ends_at_once(
    start_command: StartCommand,
    stop_after: StopAfter,
    sphere_file: Path,
    signum: signal.Signals,
) -> None:
    stop_after("fit: done")
    job = ("reconstruct", "sphere.ply", "-o", "mesh.ply", "--grid", "256", *ZMQ)
    with start_command(*job) as process:
        helpers = await_stop(process, "fit: done")
        for pid in helpers:
            os.kill(pid, signal.SIGSTOP)  # the end in order waits for them, and kills them
        try:
            go_on(process, signum)
            read_until(process, SECOND)
            process.send_signal(signal.SIGINT)
            stderr = process.communicate()[1]
        finally:
            for pid in helpers:
                os.kill(pid, signal.SIGCONT)
    assert process.returncode == 130
    assert stderr == "hpcapp: interrupted\n"
    assert are_gone(helpers)


STUCK = """
import ctypes, sys
import click
from hpcapp import cli

@click.command()
def stuck():
    library, lock = ctypes.CDLL(None), ctypes.create_string_buffer(256)
    library.pthread_mutex_lock(lock)
    print("stuck", flush=True)
    library.pthread_mutex_lock(lock)

cli.SHIPPED["stuck"] = "__main__:stuck"
cli.main()
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="a mutex of the C library is what it waits for")
def test_a_call_that_never_returns_does_not_hold_up_the_second_signal() -> None:
    command = [sys.executable, "-P", "-c", STUCK, "stuck"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "stuck\n"
        stat = Path(f"/proc/{process.pid}/stat")
        while stat.read_text().rpartition(")")[2].split()[0] != "S":
            pass  # between the words and the lock a signal would still be obeyed
        process.send_signal(signal.SIGTERM)
        read_until(process, SECOND)
        process.send_signal(signal.SIGTERM)
        stderr = process.communicate()[1]
    assert (process.returncode, stderr) == (130, "hpcapp: interrupted\n")


IN_A_STRING = """
import click
from hpcapp import cli

@click.command()
def importing():
    exec("raise KeyboardInterrupt")

cli.SHIPPED["importing"] = "__main__:importing"
cli.main()
"""


def test_a_signal_in_mid_import_ends_with_the_same_code(tmp_path: Path) -> None:
    """Modules execute strings as they are imported, and Python marks interrupts of these."""
    (tmp_path / "program.py").write_text(IN_A_STRING)
    command = [sys.executable, "-m", "program", "importing"]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr.strip()) == (130, "hpcapp: interrupted")


AT_A_BAD_MOMENT = """
import signal, threading
import click
from hpcapp import cli

class Finalised:
    def __del__(self):
        signal.raise_signal(signal.SIGTERM)

@click.command()
def finalising():
    Finalised()
    threading.Event().wait()

@click.command()
def importing():
    import interrupted
    threading.Event().wait()

for name in ("finalising", "importing"):
    cli.SHIPPED[name] = f"__main__:{name}"
cli.main()
"""
INTERRUPTED = """
import signal
try:
    signal.raise_signal(signal.SIGTERM)
except BaseException:
    pass
"""


@pytest.mark.parametrize("moment", ["finalising", "importing"])
def test_a_signal_at_a_moment_that_would_lose_it_comes_a_moment_later(
    tmp_path: Path, moment: str
) -> None:
    (tmp_path / "program.py").write_text(AT_A_BAD_MOMENT)
    (tmp_path / "interrupted.py").write_text(INTERRUPTED)
    command = [sys.executable, "-m", "program", moment]
    ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr.strip()) == (130, "hpcapp: interrupted")
