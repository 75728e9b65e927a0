"""A process beside the master that ends what is left of its Ray, should the master be killed.

::

    master ── pipe that nobody writes to ──> watcher ── at its end ──> kills who has a file of
      │                                                                the folder open, removes it
      └── Ray's processes, and theirs: they write their logs there

Ray ends some of its processes with the master; the agents that these have started stay.
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

__all__ = ["watched"]

DONE = b"0"
TRIES, LOOK_S = 50, 0.1  # what is being killed may have started something


@contextmanager
def watched(place: Path) -> Iterator[None]:
    """Have a folder removed, and who uses it killed, if this process is killed in the block."""
    reading, writing = os.pipe()
    command = [sys.executable, "-P", "-m", "hpcapp.backends.ray_watcher", str(reading), str(place)]
    try:
        watcher = subprocess.Popen(  # noqa: S603 - our own interpreter and module
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=(reading,),
            start_new_session=True,  # Ctrl-C is for the master
        )
    except BaseException:
        os.close(writing)
        raise
    finally:
        os.close(reading)
    try:
        yield
    finally:
        with suppress(BrokenPipeError):
            os.write(writing, DONE)
        os.close(writing)
        watcher.wait()


def end_all(place: str) -> None:
    """Kill all processes that have a file of a folder open, and remove it."""
    for _ in range(TRIES):
        users = _find_users(place)
        for process in users:
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        if not users:
            break
        time.sleep(LOOK_S)
    shutil.rmtree(place, ignore_errors=True)


def _find_users(place: str) -> list[int]:
    """Return the processes that have a file of a folder open; none where nobody tells."""
    return [
        int(process.name)
        for process in Path("/proc").glob("[0-9]*")
        if any(file.startswith(f"{place}/") for file in _list_open(process))
    ]


def _list_open(process: Path) -> Iterator[str]:
    """Yield the names of the files that a process has open, as far as they can be seen."""
    with suppress(OSError):  # it has ended, or is another user's
        for descriptor in os.listdir(process / "fd"):
            with suppress(OSError):
                yield os.readlink(process / "fd" / descriptor)


if __name__ == "__main__":
    if not os.read(int(sys.argv[1]), 1):
        end_all(sys.argv[2])
