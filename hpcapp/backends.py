"""Where tasks run: one context manager opens any backend as an Executor.

===========  =========================================================================
name         what stands behind it
===========  =========================================================================
serial       the calling thread
threads      a thread pool of this process
processes    a process pool of the standard library, spawned; a lost worker ends the job
zmq          loaders, components and workers as real processes; lost workers are replaced
FILE.json    the workers of a cluster, by its inventory, on the head
FILE.yaml    the workers of a cluster that is up, by its cluster file, from anywhere
===========  =========================================================================
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

from hpcapp.batches import Workforce
from hpccomponent.errors import UsageError
from hpccomponent.runtime.lifetime import die_with_parent, exit_at_end_of_pipe

if TYPE_CHECKING:
    from hpcapp.communicator.executor import CommunicatorExecutor

__all__ = ["BACKENDS", "POLICIES", "Backend", "SerialExecutor", "Traffic", "open_executor"]

BACKENDS = ("serial", "threads", "processes", "zmq")
POLICIES = ("equal", "pull")
BATCHES_PER_WORKER = {"equal": 1, "pull": 4}
EXIT_ORPHANED = 1

P = ParamSpec("P")
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Traffic:
    """What went over the wire.

    Parameters
    ----------
    bytes_sent, bytes_received : int
        In bytes, as the master sees them; zero where there is no wire.
    """

    bytes_sent: int = 0
    bytes_received: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Backend:
    """An open backend.

    Parameters
    ----------
    name : str
        One of `BACKENDS`, or ``cluster``.
    workforce : Workforce
        The Executor, with what is needed to cut work for it.
    traffic : callable
        Returns the `Traffic` so far.
    """

    name: str
    workforce: Workforce
    traffic: Callable[[], Traffic] = Traffic

    @property
    def executor(self) -> Executor:
        """The Executor that tasks are submitted to."""
        return self.workforce.executor


class SerialExecutor(Executor):
    """Runs each task within `submit`, in the calling thread."""

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Run `fn` now and return its finished future."""
        future: Future[T] = Future()
        future.set_running_or_notify_cancel()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def _serve_the_master() -> None:
    """Leave Ctrl-C to the master, and end with it even when it is killed.

    A worker of a pool would wait for ever: each holds both ends of the queue of the others.
    """
    import multiprocessing

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


def available_cores() -> int:
    """Return how many cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@contextmanager
def open_executor(
    name: str,
    *,
    workers: int | None = None,
    policy: str = "pull",
    extra_tasks: Sequence[str] = (),
) -> Iterator[Backend]:
    """Open a backend; on exit nothing of it is left running.

    Parameters
    ----------
    name : str
        One of `BACKENDS`, or the file of a cluster: its inventory (``.json``) or the cluster file
        (``.yaml``).
    workers : int, optional
        How many tasks run at once; as many as there are cores by default, 1 for `serial`. A
        cluster's workers are all that its file names and that come.
    policy : str
        ``equal`` hands every worker the same number of batches, ``pull`` hands out the next
        batch to whoever is free.
    extra_tasks : sequence of str
        Tasks beside the installed ones, each ``NAME=module:function``.

    Yields
    ------
    Backend

    Raises
    ------
    UsageError
        An unknown name, or a number of workers that the backend cannot have.
    NoWorkersError
        The workers did not come up.
    """
    is_cluster = name.endswith((".json", ".yaml", ".yml"))
    if name not in BACKENDS and not is_cluster:
        raise UsageError(f"unknown backend {name!r}", f"choose one of {', '.join(BACKENDS)}")
    if policy not in POLICIES:
        raise UsageError(f"unknown policy {policy!r}", f"choose one of {', '.join(POLICIES)}")
    per_worker = BATCHES_PER_WORKER[policy]
    if is_cluster:
        if workers is not None:
            raise UsageError(
                f"a cluster's workers are those of {name}", "leave the number of workers out"
            )
        with _open_cluster(name, policy, extra_tasks) as (executor, count):
            yield Backend("cluster", Workforce(executor, count, per_worker), _counter(executor))
        return
    count = workers if workers is not None else (1 if name == "serial" else available_cores())
    if count < 1 or (name == "serial" and count > 1):
        raise UsageError(
            f"backend {name!r} cannot have {count} workers",
            "leave --workers out, or choose another --backend",
        )
    if name == "zmq":
        from hpcapp.local_cluster import LocalCluster

        with LocalCluster(count, policy=policy, extra_tasks=extra_tasks) as cluster:
            workforce = Workforce(cluster.executor, count, per_worker)
            yield Backend(name, workforce, _counter(cluster.executor))
        return
    with _open_pool(name, count) as pool:
        yield Backend(name, Workforce(pool, count, per_worker))


@contextmanager
def _open_pool(name: str, count: int) -> Iterator[Executor]:
    """Open an Executor of the standard library, or the serial one."""
    if name == "processes":
        with _open_processes(count) as processes:
            yield processes
        return
    pool = (
        SerialExecutor()
        if name == "serial"
        else ThreadPoolExecutor(count, thread_name_prefix="worker")
    )
    try:
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _open_processes(count: int) -> Iterator[Executor]:
    """Open a pool of processes whose workers end with it, and whose losses are noticed."""
    import multiprocessing  # heavy, like the pool
    from concurrent.futures import ProcessPoolExecutor

    # Spawned, not forked: a fork copies locks that threads of this process may hold.
    pool = ProcessPoolExecutor(
        count,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_serve_the_master,
    )
    watcher = None
    try:
        _start_workers(pool, count)
        watcher = threading.Thread(target=_watch_workers, args=_insides(pool), name="pool watcher")
        watcher.start()
        yield pool
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
        if watcher is not None and watcher.ident is not None:
            watcher.join()


def _insides(pool: Any) -> tuple[list[Any], Any]:
    """Return the workers of a pool, and the end of a pipe that they write results to.

    Private to the standard library, which offers no other way to learn of a lost worker.
    """
    results: Any = pool._result_queue
    return list(pool._processes.values()), results._writer


def _watch_workers(processes: list[Any], writer: Any) -> None:
    """Break the pool when a worker dies, even one that dies while it writes a result.

    The pool then waits for the rest of the result for ever: the master itself and the other
    workers keep the pipe open. Without them the pool reads its end, and fails what waits.
    """
    from multiprocessing.connection import wait

    running = {process.sentinel: process for process in processes}
    while running:
        ended = [running.pop(sentinel) for sentinel in wait(list(running))]
        for process in ended:
            process.join()  # its pipe closes a moment before its exit code is known
        if any(process.exitcode for process in ended):
            for process in running.values():
                process.kill()
            writer.close()
            return


@contextmanager
def _open_cluster(
    name: str, policy: str, extra_tasks: Sequence[str]
) -> Iterator[tuple[CommunicatorExecutor, int]]:
    """Open a cluster by its inventory, or by the cluster file through the package that knows it."""
    from hpcapp.cluster import open_inventory
    from hpcapp.cluster_jobs import load_cluster_function

    path = Path(name)
    if path.suffix == ".json":
        with open_inventory(path, policy=policy, extra_tasks=extra_tasks) as opened:
            yield opened
        return
    with (
        load_cluster_function("open")(path) as (inventory, lead),
        open_inventory(inventory, policy=policy, extra_tasks=extra_tasks, lead=lead) as opened,
    ):
        yield opened


def _counter(executor: CommunicatorExecutor) -> Callable[[], Traffic]:
    """Return what counts the traffic of a communicator."""

    def traffic() -> Traffic:
        counted = executor.statistics()
        return Traffic(counted["bytes_sent"], counted["bytes_received"])

    return traffic
