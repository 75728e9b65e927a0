"""A cluster on one machine: real loaders, components and workers, on loopback, for one job.

The machines are those of `local_machines`; here is the executor that they work for.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from types import TracebackType

from hpcapp.backends.local_machines import LocalMachines
from hpcapp.communicator.executor import CommunicatorExecutor
from hpcapp.communicator.policy import DEFAULT_POLICY, POLICIES
from hpcapp.communicator.verification import Verification
from hpccomponent.errors import NoWorkersError, UsageError
from hpccomponent.runtime.numerics import numerics_id

__all__ = ["LocalCluster"]

log = logging.getLogger("hpcapp")


class LocalCluster:
    """Workers on this machine for the time of a ``with`` block.

    Parameters
    ----------
    workers : int or LocalMachines
        How many emulated machines, with one loader, component and worker each; or those that
        have been started by now, which are stopped at the block's end.
    policy : str
        How batches are handed out: a name in `POLICIES` of ``communicator/policy.py``.
    verification : Verification, optional
        Which answers are asked for again on another machine; by default none.
    extra_tasks : sequence of str
        ``NAME=module:function`` of tasks beside the installed ones; the modules must be found
        through ``PYTHONPATH`` or be installed. Machines that run know their own.
    start_timeout_s : float
        How long to wait for a further worker to register, in seconds.

    Raises
    ------
    UsageError
        No sensible number of workers, or an unknown policy.
    NoWorkersError
        On entry: none came up; the message says how each loader ended, or holds the end of the
        log of one that did not.

    Notes
    -----
    Loaders that end, or do not come up, cost the job their machine and no more, while there is
    another. `workers` is how many there were when the block was entered.

    When the block ends by itself, submitted work is finished first; when it ends by an
    exception, waiting work is cancelled and running work is cut off. Either way the processes
    are gone when the block is left.
    """

    def __init__(
        self,
        workers: int | LocalMachines,
        *,
        policy: str = DEFAULT_POLICY,
        verification: Verification | None = None,
        extra_tasks: Sequence[str] = (),
        start_timeout_s: float = 60.0,
    ) -> None:
        if policy not in POLICIES:
            raise UsageError(f"unknown policy {policy!r}", f"choose {' or '.join(POLICIES)}")
        self._own: AbstractContextManager[object] = nullcontext()
        if not isinstance(workers, LocalMachines):
            self._own = workers = LocalMachines(workers, extra_tasks)
        self._machines = workers
        self.workers = self._machines.count
        self._policy, self._verification = policy, verification
        self._start_timeout_s = start_timeout_s
        self._is_up = False

    def __enter__(self) -> LocalCluster:
        with ExitStack() as stack:
            stack.enter_context(self._own)
            stack.callback(self._machines.stop)  # none is to wait for a next master
            self.executor = CommunicatorExecutor(
                self._machines.door,
                policy=POLICIES[self._policy](),
                verification=self._verification,
                extra_tasks=self._machines.extra_tasks,
                numerics=numerics_id(),  # the master computes too
            )
            # Twice: an interrupt while the first waits for work to end makes the second give up.
            stack.push(self.executor)
            stack.push(self.executor)
            self._machines.watch(self._on_exit)
            self._wait_for_workers()
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.__exit__(kind, error, trace)

    @property
    def loader_pids(self) -> list[int]:
        """Process ids of the loaders, one per emulated machine."""
        return self._machines.loader_pids

    def _wait_for_workers(self) -> None:
        """Wait until every worker has registered that may; say what the loaders said if none has.

        One that is slow or hangs is not waited for while others have work to do.
        """
        asked, seen = self._machines.count, -1
        while seen < self.executor.workers:
            seen = self.executor.workers
            try:
                self.executor.wait_for_workers(asked, self._start_timeout_s)
                break
            except NoWorkersError as error:
                if self._machines.are_gone or not self.executor.workers:
                    said = "" if self._machines.are_gone else "\n" + self._machines.last_words()
                    raise NoWorkersError(error.problem + said, error.advice) from error
        self.workers = max(1, self.executor.workers)
        if self.workers < asked:
            log.warning("%d of %d workers have come: the job goes on", self.workers, asked)

    def _on_exit(self) -> None:
        """Tell the executor when a loader has ended, and when none is left."""
        self.executor.worker_gone()
        if self._machines.are_gone:
            self.executor.workers_gone(f"no loader is left: {self._machines.describe_ends()}")
