"""Where tasks run: one context manager opens any backend as an Executor.

===========  =========================================================================
name         what stands behind it
===========  =========================================================================
serial       the calling thread
threads      a thread pool of this process
processes    a process pool of the standard library, spawned
zmq          loaders, components and workers as real processes on this machine
FILE.json    the workers of a cluster, by its inventory, on the head
FILE.yaml    the workers of a cluster that is up, by its cluster file, from anywhere
dask=ADDR    a Dask cluster, by its scheduler's address
ray          a Ray of this machine, started for the job
ray=ADDR     a Ray that runs, by its head's address
mpi          the other ranks of the MPI job whose rank 0 this process is
module:func  the Executor that a function makes
===========  =========================================================================

``docs/how-to/choose-a-backend.md`` says which to choose.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from hpcapp.backends import BACKENDS, IN_PROCESS
from hpcapp.backends.recorded import RecordedExecutor
from hpcapp.backends.serial import SerialExecutor
from hpcapp.cancellation import Cancellation, JobThreads
from hpcapp.capacity import check_address_space, check_workers
from hpcapp.communicator.scheduling.policy import DEFAULT_POLICY, POLICIES
from hpcapp.communicator.scheduling.verification import LEAST_MACHINES, Verification
from hpcapp.timeline import Timeline
from hpcapp.workforce import Workforce
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError
from hpccomponent.limits import available_cores
from hpccomponent.posix import ADVICE, resource

if TYPE_CHECKING:
    from distributed import Client

    from hpcapp.backends.local_cluster import LocalMachines
    from hpcapp.backends.retrying import RetryingExecutor
    from hpcapp.communicator.executor import CommunicatorExecutor


log = logging.getLogger("hpcapp")

CLUSTER_FILES = (".json", ".yaml", ".yml")


@dataclass(frozen=True, slots=True)
class Traffic:
    """What went over the wire, in bytes, as the master sees them; zero where there is no wire."""

    bytes_sent: int = 0
    bytes_received: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Backend:
    """An open backend.

    Parameters
    ----------
    name : str
        One of `BACKENDS`, ``cluster``, ``dask``, ``ray``, ``mpi``, ``module:function``, or the type
        of an Executor that was handed in.
    workforce : Workforce
        The Executor, with what is needed to cut work for it.
    traffic : callable
        Returns the `Traffic` so far.
    is_here : bool
        Whether its workers are on this machine, and so see its files.
    """

    name: str
    workforce: Workforce
    traffic: Callable[[], Traffic] = Traffic
    is_here: bool = False

    @property
    def executor(self) -> Executor:
        """The Executor that tasks are submitted to."""
        return self.workforce.executor

    def heed(self, cancellation: Cancellation) -> Backend:
        """Return a backend, to be used in place of this one, whose work can be cancelled."""
        return replace(self, workforce=replace(self.workforce, cancellation=cancellation))

    def record(self, timeline: Timeline) -> Backend:
        """Return a backend, to be used in place of this one, that records what becomes of tasks."""
        record = getattr(self.executor, "record", None)
        if record is not None:
            record(timeline)
            return self
        recorded = RecordedExecutor(self.executor, timeline)
        return replace(self, workforce=replace(self.workforce, executor=recorded))


def check_backend(name: str) -> None:
    """Find out whether a backend's name can be right, before any work is done for it.

    Raise UsageError where none has it, or what it needs is not installed or not running.
    """
    if resource is None and (name in ("processes", "zmq") or name.endswith(CLUSTER_FILES)):
        raise UsageError(f"{name_option('backend', name)} cannot run on this system", ADVICE)
    if name not in BACKENDS and not name.endswith(CLUSTER_FILES):
        from hpcapp.backends.engines import check_engine

        check_engine(name)


@contextmanager
def open_executor(
    name: str,
    *,
    workers: int | None = None,
    policy: str = DEFAULT_POLICY,
    verification: Verification | None = None,
    extra_tasks: Sequence[str] = (),
    machines: LocalMachines | None = None,
) -> Iterator[Backend]:
    """Open a backend; on exit nothing of it is left running.

    Parameters
    ----------
    name : str
        One of `BACKENDS`; the file of a cluster, its inventory (``.json``) or the cluster file
        (``.yaml``); ``dask=ADDRESS``, ``ray``, ``ray=ADDRESS``, ``mpi``, or ``module:function``.
    workers : int, optional
        How many tasks run at once; as many as there are cores by default, 1 for `serial`. The
        workers of a cluster, of Dask, of MPI and of a Ray that runs are those that there are.
    policy : str
        ``adaptive`` hands out batches by how fast each worker has shown to be, and runs those of
        a straggler again elsewhere (with other Executors than the communicator it is
        ``pull``); ``pull`` hands the next batch to whoever is free; ``equal`` hands every
        worker the same number of batches.
    verification : Verification, optional
        Which answers are asked for again on another machine, by `zmq` and clusters.
    extra_tasks : sequence of str
        Tasks beside the installed ones, each ``NAME=module:function``.
    machines : LocalMachines, optional
        What `start_early` has started for `zmq`.

    Raises
    ------
    UsageError
        An unknown name, or a number of workers that the backend cannot have.
    NoWorkersError
        The workers did not come up.
    """
    _check_choice(name, workers, policy, verification)
    per_worker = POLICIES[policy].batches_per_worker
    verification = verification or Verification()
    if name.endswith(CLUSTER_FILES):
        with _open_cluster(name, policy, verification, extra_tasks) as (executor, count):
            yield wrap_communicator("cluster", executor, count, policy)
    elif name == "zmq":
        from hpcapp.backends.local_cluster import LocalCluster

        machines_or_count = machines or check_workers(name, workers, available_cores())
        with LocalCluster(
            machines_or_count, policy=policy, verification=verification, extra_tasks=extra_tasks
        ) as cluster:
            yield wrap_communicator(name, cluster.executor, cluster.workers, policy)
    elif name in BACKENDS:
        count = check_workers(name, workers, 1 if name == "serial" else available_cores())
        with _open_pool(name, count) as pool:
            workforce = Workforce(pool, count, per_worker, name in IN_PROCESS)
            yield Backend(name, workforce, is_here=True)
    else:
        from hpcapp.backends.engines import open_engine

        with open_engine(name, workers) as engine:
            kind = name.partition("=")[0]
            yield Backend(kind, Workforce(engine, engine.workers, per_worker))


def _check_choice(
    name: str, workers: int | None, policy: str, verification: Verification | None
) -> None:
    """Refuse what a backend cannot have."""
    check_backend(name)
    without_workers = f"leave {name_option('workers')} out"
    is_cluster = name.endswith(CLUSTER_FILES)
    if policy not in POLICIES:
        raise UsageError(f"unknown policy {policy!r}", f"choose one of {', '.join(POLICIES)}")
    if verification and verification.share and name != "zmq" and not is_cluster:
        raise UsageError(
            f"the backend {name} does not say which machine gives an answer: nothing is verified",
            f"leave {name_option('verify')} out, or use a cluster or the backend zmq",
        )
    if workers is None:
        return
    if is_cluster:
        raise UsageError(f"the workers of {name} are those that there are", without_workers)
    if name in BACKENDS and (workers < 1 or (name == "serial" and workers > 1)):
        raise UsageError(
            f"backend {name!r} cannot have {workers} workers",
            f"{without_workers}, or choose another {name_option('backend')}",
        )


@contextmanager
def start_early(name: str, workers: int | None) -> Iterator[LocalMachines | None]:
    """Check that this machine carries a backend, and start at once what takes a while.

    Yield it for `open_executor`, or None: loaders start while this process imports what it computes
    with. Raise UsageError where this machine does not carry so many workers or lets none compute.
    """
    check_address_space()
    count = check_workers(name, workers, available_cores())
    if name != "zmq":
        yield None
        return
    from hpcapp.backends.local_cluster import LocalMachines

    with LocalMachines(count) as machines:
        yield machines


@contextmanager
def open_backend(
    executor: str | Executor | Client, *, workers: int | None = None
) -> Iterator[Backend]:
    """Open a backend by its name, or use an Executor or a Dask Client that is open and stays so.

    `workers` is as for `open_executor`; how many an Executor has that does not tell.
    """
    if isinstance(executor, str):
        with open_executor(executor, workers=workers) as backend:
            yield backend
        return
    begin = getattr(executor, "start_over", None)
    if begin is not None:
        begin()

    per_worker = POLICIES[DEFAULT_POLICY].batches_per_worker
    in_process = isinstance(executor, SerialExecutor | ThreadPoolExecutor)
    with _borrow_executor(executor, workers) as borrowed:
        workforce = Workforce(borrowed, borrowed.workers, per_worker, in_process)
        yield Backend(type(executor).__name__, workforce)


@contextmanager
def _open_pool(name: str, count: int) -> Iterator[Executor]:
    """Open an Executor of the standard library, or the serial one."""
    if name == "processes":
        with _open_processes(count) as processes:
            yield processes
        return
    with JobThreads(count, "worker") if name == "threads" else SerialExecutor() as pool:
        yield pool


@contextmanager
def _open_processes(count: int) -> Iterator[Executor]:
    """Open a pool of processes; after an error nobody waits for what they do."""
    from hpcapp.backends.processes import kill_processes, open_processes
    from hpcapp.backends.retrying import RetryingExecutor

    pool = RetryingExecutor(lambda: open_processes(count), count)
    try:
        yield pool
    except BaseException:
        pool.abandon(kill_processes)
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _open_cluster(
    name: str, policy: str, verification: Verification, extra_tasks: Sequence[str]
) -> Iterator[tuple[CommunicatorExecutor, int]]:
    """Open a cluster by its inventory, or by the cluster file through the package that knows it."""
    from hpcapp.backends.cluster import listen_inventory, load_cluster_function

    path = Path(name)
    listen = partial(
        listen_inventory, policy=policy, verification=verification, extra_tasks=extra_tasks
    )
    with ExitStack() as stack:
        if path.suffix == ".json":
            cluster = stack.enter_context(listen(path))
        else:
            inventory, lead = stack.enter_context(load_cluster_function("open")(path))
            cluster = stack.enter_context(listen(inventory, lead=lead))
        yield cluster.executor, cluster.gather()


def wrap_communicator(
    name: str, executor: CommunicatorExecutor, workers: int, policy: str
) -> Backend:
    """Return a communicator with so many workers as a backend."""
    if executor.verification.share and workers < LEAST_MACHINES:
        log.info(
            "answers are verified from %d workers on, and there are %d", LEAST_MACHINES, workers
        )

    def traffic() -> Traffic:
        counted = executor.statistics()
        return Traffic(counted["bytes_sent"], counted["bytes_received"])

    workforce = Workforce(executor, workers, POLICIES[policy].batches_per_worker)
    return Backend(name, workforce, traffic, is_here=name in BACKENDS)


@contextmanager
def _borrow_executor(
    executor: Executor | Client, workers: int | None = None
) -> Iterator[RetryingExecutor | CommunicatorExecutor | SerialExecutor]:
    """Use an Executor, or a Dask Client, that its owner has opened and will close.

    Yield one with ``workers``: how many tasks it runs at once, by the argument where it does not
    tell. Raise UsageError where it is neither.
    """
    from hpcapp.backends.retrying import RetryingExecutor
    from hpcapp.communicator.executor import CommunicatorExecutor

    if isinstance(executor, RetryingExecutor | CommunicatorExecutor | SerialExecutor):
        yield executor
        return
    distributed = sys.modules.get("distributed")
    if distributed is not None and isinstance(executor, distributed.Client):
        from hpcapp.backends.dask import borrow_client

        with borrow_client(executor) as borrowed:
            yield borrowed
        return
    if not isinstance(executor, Executor):
        raise UsageError(
            f"a {type(executor).__name__} is no Executor",
            "give a backend's name, a concurrent.futures.Executor, or a Dask Client",
        )
    lender = nullcontext(executor)
    retrying = RetryingExecutor(
        lambda: lender,
        workers,
        most_losses=0,  # only its owner can open it anew
        advice="open another Executor; a backend by name is opened anew by itself",
    )
    try:
        yield retrying
    finally:
        retrying.shutdown(wait=True, cancel_futures=True)
