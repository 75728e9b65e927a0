"""The loader's I/O: one component, its lifeline, signals, and one loop that sleeps between them.

::

    master ──lifeline pipe──> ┌────────┐ ──lifeline pipe──> component
                              │ daemon │ <──── SIGCHLD ────
    systemd ──── SIGTERM ───> └────────┘ ── start, SIGTERM, SIGKILL ──>
                               events │ ^ actions
                                      v │
                                   Supervisor

A lifeline is a pipe that nobody writes to: the reader learns of the writer's death, however it
came about, by the end of the file.
"""

from __future__ import annotations

import logging
import os
import selectors
import signal
import socket
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager

from hpccomponent.clock import Clock, MonotonicClock
from hpcloader.supervisor import Action, AskToEnd, End, Kill, Start, Supervisor

logger = logging.getLogger(__name__)

_STOP_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
_EXIT_INTERRUPTED = 130
_EXIT_NOT_STARTED = 127  # as a shell says it
_ORPHAN_GRACE_S = 1.0  # without a master a component has nobody left to say goodbye to


class Component:
    """A running component and the write end of its lifeline."""

    def __init__(self, argv: Sequence[str]) -> None:
        reader, self._lifeline = os.pipe()
        try:
            self.process = subprocess.Popen(  # noqa: S603 - the catalogue is the machine owner's
                [*argv, "--lifeline-fd", str(reader)],
                stdin=subprocess.DEVNULL,
                stdout=2,  # whatever it prints belongs to the log
                pass_fds=(reader,),
            )
        except BaseException:
            os.close(self._lifeline)
            raise
        finally:
            os.close(reader)

    def close(self) -> None:
        """Cut the lifeline of a component that has ended."""
        os.close(self._lifeline)


class Daemon:
    """Runs one component until it is told to stop, its master is gone, or there is no sense in it.

    `lifeline_fd` is the read end of the master's pipe.
    """

    def __init__(
        self,
        argv: Sequence[str],
        supervisor: Supervisor,
        lifeline_fd: int | None = None,
        clock: Clock | None = None,
    ) -> None:
        self._argv = argv
        self._supervisor = supervisor
        self._lifeline_fd = lifeline_fd
        self._clock = clock or MonotonicClock()
        self._component: Component | None = None
        self._end: End | None = None
        self._is_interrupted = False
        self._selector = selectors.DefaultSelector()

    def run(self) -> int:
        """Run until the end, in the main thread, and return the exit code.

        0 after a stop, 1 after giving up, 2 for a wrong configuration, 130 after an interrupt.
        """
        with ExitStack() as stack:
            stack.callback(self._abandon)
            stack.callback(self._selector.close)
            signals = stack.enter_context(_signal_socket())
            self._watch(signals, lambda: self._on_signals(signals.recv(4096)))
            if self._lifeline_fd is not None:
                os.set_inheritable(self._lifeline_fd, False)
                self._watch(self._lifeline_fd, self._on_lifeline)
            self._carry_out(self._supervisor.start(self._clock.now()))
            while self._end is None:
                self._turn()
        if self._end.complaint:
            logger.error("giving up: %s", self._end.complaint)
        return _EXIT_INTERRUPTED if self._is_interrupted else self._end.exit_code

    def _watch(self, source: socket.socket | int, answer: Callable[[], None]) -> None:
        self._selector.register(source, selectors.EVENT_READ, answer)

    def _turn(self) -> None:
        """Sleep until something happens or the supervisor's deadline comes, then act."""
        deadline = self._supervisor.deadline
        wait_s = None if deadline is None else max(0.0, deadline - self._clock.now())
        for key, _ in self._selector.select(wait_s):
            key.data()
        self._reap()
        self._carry_out(self._supervisor.tick(self._clock.now()))

    def _on_signals(self, numbers: bytes) -> None:
        """Stop on any signal but SIGCHLD, which has done its work by waking the loop."""
        for number in set(numbers).intersection(_STOP_SIGNALS):
            logger.info("%s received, stopping", signal.Signals(number).name)
            self._is_interrupted |= number == signal.SIGINT
            self._carry_out(self._supervisor.stop(self._clock.now()))

    def _on_lifeline(self) -> None:
        """Stop quickly at the end of the master's pipe."""
        if self._lifeline_fd is None or os.read(self._lifeline_fd, 4096):
            return
        logger.info("the master is gone, stopping")
        self._selector.unregister(self._lifeline_fd)
        self._carry_out(self._supervisor.stop(self._clock.now(), _ORPHAN_GRACE_S))

    def _reap(self) -> None:
        """Tell the supervisor when the component has ended."""
        if self._component is None:
            return
        code = self._component.process.poll()
        if code is None:
            return
        logger.info("component %d ended, exit code %d", self._component.process.pid, code)
        self._component.close()
        self._component = None
        self._ended(code)

    def _ended(self, code: int) -> None:
        now = self._clock.now()
        self._carry_out(self._supervisor.exited(now, code))
        if self._end is None and self._supervisor.deadline is not None:
            logger.info("starting again in %.1f s", self._supervisor.deadline - now)

    def _carry_out(self, actions: list[Action]) -> None:
        for action in actions:
            match action:
                case Start():
                    self._start()
                case AskToEnd():
                    self._send(signal.SIGTERM)
                case Kill():
                    logger.warning("the component did not leave in time, killing it")
                    self._send(signal.SIGKILL)
                case End():
                    self._end = action

    def _start(self) -> None:
        try:
            self._component = Component(self._argv)
        except OSError as error:
            logger.error("the component cannot be started: %s", error)
            self._ended(_EXIT_NOT_STARTED)
        else:
            logger.info("component %d started", self._component.process.pid)

    def _send(self, number: signal.Signals) -> None:
        if self._component is not None:
            self._component.process.send_signal(number)

    def _abandon(self) -> None:
        """Leave nothing running, even after an error of our own."""
        if self._component is not None:
            self._component.process.kill()
            self._component.process.wait()
            self._component.close()


@contextmanager
def _signal_socket() -> Iterator[socket.socket]:
    """Give a socket from which the numbers of arriving signals can be read."""
    receiver, sender = socket.socketpair()
    with receiver, sender:
        receiver.setblocking(False)
        sender.setblocking(False)
        numbers = (*_STOP_SIGNALS, signal.SIGCHLD)
        # a handler must be set for the number to be written; it runs as soon as it arrives
        before = {number: signal.signal(number, lambda *_: None) for number in numbers}
        fd_before = signal.set_wakeup_fd(sender.fileno(), warn_on_full_buffer=False)
        try:
            yield receiver
        finally:
            signal.set_wakeup_fd(fd_before)
            for number, handler in before.items():
                signal.signal(number, handler)
