"""Opens what a job runs on: the backend that the user named, or the one that pays.

::

    size of the file ──> may a cluster pay? ── yes ──> listen, while points are read and cleaned
                                                             │
    points, grid ──> table ── workers pay? ── yes ──> start them, or wait for the cluster's
                        │ no                                 └── none came ──┐
                        └──> this process <──────────────────────────────────┘
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from hpcapp.applications.surface.job.settings import Settings, choose_local, name_backend
from hpcapp.applications.surface.resolution.memory import Together
from hpcapp.backends.selection import Backend, open_backend, open_executor, wrap_communicator
from hpcapp.capacity import count_carried
from hpcapp.communicator.scheduling.verification import Verification
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import NoWorkersError
from hpccomponent.limits import available_cores

if TYPE_CHECKING:
    from distributed import Client

    from hpcapp.backends.cluster import ClusterMaster
    from hpcapp.backends.local_cluster import LocalMachines


log = logging.getLogger("hpcapp")

WORKERS_PAY = ((2, 3_000_000), (3, 2_000_000), (4, 1_750_000), (8, 1_500_000))
"""So many workers of this machine pay from so much work on; see ``benchmarks/backends.py``."""
SQUARE = 3
"""Points that make as much work as a cell of the grid's longest side squared: see `Job.work`."""
REMOTE = 2
"""Workers of a cluster, which points must travel to, pay from so many times as much on."""
LEAST_REMOTE = 4
"""Fewer workers of a cluster are not worth the way."""
WAIT_S = 2.0
"""For the first worker of a cluster, and for the others after it."""


@dataclass(frozen=True, slots=True)
class Job:
    """What there is to do: so many points, and cells of the grid along the longest side.

    They are as many as there may be, while points are not read, and the grid is not chosen yet.

    Examples
    --------
    >>> print(Job(20_000, 128))
    20,000 points at grid 128
    >>> print(Job(20_000, 142, is_read=False, is_chosen=False))
    at most 20,000 points
    """

    points: int
    grid: int
    is_read: bool = True
    is_chosen: bool = True

    @property
    def work(self) -> int:
        """Points, and the area of the surface in points."""
        return self.points + SQUARE * self.grid**2

    def __str__(self) -> str:
        points = f"{self.points:,} points" if self.is_read else f"at most {self.points:,} points"
        return f"{points} at grid {self.grid}" if self.is_chosen else points


@dataclass(frozen=True, slots=True)
class BackendChoice:
    """Where a job runs, and why.

    `backend` is named as in `hpcapp.backends.selection`, `workers` do the work, `workers_asked` is
    how many the user allowed; the `reason` is one sentence.
    """

    backend: str
    workers: int
    reason: str
    workers_asked: int | None = None

    def to_json(self) -> dict[str, Any]:
        """Return it for the report."""
        return asdict(self)


def least_work(workers: int, is_remote: bool = False) -> float:
    """Return from how much work on (see `Job.work`) workers pay; infinite where they never do.

    Examples
    --------
    >>> least_work(1), least_work(2), least_work(64), least_work(4, is_remote=True)
    (inf, 3000000, 1500000, 3500000)
    """
    if is_remote and workers < LEAST_REMOTE:
        return float("inf")
    rows = [work for count, work in WORKERS_PAY if count <= workers]
    return min(rows, default=float("inf")) * (REMOTE if is_remote else 1)


def choose_backend(settings: Settings, job: Job) -> BackendChoice:
    """Return where a job runs: as asked for, or as the table says.

    Raise InputError where the inventory of the cluster cannot be read.
    """
    if (name := name_backend(settings)) is not None:
        workers = 1 if name == "serial" else settings.workers or available_cores()
        return BackendChoice(name, workers, "it was asked for", settings.workers)
    if not settings.method.pays_on_workers:
        name = settings.method.name
        return _stay(settings, job, f"the tasks of the method {name} are too little work")
    if settings.cluster is not None:
        from hpccomponent.inventory import read_inventory

        kind, workers = "cluster", len(read_inventory(settings.cluster).workers)
    else:
        kind, workers = "zmq", min(settings.workers or available_cores(), available_cores())
        if workers < 2:
            return _stay(settings, job, f"{available_cores()} core(s), one of them to be used")
        carried, carrier = count_carried("zmq")
        if carried < 2:
            return _stay(settings, job, f"no two workers fit here ({carrier})")
        workers = min(workers, carried)
        if settings.max_memory is not None:
            fitting = range(workers, 1, -1)
            limit = settings.max_memory
            workers = next((n for n in fitting if Together(job.points, n).fits(limit)), 1)
            if workers < 2:
                reason = f"{name_option('max_memory')} is too little"
                return _stay(settings, job, f"no two workers fit here ({reason})")
    if job.work < least_work(workers, is_remote=kind == "cluster"):
        return _stay(settings, job, f"{job}: too little for {workers} workers to pay")
    return BackendChoice(kind, workers, f"{job}: enough for {workers} workers", settings.workers)


def _stay(settings: Settings, job: Job, reason: str) -> BackendChoice:
    """Return the backend of this process."""
    name, workers = choose_local(settings, job.points)
    return BackendChoice(name, workers, reason, workers_asked=settings.workers)


@contextmanager
def approach_workers(
    settings: Settings,
    guess: Job | None = None,
    machines: LocalMachines | None = None,
    verification: Verification | None = None,
) -> Iterator[Opener]:
    """Begin to listen for the workers of a cluster, where they may pay.

    `guess` is what is known before the points are read: as much as it may be. The `verification`
    knows of the honesty of machines from earlier attempts. For `machines` see `Opener`.
    """
    opener = Opener(settings, machines, verification)
    with opener.standing:
        if guess is not None and settings.cluster is not None and name_backend(settings) is None:
            opener.approach(guess)
        yield opener


class Opener:
    """Opens a job's backend; its `standing` leaves the cluster.

    `machines` are what `backends.selection.start_early` has started for the backend that was asked
    for; for `verification` see `approach_workers`.
    """

    def __init__(
        self,
        settings: Settings,
        machines: LocalMachines | None = None,
        verification: Verification | None = None,
    ) -> None:
        self.standing = ExitStack()
        self._settings = settings
        self._machines = machines
        self._verification = verification or Verification(settings.verify)
        self._cluster: ClusterMaster | None = None

    @contextmanager
    def open(
        self, job: Job, executor: Executor | Client | None = None
    ) -> Iterator[tuple[Backend, BackendChoice]]:
        """Open the backend that a job runs on: the `executor`, where the user has opened one."""
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
                name,
                workers=asked,
                policy=settings.policy,
                verification=self._verification,
                machines=self._machines,
            )
            reason = "it was asked for"
        with opened as backend:
            workers = backend.workforce.workers
            yield backend, BackendChoice(backend.name, workers, reason, workers_asked=asked)

    def approach(self, guess: Job) -> None:
        """Listen for the workers of the cluster, if they may pay, before the points are read."""
        if choose_backend(self._settings, guess).backend == "cluster":
            self._listen()

    def _open_best(self, job: Job, stack: ExitStack) -> tuple[Backend, BackendChoice]:
        """Open what pays, and say why."""
        choice = choose_backend(self._settings, job)
        backend = None
        try:
            if choice.backend == "cluster":
                backend = self._gather()
                choice = replace(choice, workers=backend.workforce.workers)
            else:
                if self._settings.verify and choice.backend != "zmq":
                    log.info(
                        "%s: this process does all the work, so nothing is verified",
                        name_option("verify"),
                    )
                self.standing.close()
                backend = stack.enter_context(
                    open_executor(
                        choice.backend,
                        workers=choice.workers,
                        policy=self._settings.policy,
                        verification=self._verification if choice.backend == "zmq" else None,
                    )
                )
        except NoWorkersError as error:
            log.warning("no worker came: %s", error.problem)
            self.standing.close()
            choice = _stay(self._settings, job, "no worker came in time")
            backend = stack.enter_context(open_executor(choice.backend, workers=choice.workers))
        log.info("backend %s: %s", choice.backend, choice.reason)
        return backend, choice

    def _listen(self) -> ClusterMaster:
        from hpcapp.backends.cluster import listen_inventory

        path, policy = self._settings.cluster, self._settings.policy
        assert path is not None  # noqa: S101 - or there would be no cluster
        if self._cluster is None:
            self._cluster = self.standing.enter_context(
                listen_inventory(path, policy=policy, verification=self._verification)
            )
        return self._cluster

    def _gather(self) -> Backend:
        """Wait for the cluster's workers."""
        cluster = self._listen()
        is_again = bool(self._verification.repeats)  # they have just been told farewell
        workers = cluster.gather(None if is_again else WAIT_S, WAIT_S)
        cluster.executor.start_over()
        return wrap_communicator("cluster", cluster.executor, workers, self._settings.policy)
