"""A local port that leads through an SSH connection.

::

    program ──> 127.0.0.1:PORT ──accept──> two threads for each connection ──channel──> machine
"""

from __future__ import annotations

import contextlib
import socket
import threading

import paramiko

_CHUNK = 1 << 16


class Forwarder:
    """Listens on loopback until it is closed."""

    def __init__(self, transport: paramiko.Transport, address: str, port: int) -> None:
        self._transport = transport
        self._address = (address, port)
        self._lock = threading.Lock()
        self._ends: list[socket.socket | paramiko.Channel] = []
        self._threads: list[threading.Thread] = []
        self._is_closing = False
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._start(self._accept)

    def close(self) -> None:
        """Stop listening, and cut what is open."""
        with self._lock:
            self._is_closing = True
            ends = list(self._ends)
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)  # wakes the thread that accepts
        self._listener.close()
        for end in ends:
            _cut(end)
        for thread in list(self._threads):
            thread.join()

    def _start(self, target: object, *arguments: object) -> None:
        thread = threading.Thread(
            target=target,  # type: ignore[arg-type]
            args=arguments,
            name=f"forward-{self.port}",
            daemon=True,
        )
        self._threads.append(thread)
        thread.start()

    def _accept(self) -> None:
        while True:
            try:
                local_end, origin = self._listener.accept()
            except OSError:
                return
            try:
                remote_end = self._transport.open_channel("direct-tcpip", self._address, origin)
            except (paramiko.SSHException, EOFError, OSError):
                local_end.close()  # the program sees a connection that ends at once
                continue
            with self._lock:
                self._ends += [local_end, remote_end]
                is_late = self._is_closing
            if is_late:
                _cut(local_end)
                _cut(remote_end)
            self._start(_pump, local_end, remote_end)
            self._start(_pump, remote_end, local_end)


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
