"""What runs on a worker of a foreign engine, around each task: the same bits, or none."""

from __future__ import annotations

import os
import platform
import threading
import time
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any, Generic, TypeVar

import numpy as np

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import JobError
from hpccomponent.runtime.numerics import numerics_id

T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class TaskOutcome(Generic[T]):
    """What a worker of a foreign engine answers.

    The worker is the machine and the process, and the thread where it is not the process's first.
    """

    value: T
    worker: str
    seconds: float


def run_task(numerics: str, task: Callable[..., T], *arguments: object) -> TaskOutcome[T]:
    """Run a task, on a worker; JobError where that computes with other kernels than the master."""
    numerics_here = _numerics_here()
    if numerics_here != numerics:
        raise JobError(
            f"a worker on {platform.node()} computes with {numerics_here}, "
            f"the master with {numerics}",
            "install the same build of hpcapp and numpy on all of them ('hpcapp --version')",
        )
    start = time.perf_counter()
    value = task(*(align(value) for value in arguments))
    return TaskOutcome(value, _name_worker(), time.perf_counter() - start)


def _name_worker() -> str:
    """Name the process, and the thread, that this runs in."""
    process, thread = f"{platform.node()}:{os.getpid()}", threading.current_thread()
    return process if thread is threading.main_thread() else f"{process}:{thread.name}"


@cache
def _numerics_here() -> str:
    """Return this process's numerics id; looking it up takes 20 ms."""
    return numerics_id()


def align(value: Any) -> Any:
    """Copy arrays that do not start at a multiple of their numbers' size.

    They may be in tuples, lists and dicts. Return the value itself where nothing had to be copied,
    or an equal one. Dask makes arrays of whatever place in a message they came in. numpy adds such
    numbers up through a buffer, in another order than aligned ones: the sum has other bits.

    Examples
    --------
    >>> odd = np.frombuffer(bytes(17), np.uint8)[1:].view(np.float64)
    >>> odd.flags.aligned, align([odd])[0].flags.aligned
    (False, True)
    """
    if isinstance(value, np.ndarray):
        return np.require(value, requirements="A")
    if type(value) in (tuple, list):
        return type(value)(align(item) for item in value)
    if isinstance(value, dict):
        return {key: align(item) for key, item in value.items()}
    return value


def count_bytes(value: object) -> int:
    """Return how many bytes the arrays in a value have: what travels, but for little.

    Examples
    --------
    >>> count_bytes((np.zeros(3), {"mesh": b"12345"}, "name"))
    29
    """
    if isinstance(value, np.ndarray):
        return value.nbytes
    if isinstance(value, bytes | bytearray | memoryview):
        return len(value)
    if isinstance(value, tuple | list):
        return sum(map(count_bytes, value))
    if isinstance(value, dict):
        return sum(map(count_bytes, value.values()))
    if is_dataclass(value) and not isinstance(value, type):
        return sum(count_bytes(getattr(value, one.name)) for one in fields(value))
    return 0
