"""A connection as paramiko uses it: bounded in bytes before the login, and in silence after it.

::

    paramiko's thread ── recv, send ──> BoundedSocket ──> socket, or a channel of the machine before
                                         └── what was said so far, for whoever explains a failure

A stranger on the other end may say anything, in any amount, or nothing at all.
"""

from __future__ import annotations

import errno
import logging
import re
import socket
import threading
import time
from contextlib import ExitStack, suppress

import paramiko

from hpccomponent.dataclass import dataclass

CHANNEL_S = 60.0
"""Until a machine that lets us in opens a channel, or answers a request on one."""
GREETING_BYTES = 1 << 16
LOGIN_BYTES = 1 << 20
_GREETING = re.compile(rb"(?:^|\n)SSH-[^\n]*\n")
_CHUNK = 1 << 18
_LOG = "hpcapp.ssh"


@dataclass(frozen=True, slots=True)
class SshTimeouts:
    """How long a connection is waited for, in seconds.

    `login_s` is for all from the name's look-up to the login, over all machines on the way. The
    other end is asked every `beat_s` whether it is there; with no byte for `silence_s` the
    connection is given up.
    """

    login_s: float = 30.0
    beat_s: float = 15.0
    silence_s: float = 60.0


class BoundedSocket:
    """A socket or a channel, as a transport reads and writes it."""

    def __init__(self, wire: socket.socket | paramiko.Channel, silence_s: float) -> None:
        self._socket = wire
        self._silence_s = silence_s
        self._heard = time.monotonic()
        self._counted = 0
        self._is_logged_in = False
        self._closed = False  # by this name paramiko asks for it
        self.said = bytearray()
        """What came before and with the greeting."""
        self.is_ssh = False
        """Whether the greeting was that of SSH."""
        self.fault = ""
        """Why we have ended the connection."""

    def logged_in(self) -> None:
        """Count no longer."""
        self._is_logged_in = True
        self.said.clear()

    def recv(self, size: int) -> bytes:
        """Read some bytes; TimeoutError where there are none yet.

        Raises OSError where the connection is lost, silent too long, or says more than logins need.
        """
        try:
            chunk = self._socket.recv(min(size, _CHUNK))
        except OSError as error:
            if _is_early(error):
                self._check_silence()
                raise
            raise _numbered(error) from error
        self._heard = time.monotonic()
        if not self._is_logged_in:
            self._count(chunk)
        return chunk

    def send(self, content: bytes) -> int:
        """Write some bytes; TimeoutError where nothing can be written yet.

        Raises OSError where the connection is lost.
        """
        try:
            return self._socket.send(content)
        except OSError as error:
            if _is_early(error):
                raise
            raise _numbered(error) from error

    def settimeout(self, timeout_s: float | None) -> None:
        """Set how long one call may take, in seconds; None for any time."""
        self._socket.settimeout(timeout_s)

    def close(self) -> None:
        """End the connection."""
        self._closed = True
        self._socket.close()

    def _check_silence(self) -> None:
        if self._is_logged_in and time.monotonic() - self._heard > self._silence_s:
            self.fault = f"it has not answered for {self._silence_s:.0f} s"
            raise OSError(errno.ECONNABORTED, self.fault)  # ETIMEDOUT would be tried again

    def _count(self, chunk: bytes) -> None:
        self._counted += len(chunk)
        if not self.is_ssh:
            self.said += chunk
            self.is_ssh = _GREETING.search(self.said) is not None
        if self._counted > (LOGIN_BYTES if self.is_ssh else GREETING_BYTES):
            self.fault = "it says more than any login needs"
            raise OSError(errno.EMSGSIZE, self.fault)


def _is_early(error: OSError) -> bool:
    """Tell a call that was given up, to be made again, from a connection that has timed out."""
    return isinstance(error, TimeoutError) and error.errno is None


def _numbered(error: OSError) -> OSError:
    """Return an error with a number: paramiko fails over those of its own channels, without one."""
    if error.errno is None or isinstance(error, TimeoutError):
        return OSError(errno.ECONNRESET, str(error) or "closed")
    return error


class SshConnection(paramiko.Transport):
    """A transport that keeps its words, and what goes wrong in its thread, off the terminal."""

    def __init__(self, wire: BoundedSocket) -> None:
        super().__init__(wire)  # type: ignore[arg-type]  # recv, send, settimeout, close are enough
        self.wire = wire
        self.channel_timeout = CHANNEL_S  # paramiko's own is an hour
        self.set_log_channel(_LOG)

    def run(self) -> None:
        """Serve the connection; `get_exception` tells why it ended."""
        try:
            super().run()
        except Exception as error:  # whatever it is, it must end as the others do
            logging.getLogger(_LOG).debug("the connection's thread failed", exc_info=True)
            self.saved_exception = error
            self.active = False
            self.packetizer.close()
            if self.completion_event is not None:
                self.completion_event.set()
            if self.auth_handler is not None:
                self.auth_handler.abort()
            for event in list(self.channel_events.values()):
                event.set()

    def keep_alive(self, beat_s: float, closer: ExitStack) -> None:
        """Ask the other end each `beat_s` seconds for any answer, until `closer` closes."""
        is_over = threading.Event()
        closer.callback(is_over.set)
        threading.Thread(
            target=self._beat, args=(beat_s, is_over), name="ssh-beat", daemon=True
        ).start()

    def _beat(self, beat_s: float, is_over: threading.Event) -> None:
        with suppress(OSError, EOFError, paramiko.SSHException):
            while not is_over.wait(beat_s) and self.is_active():
                self.global_request("keepalive@openssh.com", wait=True)


def _is_wanted(record: logging.LogRecord) -> bool:
    """Let what paramiko logs, tracebacks among it, through only where everything is logged."""
    del record
    return logging.getLogger("hpcapp").isEnabledFor(logging.DEBUG)


logging.getLogger(_LOG).addFilter(_is_wanted)
