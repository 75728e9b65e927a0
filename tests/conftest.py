"""Every test that leaks a thread, a child process, a socket or a file fails."""

from __future__ import annotations

import gc
import os
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

# A shared machine stalls now and then: no example is timed.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

PROC = Path("/proc/self")


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
    return {
        int(pid)
        for thread in (PROC / "task").iterdir()
        for pid in (thread / "children").read_text().split()
    }


@pytest.fixture(autouse=True)
def no_leaks(request: pytest.FixtureRequest) -> Iterator[None]:
    if not PROC.exists() or request.node.get_closest_marker("leaks_allowed"):
        yield
        return
    threads, processes, files = set(threading.enumerate()), children(), open_files()
    yield
    gc.collect()
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
    return "/dev/urandom" in descriptor or ".hypothesis" in descriptor or "/dev/null" in descriptor
