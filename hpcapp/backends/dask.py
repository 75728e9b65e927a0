"""A Dask cluster behind the Executor seam: by its scheduler's address, or by a Client.

Dask runs a task again whose worker has died, on another, up to its own setting
``distributed.scheduler.allowed-failures`` (3), and then raises KilledWorker. Its deaths count as
ours, so that a task costs no more workers than on any other engine.

Imported when it is asked for: `distributed` takes half a second.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager, nullcontext
from typing import TypeVar

from hpcapp.backends.retrying import RetryingExecutor
from hpcapp.extras import how_to_install
from hpccomponent.errors import MissingLibraryError, NoWorkersError, UsageError

try:
    import dask
    from distributed import Client, Security
    from distributed.scheduler import KilledWorker
except ImportError as error:
    raise MissingLibraryError(
        f"Dask is not installed here ({error})", how_to_install("dask")
    ) from None


T = TypeVar("T")

CONNECT_S = 10.0
WORKERS_S = 60.0
# Arguments are batches of points; a task that Dask may run again needs them in its graph.
QUIET = {"distributed.admin.large-graph-warning-threshold": "1 TB"}
ADVICE = "look at the logs of the Dask scheduler and of its workers: memory, network, a crash"


class DaskExecutor(Executor):
    """Submits to a Dask cluster, every call anew; the client stays open."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._executor = client.get_executor(pure=False)  # else equal calls run once

    def submit(self, fn: Callable[..., T], /, *args: object, **kwargs: object) -> Future[T]:
        """Have a task run on some worker."""
        future: Future[T] = self._executor.submit(fn, *args, **kwargs)
        return future

    def share(self, value: object) -> object:
        """Return a Dask future of `value`, by whose content it is known to all workers.

        It is the result of a task, not scattered: Dask makes it again when its worker dies.
        """
        return self._client.submit(_keep, value, pure=True)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Wait for what was submitted, or cancel it; the client stays open.

        Without `wait`, all is cancelled, and with `cancel_futures` whatever that is.
        """
        self._executor.shutdown(wait=wait and not cancel_futures)


def _keep(value: T) -> T:
    """Return the value: the task that stands for it."""
    return value


@contextmanager
def open_dask(address: str) -> Iterator[RetryingExecutor]:
    """Connect to a Dask scheduler.

    It is at ``tcp://host:port``, or ``tls://host:port`` with the certificates of Dask's
    configuration: UsageError where they are missing. Raise NoWorkersError where no scheduler
    answers, or it has no workers.
    """
    security = Security()
    if address.startswith("tls://") and not security.get_connection_args("client")["ssl_context"]:
        raise UsageError(
            f"dask={address}: Dask's configuration names no certificates",
            "set distributed.comm.tls there: ca-file, client.key and client.cert",
        )
    try:
        client = Client(address, timeout=CONNECT_S, security=security, set_as_default=False)
    except OSError as error:
        raise NoWorkersError(
            f"no Dask scheduler answers at {address} ({error})",
            "start one with 'dask scheduler --host ADDRESS', or correct the address",
        ) from error
    # A lost scheduler is told in one line: ours.
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)
    with client, borrow_client(client) as executor:
        yield executor


@contextmanager
def borrow_client(client: Client) -> Iterator[RetryingExecutor]:
    """Use a Client that stays open; UsageError where it is one for coroutines.

    Raise NoWorkersError where its scheduler has no workers.
    """
    if client.asynchronous:
        raise UsageError("this Dask Client is asynchronous", "pass Client(..., asynchronous=False)")
    try:
        client.wait_for_workers(1, timeout=WORKERS_S)
    except TimeoutError:
        raise NoWorkersError(
            f"{client} has no workers", "start some with 'dask worker ADDRESS' of the scheduler"
        ) from None
    with dask.config.set(QUIET):
        executor = RetryingExecutor(
            lambda: nullcontext(DaskExecutor(client)),
            sum(client.nthreads().values()),
            count_losses=count_deaths,
            advice=ADVICE,
        )
        try:
            yield executor
        finally:
            executor.shutdown(wait=True, cancel_futures=True)


def count_deaths(error: BaseException) -> int:
    """Return how many workers Dask has lost with a task before it gave up; 0 for other errors."""
    return error.allowed_failures + 1 if isinstance(error, KilledWorker) else 0
