"""Opens what a job runs on: the backend that the user named, or the one that pays.

::

    size of the file ──> may a cluster pay? ── yes ──> listen, while points are read and cleaned
                                                             │
    points, grid ──> forecast ── may workers pay? ── yes ──> start them, or wait for the cluster's
                        │ no                                 │
                        │                    measure their speeds and the way ──> forecast anew
                        └──> this process                    └──> they, or this process

Nothing is started, and nobody waited for, before it may pay. Who may import it: the job.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

from hpcapp.applications.surface.backend_choice.cost_model import (
    Choice,
    Here,
    Job,
    Link,
    There,
    choose,
    may_pay,
)
from hpcapp.applications.surface.backend_choice.measuring import measure_here, measure_workers
from hpcapp.applications.surface.settings import Settings, choose_local, name_backend
from hpcapp.backends.capacity import count_carried
from hpcapp.backends.selection import (
    Backend,
    open_backend,
    open_executor,
    wrap_communicator,
)
from hpccomponent.errors import NoWorkersError
from hpccomponent.limits import available_cores

if TYPE_CHECKING:
    from distributed import Client

    from hpcapp.backends.cluster import Listening
    from hpcapp.backends.local_machines import LocalMachines

__all__ = ["Opener", "approach_workers"]

log = logging.getLogger("hpcapp")

Opened = tuple[Backend, Choice]

START_UNITS = 450.0
"""Until workers of this machine are there, if each has a core: a second or more."""
CLUSTER_S = 0.5
"""Until those of a cluster have loaded what they need; that they connect is hidden by reading."""
PATIENCE = 0.05
"""So much of what a job takes here may be lost to find out that a cluster does not pay."""
GUESSED = Link(1e-3, 2e8)
"""The way to workers until it is measured."""


@contextmanager
def approach_workers(
    settings: Settings, guess: Job | None = None, machines: LocalMachines | None = None
) -> Iterator[Opener]:
    """Begin to listen for the workers of a cluster, where they may pay.

    Parameters
    ----------
    settings : Settings
    guess : Job, optional
        What is known before the points are read: as much as it may be.
    machines : LocalMachines, optional
        What `backends.start_early` has started.

    Yields
    ------
    Opener
    """
    opener = Opener(settings, machines)
    with opener.standing:
        if guess is not None and settings.cluster is not None and name_backend(settings) is None:
            opener.approach(guess)
        yield opener


class Opener:
    """Opens a job's backend.

    Parameters
    ----------
    settings : Settings
    machines : LocalMachines, optional
        What `backends.start_early` has started for the backend that was asked for.

    Attributes
    ----------
    standing : ExitStack
        Leaves the cluster.
    """

    def __init__(self, settings: Settings, machines: LocalMachines | None = None) -> None:
        self.standing = ExitStack()
        self._settings = settings
        self._machines = machines
        self._cluster: Listening | None = None
        self._here: Here | None = None

    @contextmanager
    def open(self, job: Job, executor: Executor | Client | None = None) -> Iterator[Opened]:
        """Open the backend that a job runs on.

        Parameters
        ----------
        job : Job
        executor : concurrent.futures.Executor or distributed.Client, optional
            What the user has opened, which is used.

        Yields
        ------
        backend : Backend
        choice : Choice
        """
        settings, asked = self._settings, self._settings.workers
        name = name_backend(settings)
        if executor is None and name is None:
            with ExitStack() as stack:
                yield self._open_best(job, stack)
            return
        if executor is not None:
            opened, reason = open_backend(executor, workers=asked), "it was given"
        else:
            assert name is not None  # noqa: S101 - or it would be chosen
            opened = open_executor(
                name, workers=asked, policy=settings.policy, machines=self._machines
            )
            reason = "it was asked for"
        with opened as backend:
            workers = backend.workforce.workers
            yield backend, Choice(backend.name, workers, reason, workers_asked=asked)

    def approach(self, guess: Job) -> None:
        """Listen for the workers of the cluster, if they may pay."""
        if self._guess(guess).backend == "cluster":
            self._listen()

    def _open_best(self, job: Job, stack: ExitStack) -> Opened:
        """Open what pays, and say why."""
        choice = self._guess(job)
        opened = None if _is_local(choice) else self._try_workers(job, choice, stack)
        if opened is None:
            opened = self._open_local(job, choice, stack)
        elif _is_local(opened[1]):
            stack.close()
            opened = self._open_local(job, opened[1], stack)
        log.info("backend %s: %s", opened[1].backend, opened[1].reason)
        return opened

    def _guess(self, job: Job) -> Choice:
        """Choose by what is known while there are no workers."""
        settings = self._settings
        local = self._local(job)
        if not settings.method.pays_on_workers:
            return replace(
                local, reason=f"the tasks of the method {settings.method.name} are too small"
            )
        if settings.cluster is not None:
            from hpccomponent.inventory import read_inventory

            most = len(read_inventory(settings.cluster).workers)
            kind, ready_s = "cluster", CLUSTER_S
        else:
            most = min(settings.workers or available_cores(), available_cores())
            if most < 2:
                return replace(local, reason=f"{available_cores()} core(s), one of them to be used")
            carried, limit = count_carried("zmq")
            if carried < 2:
                return replace(local, reason=f"no two workers fit here ({limit})")
            most = min(most, carried)
            if not may_pay(job, local.workers, most, START_UNITS):
                work = f"{job.points} points at grid {job.grid}"
                gain = "less would be saved than the start of workers takes"
                return replace(local, reason=f"{work}: {gain}")
            kind, ready_s = "zmq", START_UNITS * self._measured(job).unit_s
        here = self._measured(job)
        there = There((here.unit_s,) * most, GUESSED, ready_s)
        return choose(job, here, there, local, self._distributed(kind, most))

    def _try_workers(self, job: Job, choice: Choice, stack: ExitStack) -> Opened | None:
        """Start workers or wait for them, measure them, and choose again; None if none came."""
        assert choice.local_s is not None  # noqa: S101 - there was something to choose
        settings = self._settings
        patience_s = None
        try:
            if choice.backend == "cluster":
                patience_s = PATIENCE * choice.local_s
                backend = self._gather(patience_s)
            else:
                backend = stack.enter_context(
                    open_executor("zmq", workers=choice.workers, policy=settings.policy)
                )
        except NoWorkersError as error:
            log.warning("no worker came: %s", error.problem)
            return None
        there = measure_workers(backend.workforce, patience_s)
        if there is None:
            return None
        distributed = self._distributed(choice.backend, backend.workforce.workers)
        final = choose(job, self._measured(job), there, self._local(job), distributed)
        return backend, replace(final, bandwidth_mb_s=there.link.bytes_per_s / 1e6)

    def _open_local(self, job: Job, choice: Choice, stack: ExitStack) -> Opened:
        """Open this process."""
        self.standing.close()
        if not _is_local(choice):
            reason = "the workers did not come in time for it to pay"
            local = self._local(job)
            choice = replace(choice, backend=local.backend, workers=local.workers, reason=reason)
        workers = None if choice.backend == "serial" else choice.workers
        return stack.enter_context(open_executor(choice.backend, workers=workers)), choice

    def _local(self, job: Job) -> Choice:
        name, workers = choose_local(self._settings, job.points)
        return Choice(name, workers, "", workers_asked=self._settings.workers)

    def _distributed(self, kind: str, workers: int) -> Choice:
        return Choice(kind, workers, f"{workers} workers", workers_asked=self._settings.workers)

    def _measured(self, job: Job) -> Here:
        """Measure this machine, once."""
        if self._here is None:
            self._here = measure_here(1)
        return replace(self._here, threads=self._local(job).workers)

    def _listen(self) -> Listening:
        from hpcapp.backends.cluster import listen_inventory

        path, policy = self._settings.cluster, self._settings.policy
        assert path is not None  # noqa: S101 - or there would be no cluster
        if self._cluster is None:
            self._cluster = self.standing.enter_context(listen_inventory(path, policy=policy))
        return self._cluster

    def _gather(self, patience_s: float) -> Backend:
        """Wait for the cluster's workers as long as that may pay."""
        cluster = self._listen()
        workers = cluster.gather(patience_s, patience_s)
        return wrap_communicator("cluster", cluster.executor, workers, self._settings.policy)


def _is_local(choice: Choice) -> bool:
    return choice.backend in ("serial", "threads")
