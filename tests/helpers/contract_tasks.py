"""Task functions for the tests of executors: importable by name on every backend."""

from __future__ import annotations

import errno
import os
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpccomponent.files.whole_files import write_whole
from hpccomponent.protocol.records import record
from hpccomponent.runtime.background import worker_background


@record("contract.pair")
@dataclass(frozen=True, slots=True)
class Pair:
    """A value that travels as itself."""

    word: str
    count: int


def write(path: str, content: bytes) -> None:
    """Write a file, as tasks do."""
    write_whole(Path(path), [content])


def echo(*values: object) -> object:
    """Return the only value, or all of them as a tuple."""
    return values[0] if len(values) == 1 else values


def no_operation() -> None:
    """Do nothing."""


def total(values: NDArray[np.generic]) -> float:
    """Return the sum, in the order of the values."""
    return float(np.add.reduce(values))


def add_to_first(shared: tuple[NDArray[np.generic], object], number: int) -> float:
    """Return the sum of a number and the first value of what is shared."""
    return float(shared[0][0]) + number


def fail(reason: str) -> None:
    """Raise."""
    raise ValueError(reason)


def append_line(path: str) -> None:
    """Leave one line per run."""
    with Path(path).open("a", encoding="utf-8") as stream:
        stream.write(f"{os.getpid()}\n")


def wait_for_file(path: str) -> str:
    """Return once a file exists: the test says when."""
    while not Path(path).exists():
        time.sleep(0.005)  # between two looks; no event crosses to a worker of another engine
    return path


def announce_and_wait(started: str, released: str) -> int:
    """Leave the process id in a file, and return it once another file exists."""
    beside = Path(f"{started}.part")
    beside.write_text(str(os.getpid()), encoding="utf-8")
    beside.rename(started)
    wait_for_file(released)
    return os.getpid()


def leave_work(path: str, released: str) -> None:
    """Leave a file to be written when there is time, and a failure before it."""
    steps: Iterator[Callable[[], None]] = iter([no_operation, Path(path).touch])

    def step() -> bool:
        found = next(steps, None)
        if found is not None:
            found()
        return found is not None

    def stumble() -> bool:
        raise ValueError("nobody asked for it")

    worker_background.add(stumble)
    worker_background.add(step)
    wait_for_file(released)


def kill_worker() -> None:
    """End the process that runs this task, as a crash would."""
    os.kill(os.getpid(), signal.SIGKILL)


def freeze_first(note: str) -> int:
    """Stop the process, where no file says that another has done so; return its id once it goes on.

    Parameters
    ----------
    note : str
        The file: the process's id.
    """
    try:
        with open(note, "x", encoding="utf-8") as file:
            file.write(str(os.getpid()))
    except FileExistsError:
        return os.getpid()
    os.kill(os.getpid(), signal.SIGSTOP)
    return os.getpid()


def kill_below(bad: str) -> int:
    """End the process where it belongs to the component whose id a file holds; else return ours."""
    if os.getppid() == int(Path(bad).read_text(encoding="utf-8")):
        kill_worker()
    return os.getppid()


def lack_below(bad: str, error: int) -> int:
    """Run short of something where the component's id is in a file; else return ours.

    Parameters
    ----------
    bad : str
        The file.
    error : int
        Of what, as an ``errno``.
    """
    if os.getppid() == int(Path(bad).read_text(encoding="utf-8")):
        raise MemoryError("no room") if error == errno.ENOMEM else OSError(error, "no room")
    return os.getppid()


def read_process() -> tuple[int, int, str]:
    """Return the process's id, its parent's, and how many threads BLAS may use."""
    return os.getpid(), os.getppid(), os.environ["OPENBLAS_NUM_THREADS"]
