"""Emulated machines: a loader, component and worker each, as real processes on this machine.

::

    master process                                     one session of its own per emulated machine
    ┌──────────────────────────────────────┐           ┌──────────────────────────────────┐
    │ LocalMachines ─── lifeline pipe ─────┼──────────>│ loader ─> component ─> worker    │
    │   │  watcher thread <── stderr, exit ┼───────────│                │                 │
    │   │ on_exit                          │           └────────────────┼─────────────────┘
    │   v                                  │                            │
    │ LocalCluster ─> executor, Listener <─┼─────── CURVE over loopback ┘
    └──────────────────────────────────────┘

The master alone holds the writing end of each lifeline, so that its end, however it comes,
ends everything. All processes of a machine inherit one stderr: when the watcher reads its end,
the last of them is gone. Each machine has a session of its own, so that Ctrl-C in a terminal
reaches the master only.

Nothing heavy is imported at the top: machines start while the master imports what it computes with,
and wait until it answers. `hpcloader` is not imported: it is started as a program and met in its
files.
"""

from __future__ import annotations

import contextlib
import logging
import os
import selectors
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hpcapp.capacity import check_workers
from hpcapp.communicator.listener import Listener
from hpcapp.communicator.scheduling.policy import DEFAULT_POLICY, POLICIES
from hpccomponent.errors import NoWorkersError, UsageError
from hpccomponent.files.held_folders import temporary_folder
from hpccomponent.files.private_files import make_private_folder
from hpccomponent.protocol.connection import write_connection

if TYPE_CHECKING:
    from hpcapp.communicator.scheduling.verification import Verification


logger = logging.getLogger(__name__)

_KEPT_LINES = 20  # of each machine's log, for the message when it does not come up
_NAMED = 4  # loaders whose ends are told one by one
_LEAVE_S = 4.0  # a loader kills a component that does not leave within 1 s
_KILL_S = 2.0


class LocalMachines:
    """Emulated machines for the time of a ``with`` block, which leaves none of their processes.

    Each has one loader, component and worker, and connects to `listener`. `extra_tasks` are
    ``NAME=module:function`` beside the installed ones; the modules must be found through
    ``PYTHONPATH`` or be installed. Raise UsageError for no sensible number of machines, or more
    than this one carries, and on entry NoWorkersError where not one loader can be started.
    """

    def __init__(self, count: int, extra_tasks: Sequence[str] = ()) -> None:
        if count < 1:
            raise UsageError(f"{count} workers cannot do any work", "ask for at least 1")
        check_workers("zmq", count, count)
        self.count = count
        self.extra_tasks = list(extra_tasks)
        self._machines: list[_Machine] = []
        self._watcher = threading.Thread(
            target=_watch, args=(self._machines, self._loader_ended), name="watcher", daemon=True
        )
        self._guard = threading.Lock()
        self._on_exit: Callable[[], None] | None = None
        self._is_closing = False

    def __enter__(self) -> LocalMachines:
        with ExitStack() as stack:
            folder = stack.enter_context(temporary_folder())
            self.listener = stack.enter_context(Listener())
            stack.callback(self.stop)
            try:
                self._start_machines(folder)
            finally:
                self._watcher.start()  # stopping those that have been started needs it too
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    @property
    def loader_pids(self) -> list[int]:
        """Process ids of the loaders, one per machine."""
        return [machine.process.pid for machine in self._machines]

    @property
    def are_gone(self) -> bool:
        """Whether no loader is left."""
        return all(machine.has_exited.is_set() for machine in self._machines)

    def watch(self, on_exit: Callable[[], None]) -> None:
        """Have `on_exit` called for each machine whose loader ends, or has ended already.

        It is called from any thread, not after `stop`.
        """
        with self._guard:
            self._on_exit = on_exit
            ended = [machine for machine in self._machines if machine.has_exited.is_set()]
        for machine in ended:
            self._tell_exit(machine)

    def last_words(self) -> str:
        """Return the end of the log of a machine that has failed, else of the first."""
        machine = min(self._machines, key=lambda machine: not machine.has_exited.is_set())
        return "\n".join((f"the end of the log of {machine.name}:", *machine.lines))

    def describe_ends(self) -> str:
        """Say how each loader that has ended did so, with the last line of its log."""
        ended = [machine for machine in self._machines if machine.has_exited.is_set()]
        more = [f"and {len(ended) - _NAMED} more"] if len(ended) > _NAMED else []
        return "; ".join([machine.describe_end() for machine in ended[:_NAMED]] + more)

    def stop(self) -> None:
        """Cut the lifelines and wait until nothing is left; kill what does not leave."""
        self._is_closing = True
        for machine in self._machines:
            machine.cut_lifeline()
        deadline = time.monotonic() + _LEAVE_S
        late = [machine for machine in self._machines if not machine.is_left_by(deadline)]
        for machine in late:
            machine.kill()
        deadline = time.monotonic() + _KILL_S
        for machine in late:
            machine.is_left_by(deadline)
        if self._watcher.ident is not None:
            self._watcher.join(_KILL_S)

    def _start_machines(self, folder: Path) -> None:
        """Start as many as the system lets; it may have less room than when that was checked."""
        try:
            for number in range(self.count):
                self._start_machine(folder / f"machine-{number}")
        except NoWorkersError as error:
            if not self._machines:
                raise
            logger.warning("%d of %d: %s", len(self._machines), self.count, error)
            self.count = len(self._machines)

    def _start_machine(self, folder: Path) -> None:
        """Give one machine its keys, and start its loader."""
        make_private_folder(folder)
        connection = folder / "connection.json"
        write_connection(connection, self.listener.invite(folder.name))
        self._machines.append(_Machine(folder.name, connection, self.extra_tasks))

    def _loader_ended(self, machine: _Machine) -> None:
        with self._guard:
            machine.has_exited.set()
            is_watched = self._on_exit is not None
        if is_watched:
            self._tell_exit(machine)

    def _tell_exit(self, machine: _Machine) -> None:
        if self._is_closing or self._on_exit is None:
            return
        logger.warning("loader of %s", machine.describe_end())
        self._on_exit()


class LocalCluster:
    """Workers on this machine for the time of a ``with`` block, which leaves no process of theirs.

    `workers` is how many emulated machines, or machines that have been started by now, which know
    their own `extra_tasks` (see `LocalMachines`) and are stopped at the block's end. `policy` is a
    name in `POLICIES` of ``communicator/scheduling/policy.py``. By default `verification` asks for
    no answer again. A further worker is waited for `start_timeout_s`, in seconds.

    Raise UsageError for no sensible number of workers, or an unknown policy, and on entry
    NoWorkersError where none came up; the message says how each loader ended, or holds the end of
    the log of one that did not.

    Loaders that end, or do not come up, cost the job their machine and no more, while there is
    another. The attribute `workers` is how many there were when the block was entered. When the
    block ends by itself, submitted work is finished first; when it ends by an exception, waiting
    work is cancelled and running work is cut off.
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
            from hpcapp.communicator.executor import CommunicatorExecutor
            from hpccomponent.runtime.numerics import numerics_id

            self.executor = CommunicatorExecutor(
                self._machines.listener,
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

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)

    @property
    def loader_pids(self) -> list[int]:
        """Process ids of the loaders, one per emulated machine."""
        return self._machines.loader_pids

    def _wait_for_workers(self) -> None:
        """Wait until every worker has registered that may; say what the loaders said if none has.

        One that is slow or hangs is not waited for while others have work to do.
        """
        expected, seen = self._machines.count, -1
        while seen < self.executor.workers:
            seen = self.executor.workers
            try:
                self.executor.wait_for_workers(expected, self._start_timeout_s)
                break
            except NoWorkersError as error:
                if self._machines.are_gone or not self.executor.workers:
                    log_end = "" if self._machines.are_gone else "\n" + self._machines.last_words()
                    raise NoWorkersError(error.problem + log_end, error.advice) from error
        self.workers = max(1, self.executor.workers)
        if self.workers < expected:
            logger.warning("%d of %d workers have come: the job goes on", self.workers, expected)

    def _on_exit(self) -> None:
        """Tell the executor when a loader has ended, and when none is left."""
        self.executor.worker_gone()
        if self._machines.are_gone:
            self.executor.workers_gone(f"no loader is left: {self._machines.describe_ends()}")


class _Machine:
    """One emulated machine: its loader, its lifeline, and what its processes have said."""

    def __init__(self, name: str, connection: Path, extra_tasks: Sequence[str]) -> None:
        self.name = name
        self.lines: deque[str] = deque(maxlen=_KEPT_LINES)
        self.has_exited = threading.Event()  # the loader
        self.is_empty = threading.Event()  # all of its processes
        self._rest = b""
        reader, self._lifeline = os.pipe()
        command = [sys.executable, "-P", "-m", "hpcloader", "run", "--connection", str(connection)]
        tasks = [word for task in extra_tasks for word in ("--task", task)]
        try:
            self.process = subprocess.Popen(  # noqa: S603 - our own interpreter
                [*command, *tasks, "--lifeline-fd", str(reader)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                pass_fds=(reader,),
                start_new_session=True,
            )
        except BaseException as error:  # an interrupt too: one that has started then leaves
            os.close(self._lifeline)
            if isinstance(error, OSError):
                raise NoWorkersError(f"no loader can be started ({error})") from error
            raise
        finally:
            os.close(reader)
        assert self.process.stderr is not None  # noqa: S101 - for mypy
        os.set_blocking(self.process.stderr.fileno(), False)

    def cut_lifeline(self) -> None:
        """Let the loader know that its master is gone."""
        if self._lifeline >= 0:
            os.close(self._lifeline)
            self._lifeline = -1

    def is_left_by(self, deadline: float) -> bool:
        """Wait until all processes are gone, and tell whether they are; by the monotonic clock."""
        return self.is_empty.wait(max(0.0, deadline - time.monotonic()))

    def kill(self) -> None:
        """Kill the processes that stay too long, as a group."""
        logger.warning("the processes of %s did not leave in time, killing them", self.name)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)

    def describe_end(self) -> str:
        """Say how the loader ended, with the last line of the log."""
        code = self.process.returncode
        how = f"with exit code {code}" if code >= 0 else f"by signal {-code}"
        return f"{self.name} ended {how}" + (f": {self.lines[-1]}" if self.lines else "")

    def listen(self) -> bool:
        """Keep what was said since the last call, and tell whether anyone is left to speak."""
        assert self.process.stderr is not None  # noqa: S101 - for mypy
        try:
            while chunk := os.read(self.process.stderr.fileno(), 65536):
                *whole, self._rest = (self._rest + chunk).split(b"\n")
                for line in whole:
                    self.lines.append(line.decode(errors="replace"))
                    logger.debug("%s", self.lines[-1])
        except BlockingIOError:
            return True
        return False

    def reap(self) -> bool:
        """Collect the loader that has ended, and tell whether that is news."""
        self.process.wait()
        return not self.has_exited.is_set()


def _watch(machines: Sequence[_Machine], on_exit: Callable[[_Machine], None]) -> None:
    """Sleep until a machine says something, its loader ends, or its last process ends."""
    with selectors.DefaultSelector() as selector, ExitStack() as stack:
        for machine in machines:
            stderr = machine.process.stderr
            assert stderr is not None  # noqa: S101 - for mypy
            selector.register(stack.enter_context(stderr), selectors.EVENT_READ, machine)
            for pidfd in _open_pidfds(machine.process.pid):
                stack.callback(os.close, pidfd)
                selector.register(pidfd, selectors.EVENT_READ, machine)
        while selector.get_map():
            for key, _ in selector.select():
                machine = key.data
                is_peopled = machine.listen()  # the last words, before the exit is told
                if is_peopled and key.fileobj is machine.process.stderr:
                    continue
                selector.unregister(key.fileobj)
                if machine.reap():
                    on_exit(machine)
                if not is_peopled:
                    machine.is_empty.set()


def _open_pidfds(pid: int) -> list[int]:
    """Open what becomes readable when a process ends; nothing where there is no such thing.

    There the end of the stderr, a little later, has to do.
    """
    try:
        return [os.pidfd_open(pid)]
    except (AttributeError, OSError):
        return []
