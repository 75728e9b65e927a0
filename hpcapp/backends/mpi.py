"""MPI behind the Executor seam: the master is rank 0, all other ranks are workers.

::

    mpiexec -n 5 python -m mpi4py.futures -m hpcapp reconstruct ... --backend mpi

`mpi4py.futures` keeps every rank but the first as a worker. MPI cannot lose a process: with one,
it ends all of them.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager

from hpcapp.backends.retrying import RetryingExecutor
from hpccomponent.errors import UsageError

START = "mpiexec -n 5 python -m mpi4py.futures -m hpcapp ..."


def check_mpi() -> None:
    """Raise UsageError where this process is not the master of MPI workers.

    The command that started it tells: to ask MPI would mean to start it.
    """
    if "mpi4py.futures" not in sys.orig_argv:
        raise UsageError("the backend mpi has no workers in this process", f"start it as '{START}'")


@contextmanager
def open_mpi() -> Iterator[RetryingExecutor]:
    """Use the workers of this MPI job; UsageError where there are none."""
    check_mpi()
    from mpi4py import MPI  # starts MPI; here it runs already
    from mpi4py.futures import MPIPoolExecutor

    workers = MPI.COMM_WORLD.Get_size() - 1
    if workers < 1:
        raise UsageError(
            "this MPI job is one process, and has no workers", f"start it as '{START}'"
        )

    def open_pool() -> AbstractContextManager[MPIPoolExecutor]:
        return MPIPoolExecutor(use_pkl5=True)  # arrays travel as they are, beyond 2 GB too

    executor = RetryingExecutor(open_pool, workers, most_losses=0, advice="start the MPI job again")
    try:
        yield executor
    finally:
        executor.shutdown(wait=True, cancel_futures=True)
