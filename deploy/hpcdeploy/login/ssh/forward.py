"""A local port that leads through an SSH connection.

::

    program ──> 127.0.0.1:PORT ──accept──> two threads for each connection ──channel──> machine
"""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable

import paramiko

_CHUNK = 1 << 16


class Forwarder:
    """Listens on loopback until it is closed; what is open then ends with the SSH connection."""

    def __init__(self, transport: paramiko.Transport, address: str, port: int) -> None:
        self._transport = transport
        self._address = (address, port)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._start(self._accept)

    def close(self) -> None:
        """Stop listening."""
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)  # wakes the thread that accepts
        self._listener.close()

    def _start(self, target: Callable[..., None], *arguments: object) -> threading.Thread:
        name = f"forward-{self.port}"
        thread = threading.Thread(target=target, args=arguments, name=name, daemon=True)
        thread.start()
        return thread

    def _accept(self) -> None:
        with contextlib.suppress(OSError):  # the listener is closed
            while True:
                self._start(self._lead, *self._listener.accept())

    def _lead(self, local_end: socket.socket, origin: tuple[str, int]) -> None:
        """Carry one connection to its end."""
        with local_end, contextlib.suppress(paramiko.SSHException, EOFError, OSError):
            remote_end = self._transport.open_channel("direct-tcpip", self._address, origin)
            back = self._start(_pump, remote_end, local_end)
            _pump(local_end, remote_end)
            back.join()


def _pump(source: socket.socket | paramiko.Channel, sink: socket.socket | paramiko.Channel) -> None:
    """Carry bytes one way until either end is gone."""
    with contextlib.suppress(OSError, EOFError, paramiko.SSHException):
        while chunk := source.recv(_CHUNK):
            sink.sendall(chunk)
    _cut(source)
    _cut(sink)


def _cut(end: socket.socket | paramiko.Channel) -> None:
    with contextlib.suppress(OSError, EOFError):
        end.shutdown(2)  # wakes the thread that reads
    end.close()
