"""A cluster on one machine: real loaders, components and workers, on loopback, for one job.

The machines are those of `local_machines`; here is the executor that they work for.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from types import TracebackType

from hpcapp.communicator.executor import CommunicatorExecutor
from hpcapp.communicator.policy import POLICIES
from hpcapp.local_machines import LocalMachines
from hpccomponent.errors import NoWorkersError, UsageError
from hpccomponent.runtime.numerics import numerics_id

__all__ = ["LocalCluster"]


class LocalCluster:
    """Workers on this machine for the time of a ``with`` block.

    Parameters
    ----------
    workers : int or LocalMachines
        How many emulated machines, with one loader, component and worker each; or those that
        have been started by now, which are stopped at the block's end.
    policy : str
        How batches are handed out: a name in `POLICIES` of ``communicator/policy.py``.
    extra_tasks : sequence of str
        ``NAME=module:function`` of tasks beside the installed ones; the modules must be found
        through ``PYTHONPATH`` or be installed. Machines that run know their own.
    start_timeout_s : float
        How long all workers together may take to register, in seconds.

    Raises
    ------
    UsageError
        No sensible number of workers, or an unknown policy.
    NoWorkersError
        On entry: they did not come up; the message holds the end of a loader's log.

    Notes
    -----
    When the block ends by itself, submitted work is finished first; when it ends by an
    exception, waiting work is cancelled and running work is cut off. Either way the processes
    are gone when the block is left.
    """

    def __init__(
        self,
        workers: int | LocalMachines,
        *,
        policy: str = "adaptive",
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
        self._policy = policy
        self._start_timeout_s = start_timeout_s
        self._is_up = False

    def __enter__(self) -> LocalCluster:
        with ExitStack() as stack:
            stack.enter_context(self._own)
            stack.callback(self._machines.stop)  # none is to wait for a next master
            self.executor = CommunicatorExecutor(
                self._machines.door,
                policy=POLICIES[self._policy](),
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
        """Wait until every worker has registered, or say what the loaders said."""
        try:
            self.executor.wait_for_workers(self.workers, self._start_timeout_s)
        except NoWorkersError as error:
            said = self._machines.last_words()
            raise NoWorkersError(f"{error.problem}\n{said}", error.advice) from error
        self._is_up = True

    def _on_exit(self, machine: str) -> None:
        """Tell the executor when no loader is left, or when one fails before all are up."""
        if not self._is_up or self._machines.are_gone:
            self.executor.workers_gone(f"the loader of {machine} has ended")
