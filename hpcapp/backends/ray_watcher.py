"""A process beside the master that ends what is left of its Ray, should the master be killed.

::

    master ── pipe that nobody writes to ──> watcher ── at its end ──> kills who has a file of
      │                                                                the folder open, removes it
      └── Ray's processes, and theirs: they write their logs there

Ray ends some of its processes with the master; the agents that these have started stay. The other
way round it ends the master too, at once and without a word, where that reaches for an object while
the raylet is gone, as it is once one of its agents is: then the watcher says why.
"""

from __future__ import annotations

import os
import select
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

DONE = b"0"  # on the pipe, after the raylet's process id in so many bytes, if it has started
ID_BYTES = 8
SAY_GONE = (
    "hpcapp: Ray has ended under the job, and ended the job with it; "
    "look whether an agent of it ran out of memory, and start the job again\n"
)
TRIES, LOOK_S = 50, 0.1  # what is being killed may have started something


@contextmanager
def watched(place: Path) -> Iterator[Callable[[int], None]]:
    """Have a folder removed, and who uses it killed, if this process is killed in the block.

    Gives a function that takes the raylet's process id: where that one ends first, it is said.
    """
    reading, writing = os.pipe()
    command = [sys.executable, "-P", "-m", "hpcapp.backends.ray_watcher", str(reading), str(place)]
    try:
        watcher = subprocess.Popen(  # noqa: S603 - our own interpreter and module
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            pass_fds=(reading,),
            start_new_session=True,  # Ctrl-C is for the master
        )
    except BaseException:
        os.close(writing)
        raise
    finally:
        os.close(reading)

    def tell(raylet: int) -> None:
        with suppress(BrokenPipeError):
            os.write(writing, raylet.to_bytes(ID_BYTES, "little"))

    try:
        yield tell
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


def await_first_end(pipe: int, raylet: int) -> bool:
    """Wait until the raylet or the master has ended or is done; tell whether the raylet was first.

    False where the system has no descriptors of processes.
    """
    if not hasattr(os, "pidfd_open"):
        return False
    try:
        process = os.pidfd_open(raylet)
    except ProcessLookupError:
        return True
    return select.select([pipe, process], [], [])[0] == [process]


def main() -> None:
    """Wait for the end of the master, and do what it cannot do any more."""
    pipe, place = int(sys.argv[1]), sys.argv[2]
    is_first, message = False, os.read(pipe, ID_BYTES)
    if len(message) == ID_BYTES:
        is_first = await_first_end(pipe, int.from_bytes(message, "little"))
        message = os.read(pipe, len(DONE))
    if message:
        return
    if is_first:
        sys.stderr.write(SAY_GONE)
        sys.stderr.flush()
    end_all(place)


if __name__ == "__main__":
    main()
