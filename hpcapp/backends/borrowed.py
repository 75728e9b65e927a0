"""Executors that Python code hands in: they are used, and stay open."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager, nullcontext
from typing import TYPE_CHECKING

from hpcapp.backends.retrying import RetryingExecutor
from hpcapp.backends.serial import SerialExecutor
from hpcapp.communicator.executor import CommunicatorExecutor
from hpccomponent.errors import UsageError

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["borrow_executor"]


@contextmanager
def borrow_executor(
    executor: Executor | Client, workers: int | None = None
) -> Iterator[RetryingExecutor | CommunicatorExecutor | SerialExecutor]:
    """Use an Executor, or a Dask Client, that its owner has opened and will close.

    Parameters
    ----------
    workers : int, optional
        How many tasks it runs at once, where it does not tell.

    Yields
    ------
    Executor
        With ``workers``.

    Raises
    ------
    UsageError
        It is neither.
    """
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
    lent = executor
    retrying = RetryingExecutor(
        lambda: nullcontext(lent),
        workers,
        most_losses=0,  # only its owner can open it anew
        advice="open another Executor; a backend by name is opened anew by itself",
    )
    try:
        yield retrying
    finally:
        retrying.shutdown(wait=True, cancel_futures=True)
