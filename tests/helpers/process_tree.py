"""The processes below one, and whether they are gone."""

from __future__ import annotations

import os
import select
import time
from contextlib import ExitStack
from pathlib import Path


def descendants(pid: int) -> set[int]:
    """Return the ids of the children of a process, of theirs, and so on."""
    found: set[int] = set()
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        for child in map(int, task.read_text().split()):
            found |= {child} | descendants(child)
    return found


def are_gone(pids: set[int]) -> bool:
    """Wait until processes end; the promise is 10 s."""
    deadline = time.monotonic() + 10.0
    with ExitStack() as stack:
        for pid in pids:
            try:
                pidfd = os.pidfd_open(pid)
            except ProcessLookupError:
                continue
            stack.callback(os.close, pidfd)
            if not select.select([pidfd], [], [], max(0.0, deadline - time.monotonic()))[0]:
                return False
    return True
