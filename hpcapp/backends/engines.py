"""Which engine a backend's name means.

==================  ==============================
``dask=ADDRESS``    `hpcapp.backends.dask`
``ray``             `hpcapp.backends.ray`
``ray=ADDRESS``     `hpcapp.backends.ray`
``mpi``             `hpcapp.backends.mpi`
``module:func``     `hpcapp.backends.factory`
==================  ==============================
"""

from __future__ import annotations

import re
from contextlib import AbstractContextManager

from hpcapp.backends import BACKENDS
from hpcapp.backends.factory import find_factory, is_factory, open_factory
from hpcapp.backends.mpi import check_mpi, open_mpi
from hpcapp.backends.ray import check_ray, open_ray
from hpcapp.backends.retrying import RetryingExecutor
from hpccomponent.cli.option_names import name_option
from hpccomponent.errors import UsageError

DASK = re.compile(r"dask=((?:tcp|tls)://.+:\d+)")
RAY = re.compile(r"ray(?:=(auto|(?:ray://)?[^/]+:\d+))?")


def check_engine(name: str) -> None:
    """Find out whether an engine's name, not in `BACKENDS`, can be right.

    Raise UsageError where no engine has it, or what it needs is not installed or not running.
    """
    if name == "mpi":
        check_mpi()
    elif is_factory(name):
        find_factory(name)
    elif DASK.fullmatch(name):
        import hpcapp.backends.dask  # noqa: F401 - whether it can be
    elif name.partition("=")[0] == "dask":
        raise UsageError(
            f"backend {name!r} names no scheduler", "write dask=tcp://HOST:PORT or tls://HOST:PORT"
        )
    elif RAY.fullmatch(name):
        check_ray()
    elif name.partition("=")[0] == "ray":
        raise UsageError(
            f"backend {name!r} names no Ray",
            "write ray, ray=auto, ray=HOST:PORT or ray=ray://HOST:PORT",
        )
    else:
        forms = (*BACKENDS, "dask=ADDRESS", "ray[=ADDRESS]", "mpi", "MODULE:FUNCTION")
        raise UsageError(f"unknown backend {name!r}", f"choose one of {', '.join(forms)}")


def open_engine(name: str, workers: int | None) -> AbstractContextManager[RetryingExecutor]:
    """Open an engine; UsageError where its name, or the number of workers, cannot be had.

    `workers` are for a function that takes them and a Ray that is started here: others have theirs.
    """
    check_engine(name)
    scheduler, ray = DASK.fullmatch(name), RAY.fullmatch(name)
    if ray is not None and ray[1] is None:
        return open_ray(None, workers)
    if is_factory(name):
        return open_factory(name, workers)
    if workers is not None:
        raise UsageError(
            f"the workers of {name} are those that there are", f"leave {name_option('workers')} out"
        )
    if ray is not None:
        return open_ray(ray[1], None)
    if scheduler is None:
        return open_mpi()
    from hpcapp.backends.dask import open_dask

    return open_dask(scheduler[1])
