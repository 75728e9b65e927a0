"""Every test that leaks a thread, a child process, a socket or a file fails."""

from __future__ import annotations

import gc
import logging
import os
import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import settings
from standing import StandingCluster, StartCluster

from hpccomponent.cli.verbosity import FOREIGN, OURS

# They are imported by their names: to look for doctests there would import them once more.
collect_ignore = ["helpers"]

# A shell takes SIGINT away from what it starts in the background; tests send it, and so do commands
# that tests start.
signal.signal(signal.SIGINT, signal.default_int_handler)

# A shared machine stalls now and then: no example is timed.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

PROC = Path("/proc/self")
FIRST = ("tests/e2e", "tests/systemd", "tests/testbed", "tests/deploy/hpcdeploy/test_killed.py")


def open_files() -> set[str]:
    """Name what stands behind every open descriptor: files, sockets, pipes, memory."""
    found = set()
    for descriptor in (PROC / "fd").iterdir():
        try:
            target = os.readlink(descriptor)
        except OSError:  # the descriptor of this very listing
            continue
        found.add(f"{descriptor.name} -> {target}")
    return found


def children() -> set[int]:
    """Return the ids of all child processes, of whichever thread."""
    found: set[int] = set()
    for thread in (PROC / "task").iterdir():
        with suppress(OSError):  # a thread that has ended meanwhile has left its children to others
            found.update(map(int, (thread / "children").read_text().split()))
    return found


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with what mostly waits, and takes longest, where files are handed out to processes."""
    items.sort(key=lambda item: not item.nodeid.startswith(FIRST))


def pytest_collection_finish() -> None:
    """Set aside what is imported by now: after each test it would be looked through again."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def levels_stay() -> Iterator[None]:
    """A command sets how much its process logs; the next test does not find it so."""
    loggers = [logging.getLogger(name) for name in (None, "py.warnings", *OURS, *FOREIGN)]
    levels = [logger.level for logger in loggers]
    yield
    for logger, level in zip(loggers, levels, strict=True):
        logger.setLevel(level)


@pytest.fixture(autouse=True)
def no_leaks(request: pytest.FixtureRequest) -> Iterator[None]:
    if not PROC.exists() or request.node.get_closest_marker("leaks_allowed"):
        yield
        return
    threads, processes, files = set(threading.enumerate()), children(), open_files()
    yield
    gc.collect()
    gc.freeze()  # what has outlived a test, modules above all, is not looked through again
    for thread in set(threading.enumerate()) - threads:
        thread.join(timeout=5)
    leaked_threads = {t.name for t in set(threading.enumerate()) - threads}
    leaked_processes = children() - processes
    leaked_files = {f for f in open_files() - files if not is_shared(f)}
    assert not leaked_threads, f"threads left running: {leaked_threads}"
    assert not leaked_processes, f"child processes left: {leaked_processes}"
    assert not leaked_files, f"files or sockets left open: {leaked_files}"


def is_shared(descriptor: str) -> bool:
    """Tell what the interpreter or a library opens once and keeps for all tests."""
    return any(
        name in descriptor for name in ("/dev/urandom", ".hypothesis", "/dev/null", "proj.db")
    )


@pytest.fixture
def standing_cluster(tmp_path: Path) -> Iterator[StartCluster]:
    """Give a function that starts loaders, by default two, and writes their inventory."""
    started: list[StandingCluster] = []

    def start(
        folder: Path | None = None,
        names: Sequence[str] = ("head", "worker-1"),
        running: int | None = None,
        before: Mapping[str, Sequence[str]] | None = None,
        tasks: Mapping[str, Sequence[str]] | None = None,
    ) -> StandingCluster:
        count = len(names) if running is None else running
        started.append(StandingCluster(folder or tmp_path, names, count, before or {}, tasks or {}))
        return started[-1]

    yield start
    for cluster in started:
        cluster.close()
