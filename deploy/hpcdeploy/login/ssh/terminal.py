"""The user's terminal, given to a command on another machine."""

from __future__ import annotations

import contextlib
import os
import selectors
import signal
import sys
from collections.abc import Iterator
from types import FrameType

import paramiko

_CHUNK = 1 << 14


def give_terminal(channel: paramiko.Channel, command: str) -> None:
    """Run a command, or a login shell, on this process's stdin, stdout and stderr, to its end.

    `channel` is a fresh session; an empty `command` is a login shell. With a terminal on stdin
    there is one on the other side too, of the same size, and every key goes there; without one,
    bytes go through as they are.
    """
    is_terminal = os.isatty(0)
    if is_terminal:
        size = os.get_terminal_size(0)
        channel.get_pty(os.environ.get("TERM", "vt100"), size.columns, size.lines)
    if command:
        channel.exec_command(os.fsencode(command))
    else:
        channel.invoke_shell()
    with _raw_terminal(channel) if is_terminal else contextlib.nullcontext():
        _relay(channel)


@contextlib.contextmanager
def _raw_terminal(channel: paramiko.Channel) -> Iterator[None]:
    """Hand every key over, and every change of the window's size."""
    import termios
    import tty

    def resize(signum: int, frame: FrameType | None) -> None:
        del signum, frame
        size = os.get_terminal_size(0)
        with contextlib.suppress(OSError, paramiko.SSHException):
            channel.resize_pty(size.columns, size.lines)

    settings = termios.tcgetattr(0)
    before = signal.signal(signal.SIGWINCH, resize)
    try:
        tty.setraw(0)
        yield
    finally:
        signal.signal(signal.SIGWINCH, before)
        termios.tcsetattr(0, termios.TCSADRAIN, settings)


def _relay(channel: paramiko.Channel) -> None:
    """Carry bytes both ways until the command has ended and all it said is written."""
    with selectors.SelectSelector() as selector:  # the others cannot wait for a plain file
        selector.register(channel, selectors.EVENT_READ)
        selector.register(0, selectors.EVENT_READ)
        while True:
            ready = {key.fileobj for key, _ in selector.select()}
            if 0 in ready:
                if chunk := os.read(0, _CHUNK):
                    channel.sendall(chunk)
                else:
                    selector.unregister(0)
                    channel.shutdown_write()
            if channel in ready and not _write_out(channel):
                return


def _write_out(channel: paramiko.Channel) -> bool:
    """Write what has come; False at its end."""
    if channel.recv_stderr_ready():
        sys.stderr.buffer.write(channel.recv_stderr(_CHUNK))
        sys.stderr.flush()
        return True
    if channel.recv_ready() or channel.eof_received or channel.closed:
        chunk = channel.recv(_CHUNK)
        sys.stdout.buffer.write(chunk)
        sys.stdout.flush()
        return bool(chunk)
    return True
