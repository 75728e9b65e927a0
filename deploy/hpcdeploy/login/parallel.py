"""Many calls that mostly wait, at once; left at any time without waiting for the slow ones."""

from __future__ import annotations

import resource
import threading
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")

MOST = 256
SPARE = 64  # descriptors that the program has open besides
EACH = 4  # a socket, the agent, and as many for a machine on the way
WAIT_S = 0.5


def connections_at_once() -> int:
    """Return how many logins may run at once: as many as descriptors are free for."""
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return MOST if limit == resource.RLIM_INFINITY else max(4, min(MOST, (limit - SPARE) // EACH))


def run_parallel(
    function: Callable[[T], R], items: Sequence[T], at_once: int, name: str
) -> list[R]:
    """Return the results in the order of the items.

    An error, or Ctrl-C, ends the waiting at once: calls that have begun go on in daemon threads,
    each to the end of its own time limit, and no further one begins.
    """
    todo = deque(range(len(items)))
    done: SimpleQueue[tuple[int, R] | BaseException] = SimpleQueue()

    def work() -> None:
        while True:
            try:
                number = todo.popleft()
            except IndexError:
                return
            try:
                done.put((number, function(items[number])))
            except BaseException as error:  # it is raised where the results are waited for
                done.put(error)

    results: dict[int, R] = {}
    try:
        _start(work, min(at_once, len(items)), name)
        for _ in items:
            outcome = _wait_for(done)
            if isinstance(outcome, BaseException):
                raise outcome
            results[outcome[0]] = outcome[1]
    finally:
        todo.clear()
    return [results[number] for number in range(len(items))]


def _wait_for(done: SimpleQueue[T]) -> T:
    """Take the next result; a Ctrl-C in the moment before a wait does not end it, so wait anew."""
    while True:
        with suppress(Empty):
            return done.get(timeout=WAIT_S)


def _start(work: Callable[[], None], count: int, name: str) -> None:
    """Start some threads; fewer, but one at least, where no more are to be had."""
    for number in range(count):
        try:
            threading.Thread(target=work, name=f"{name}-{number}", daemon=True).start()
        except RuntimeError:
            if number == 0:
                raise
            return
