"""Servers on loopback that are no SSH servers, or none that a client would wish for."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

Act = Callable[[socket.socket, threading.Event], None]


def silent(client: socket.socket, is_over: threading.Event) -> None:
    """Accept, and say nothing: so does a machine that hangs."""
    is_over.wait()


def slow(client: socket.socket, is_over: threading.Event) -> None:
    """Say a byte now and then."""
    for letter in b"SSH-2.0-slow" * 1000:
        if is_over.wait(0.1):
            return
        client.sendall(bytes([letter]))


def endless(client: socket.socket, is_over: threading.Event) -> None:
    """Say one line without an end."""
    while not is_over.is_set():
        client.sendall(b"A" * 65536)


def lines(client: socket.socket, is_over: threading.Event) -> None:
    """Say lines without an end."""
    while not is_over.is_set():
        client.sendall(b"welcome, stranger\r\n" * 1000)


def binary(client: socket.socket, is_over: threading.Event) -> None:
    client.sendall(b"\x16\x03\x01\x1b[2J\xff\xfe\n" + bytes(range(256)) + b"\n")
    is_over.wait()


def web(client: socket.socket, is_over: threading.Event) -> None:
    client.sendall(b"HTTP/1.1 400 Bad Request\r\n\r\n")


def shut(client: socket.socket, is_over: threading.Event) -> None:
    """Close at once."""


def old(client: socket.socket, is_over: threading.Event) -> None:
    client.sendall(b"SSH-1.5-ancient\r\n")
    is_over.wait()


def frozen(client: socket.socket, is_over: threading.Event) -> None:
    """Greet, and stop."""
    client.sendall(b"SSH-2.0-frozen\r\n")
    is_over.wait()


def garbage(client: socket.socket, is_over: threading.Event) -> None:
    client.sendall(b"SSH-2.0-garbage\r\n" + bytes(range(256)) * 16)
    is_over.wait()


def flood(client: socket.socket, is_over: threading.Event) -> None:
    """Greet, and announce a packet of 4 GB."""
    client.sendall(b"SSH-2.0-flood\r\n" + b"\xff\xff\xff\xfc" + bytes(1 << 12))
    while not is_over.is_set():
        client.sendall(bytes(1 << 16))


ACTS: dict[str, Act] = {
    act.__name__: act
    for act in (silent, slow, endless, lines, binary, web, shut, old, frozen, garbage, flood)
}


@contextmanager
def open_rude(act: Act, address: str = "127.0.0.1") -> Iterator[int]:
    """Run a server; yield its port."""
    is_over = threading.Event()
    listener = socket.create_server((address, 0), backlog=1024)
    threads: list[threading.Thread] = []

    def serve(client: socket.socket) -> None:
        with client, suppress(OSError):
            act(client, is_over)

    def accept() -> None:
        while True:
            try:
                client, _ = listener.accept()
            except OSError:
                return
            thread = threading.Thread(target=serve, args=(client,), name="rude")
            threads.append(thread)
            thread.start()

    acceptor = threading.Thread(target=accept, name="rude-accept")
    acceptor.start()
    try:
        yield listener.getsockname()[1]
    finally:
        is_over.set()
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()
        acceptor.join()
        for thread in threads:
            thread.join()
