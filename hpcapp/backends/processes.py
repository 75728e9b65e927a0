"""A process pool of the standard library that nothing outlives, and that notices lost workers.

Imported by `backends` when it is asked for: what it stands on is heavy.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import wait
from typing import Any

from hpccomponent.runtime.lifetime import die_with_parent, exit_at_end_of_pipe
from hpccomponent.runtime.process import THREAD_VARIABLES

EXIT_ORPHANED = 1

_NOTED_S = 1.0  # so long nobody waits to note an exit code


@contextmanager
def open_processes(count: int) -> Iterator[Executor]:
    """Open a pool of processes whose workers end with it, and whose losses are noticed."""
    # Spawned, not forked: a fork copies locks that threads of this process may hold.
    pool = ProcessPoolExecutor(
        count,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_serve_the_master,
    )
    try:
        _start_workers(pool, count)
        with _watched(pool):
            yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def kill_processes(pool: Any) -> None:
    """Kill the workers of a pool, whatever they do: the pool is broken then."""
    for process in list((pool._processes or {}).values()):
        process.kill()


@contextmanager
def _watched(pool: Any) -> Iterator[None]:
    """Watch the workers of a pool, and shut it down in the end.

    What is private to the standard library is read here: it offers no other way to learn of a
    lost worker.
    """
    processes, results = list(pool._processes.values()), pool._result_queue
    manager = pool._executor_manager_thread
    watcher = threading.Thread(
        target=_watch_workers, args=(processes, results._writer), name="pool watcher"
    )
    watcher.start()
    try:
        yield
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        watcher.join()
        manager.join()
        # Only now: a pool that waits closes the pipe that the watcher may be closing, and a
        # descriptor that is closed twice may be another's by then.
        results.close()


def _watch_workers(processes: list[Any], writer: Any) -> None:
    """Break the pool when a worker dies, even one that dies while it writes a result.

    The pool then waits for the rest of the result for ever: the master itself and the other
    workers keep the pipe open. Without them the pool reads its end, and fails what waits.
    """
    running = {process.sentinel: process for process in processes}
    while running:
        ended = [running.pop(sentinel) for sentinel in wait(list(running))]
        codes = [_exit_code(process) for process in ended]
        if any(code != 0 for code in codes):
            for process in running.values():
                process.kill()
            writer.close()
            return


def _exit_code(process: Any) -> int | None:
    """Return the exit code of a worker that is about to end; None if nobody notes it.

    Its pipe closes a moment before there is one, and if the pool's own thread is the one that
    collects it, another moment passes until it is noted.
    """
    process.join()
    deadline = time.monotonic() + _NOTED_S
    while process.exitcode is None and time.monotonic() < deadline:
        time.sleep(0.001)
    code: int | None = process.exitcode
    return code


def _serve_the_master() -> None:
    """Leave Ctrl-C to the master, compute on one thread, and end with the master.

    A worker of a pool would wait for ever: each holds both ends of the queue of the others.
    """
    os.environ.update({f"{name}_NUM_THREADS": "1" for name in THREAD_VARIABLES})
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    master = multiprocessing.parent_process()
    assert master is not None  # noqa: S101 - for mypy: this runs in a pool only
    assert master.pid is not None  # noqa: S101 - likewise
    exit_at_end_of_pipe(int(master.sentinel), EXIT_ORPHANED)
    die_with_parent(master.pid, signal.SIGKILL)


def _start_workers(pool: Executor, count: int) -> None:
    """Start all workers of a pool deaf to Ctrl-C, which is for the master.

    A worker takes a while to come up, and would show a traceback if it were interrupted then;
    it inherits what is blocked here. A thread other than the main one never hears of Ctrl-C.
    """
    if not hasattr(signal, "pthread_sigmask"):
        return  # they start with the tasks, then
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        for _ in range(count):
            pool.submit(_come_up)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _come_up() -> None:
    """Do nothing: the first task of each worker makes it start."""
