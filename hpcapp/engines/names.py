"""Which engine a backend's name means.

==================  ==============================
``dask=ADDRESS``    `hpcapp.engines.dask`
``mpi``             `hpcapp.engines.mpi`
``module:func``     `hpcapp.engines.factory`
==================  ==============================
"""

from __future__ import annotations

import re
from contextlib import AbstractContextManager

from hpcapp.backends import BACKENDS
from hpcapp.engines.factory import find_factory, is_factory, open_factory
from hpcapp.engines.mpi import check_mpi, open_mpi
from hpcapp.engines.retrying import RetryingExecutor
from hpccomponent.errors import UsageError

__all__ = ["check_engine", "open_engine"]

DASK = re.compile(r"dask=((?:tcp|tls)://.+:\d+)")


def check_engine(name: str) -> None:
    """Find out whether an engine's name can be right; see `hpcapp.backends.check_backend`."""
    if name == "mpi":
        check_mpi()
    elif is_factory(name):
        find_factory(name)
    elif DASK.fullmatch(name):
        import hpcapp.engines.dask  # noqa: F401 - whether it can be
    elif name.partition("=")[0] == "dask":
        raise UsageError(
            f"backend {name!r} names no scheduler", "write dask=tcp://HOST:PORT or tls://HOST:PORT"
        )
    else:
        forms = (*BACKENDS, "dask=ADDRESS", "mpi", "MODULE:FUNCTION")
        raise UsageError(f"unknown backend {name!r}", f"choose one of {', '.join(forms)}")


def open_engine(name: str, workers: int | None) -> AbstractContextManager[RetryingExecutor]:
    """Open an engine.

    Parameters
    ----------
    name : str
    workers : int, optional
        Only for a function that takes them: Dask and MPI have those that there are.

    Returns
    -------
    context manager of RetryingExecutor

    Raises
    ------
    UsageError
        The name, or the number of workers, cannot be had.
    """
    check_engine(name)
    scheduler = DASK.fullmatch(name)
    if scheduler is None and name != "mpi":
        return open_factory(name, workers)
    if workers is not None:
        raise UsageError(f"the workers of {name} are those that there are", "leave --workers out")
    if scheduler is None:
        return open_mpi()
    from hpcapp.engines.dask import open_dask

    return open_dask(scheduler[1])
