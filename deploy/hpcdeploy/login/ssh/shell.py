"""A shell on a machine that SSH reaches."""

from __future__ import annotations

import os
import shlex
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from itertools import chain
from pathlib import Path
from textwrap import shorten

import paramiko

from hpccomponent.errors import CloudError
from hpcdeploy.login.shell import Completed, Shell
from hpcdeploy.login.ssh.connect import explain
from hpcdeploy.login.ssh.connection import CHANNEL_S, SshConnection
from hpcdeploy.login.ssh.forward import Forwarder
from hpcdeploy.login.ssh.reach import LoginFault, ReachError
from hpcdeploy.login.ssh.terminal import give_terminal
from hpcdeploy.login.ssh.transfer import fetch_file, send_file

BEGIN = "hpcapp: here begins what the command says"
"""Printed first on both streams: what a login shell's start-up files print stands before it."""
MOST_OUTPUT = 1 << 28  # bytes that a command may say: an answer is read as a whole
LONGEST_LINE = 1 << 20  # bytes of a line that is followed; of a longer one come pieces
MOST_GREETING = 20  # lines before `BEGIN` that are kept
_CHUNK = 1 << 16
_NO_CODE = 128  # a signal ended the shell itself, and SSH's answer to paramiko does not say which


class SshShell(Shell):
    """Commands and files on one machine over one connection; safe to use from several threads."""

    def __init__(self, node: str, connection: SshConnection, closer: ExitStack) -> None:
        self.node = node
        self._transport = connection
        self._closer = closer

    def run(self, command: str, *, stdin: bytes = b"", timeout_s: float = 60.0) -> Completed:
        """See `Shell.run`."""
        return self._feed(command, (stdin,), timeout_s)

    def _feed(self, command: str, stdin: Iterable[bytes], timeout_s: float) -> Completed:
        """Run a command on what it is given piece by piece."""
        errors: list[bytes] = []
        with self._channel(command, timeout_s) as channel:
            listener = threading.Thread(
                target=_collect, args=(channel, errors), name="ssh-stderr", daemon=True
            )
            listener.start()
            try:
                _feed(channel, stdin)
                deadline = time.monotonic() + timeout_s
                output = b"".join(self._limited(_chunks(channel, deadline)))
                listener.join(max(0.0, deadline - time.monotonic()))
                code = self._exit_code(channel, deadline)
            finally:
                channel.close()
                listener.join()
        return Completed(
            code,
            _said(output.decode(errors="replace")),
            _said(b"".join(errors).decode(errors="replace")),
        )

    def _read(self, command: str, timeout_s: float) -> Generator[bytes, None, None]:
        """Yield what a command writes to stdout."""
        with (
            self._channel(command, timeout_s) as channel,
            channel.makefile("rb", _CHUNK) as output,
        ):
            channel.shutdown_write()
            while line := output.readline(LONGEST_LINE):
                if line.endswith(f"{BEGIN}\n".encode()):
                    break
            while chunk := output.read(_CHUNK):
                yield chunk

    def follow(self, command: str, on_line: Callable[[str], None]) -> int:
        """See `Shell.follow`."""
        with (
            self._channel(f"exec 2>&1\n{command}", None) as channel,
            channel.makefile("rb") as output,
        ):
            channel.shutdown_write()
            lines = _read_lines(output)
            greeting: deque[str] = deque(maxlen=MOST_GREETING)
            for line in lines:
                if line.endswith(BEGIN):
                    break
                greeting.append(line)
            else:  # no shell ran it: what was said instead tells why
                for line in chain(greeting, _read_lines(channel.makefile_stderr("rb"))):
                    on_line(line)
            for line in lines:
                on_line(line)
            return self._exit_code(channel, None)

    def interact(self, command: str = "") -> int:
        """See `Shell.interact`."""
        with self._border(), self._transport.open_session() as channel:
            give_terminal(channel, command)
            return self._exit_code(channel, None)

    def put(
        self,
        source: Path,
        target: str,
        *,
        mode: int = 0o600,
        on_progress: Callable[[int, int], None] | None = None,
    ) -> None:
        """See `Shell.put`."""
        send_file(self, self._feed, source, target, mode, on_progress)

    def get(
        self, source: str, target: Path, *, on_progress: Callable[[int, int], None] | None = None
    ) -> None:
        """See `Shell.get`."""
        fetch_file(self, self._read, source, target, on_progress)

    def forward(self, address: str, port: int) -> int:
        """See `Shell.forward`."""
        forwarder = Forwarder(self._transport, address, port)
        self._closer.callback(forwarder.close)
        return forwarder.port

    def close(self) -> None:
        """End the connection."""
        self._closer.close()

    @contextmanager
    def _channel(self, command: str, timeout_s: float | None) -> Iterator[paramiko.Channel]:
        """Start a command, under a shell that turns a signal into an exit code."""
        begin = f"echo '{BEGIN}'; echo '{BEGIN}' >&2"
        script = f"{begin}\n{command}\nexit $?"
        with self._border(command, timeout_s), self._transport.open_session() as channel:
            channel.settimeout(timeout_s)
            with _answered(channel, CHANNEL_S if timeout_s is None else timeout_s):
                whole = f"sh -c {shlex.quote(script)}"
                channel.exec_command(os.fsencode(whole))  # names are bytes
            yield channel

    @contextmanager
    def _border(self, command: str = "", timeout_s: float | None = None) -> Iterator[None]:
        """Turn what paramiko and the system raise into our errors."""
        try:
            yield
        except TimeoutError as error:
            if self._transport.is_active() and timeout_s is not None:
                raise ReachError(
                    f"{self.node}: {shorten(command, 60)!r} did not end within {timeout_s:.0f} s",
                    "",
                    LoginFault.SILENT,
                ) from error
            raise self._lost(error) from error
        except (OSError, EOFError, paramiko.SSHException) as error:
            raise self._lost(error) from error

    def _limited(self, chunks: Iterator[bytes]) -> Iterator[bytes]:
        """Hand chunks on, up to what an answer may have."""
        size = 0
        for chunk in chunks:
            size += len(chunk)
            if size > MOST_OUTPUT:
                raise CloudError(
                    f"{self.node}: a command says more than {MOST_OUTPUT >> 20} MiB",
                    "look at the machine: no answer is as long",
                )
            yield chunk

    def _lost(self, error: BaseException) -> ReachError:
        """Say why the connection is no more; what ended it knows more than who waited for it."""
        return ReachError(f"{self.node}: {self._transport.wire.fault or explain(error)}")

    def _exit_code(self, channel: paramiko.Channel, deadline: float | None) -> int:
        timeout_s = None if deadline is None else max(0.0, deadline - time.monotonic())
        if not channel.status_event.wait(timeout_s):
            raise TimeoutError
        code = channel.recv_exit_status()
        if code >= 0:
            return code
        # paramiko says -1 both where a signal ended the command and where the connection went
        if not self._transport.is_active():
            raise EOFError
        return _NO_CODE


def _said(text: str) -> str:
    """Return what a command has said; all that there is where no shell ran it."""
    before, mark, after = text.partition(f"{BEGIN}\n")
    return after if mark else before


@contextmanager
def _answered(channel: paramiko.Channel, limit_s: float) -> Iterator[None]:
    """Close a channel whose request is not answered in time; paramiko would wait for ever."""
    is_late = threading.Event()

    def give_up() -> None:
        is_late.set()
        channel.close()

    timer = threading.Timer(limit_s, give_up)
    timer.daemon = True
    timer.start()
    try:
        yield
    except paramiko.SSHException:
        if is_late.is_set():
            raise TimeoutError from None
        raise
    finally:
        timer.cancel()
        timer.join()


def _feed(channel: paramiko.Channel, stdin: Iterable[bytes]) -> None:
    """Write what a command reads; one that has ended before tells by its code why."""
    for chunk in stdin:
        try:
            channel.sendall(chunk)
        except TimeoutError:
            raise
        except OSError:
            return
    channel.shutdown_write()


def _chunks(channel: paramiko.Channel, deadline: float) -> Iterator[bytes]:
    """Yield the output until its end; TimeoutError where that does not come in time."""
    while True:
        channel.settimeout(max(0.01, deadline - time.monotonic()))
        chunk = channel.recv(_CHUNK)
        if not chunk:
            return
        yield chunk


def _collect(channel: paramiko.Channel, errors: list[bytes]) -> None:
    """Read stderr beside stdout: a full window of either would stop the command."""
    size = 0
    try:
        while chunk := channel.recv_stderr(_CHUNK):
            size += len(chunk)
            if size <= MOST_OUTPUT:  # what comes later is read, and dropped
                errors.append(chunk)
    except (OSError, EOFError, paramiko.SSHException):
        return  # the reader of stdout learns of it too


def _read_lines(output: paramiko.ChannelFile) -> Iterator[str]:
    """Yield what a command says, line by line; of a line that is too long, pieces."""
    while line := output.readline(LONGEST_LINE):
        yield line.decode(errors="replace").rstrip("\r\n")
