"""Ends connections that send more than their messages: libzmq alone has no bound for that.

::

    libzmq's monitor ──> accepted, closed ──┐
    RouterTransport  ──> bytes taken ───────┼──> on their way = received by TCP - taken
    TCP_INFO         ──> bytes received ────┘           │
                                                 too many of one key: shutdown, key reported

libzmq hands over whole messages, and holds any number of frames of one that never ends. So what
each connection has received is compared with what was taken from it, whenever this process has
grown. Linux only: elsewhere nothing is watched.
"""

from __future__ import annotations

import mmap
import os
import socket
import struct
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path

from hpccomponent.dataclass import dataclass

MOST_ON_THE_WAY = 16 << 20
"""In bytes, of the connections of one key: 8 MiB that were asked for, 2 MiB that were not, and as
much again. A frame of a byte takes 36 of them, and 64 in memory."""

INTERVAL_S = 0.1
GROWTH_BYTES = 16 << 20  # of this process, between two looks at all connections
PROBE_BYTES_PER_S = 256  # of ZeroMQ's heartbeats, which are no messages: measured 182
BYTES_RECEIVED_AT = 128  # in the kernel's struct tcp_info
PAGE_BYTES = mmap.PAGESIZE


def wire_bytes(frame_bytes: int) -> int:
    """Return how much a frame takes in a CURVE connection, in bytes."""
    return frame_bytes + (35 if frame_bytes <= 222 else 42)


@dataclass(slots=True, eq=False)
class WatchedConnection:
    """One connection of the listening socket, by what libzmq says of it.

    `key` is empty until a message has come of which it is certain that it came this way.
    """

    descriptor: int
    since: float
    round: int
    key: str = ""
    taken: int = 0  # by the event loop's thread; what follows belongs to that of the watch
    probes: int = 0
    on_the_way: int = 0
    is_ended: bool = False

    def look(self, received: int, now: float) -> None:
        """Take how many bytes had been received in all; what probes take is no message."""
        probes = int((now - self.since) * PROBE_BYTES_PER_S)
        self.since = now
        on_the_way = received - self.taken - self.probes
        probes = max(0, min(probes, on_the_way))  # silence is not saved up for later
        self.probes += probes
        self.on_the_way = on_the_way - probes


def choose_to_end(
    connections: Iterable[WatchedConnection],
) -> tuple[list[WatchedConnection], list[str]]:
    """Return which connections send without end, and the keys that this is certain of.

    Of a key that has too much on the way all are, of those without a known key the worst.
    """
    by_key: dict[str, list[WatchedConnection]] = defaultdict(list)
    for connection in connections:
        by_key[connection.key].append(connection)
    chosen: list[WatchedConnection] = []
    keys = []
    for key, group in by_key.items():
        excess = sum(connection.on_the_way for connection in group) - MOST_ON_THE_WAY
        if excess > 0 and key:
            chosen += group
            keys.append(key)
        for worst in sorted(group, key=lambda c: -c.on_the_way) if not key else ():
            if excess <= 0:
                break
            chosen.append(worst)
            excess -= worst.on_the_way
    return chosen, keys


class ConnectionWatch:
    """Watches the connections of one listening socket, on a thread of its own.

    The port is 0 where the socket listens on no TCP port: then nothing is watched. `report` is
    called on that thread with the key (Z85) of every connection that is ended for its sending
    without end; with an empty one where that is not known.
    """

    is_possible = sys.platform == "linux"

    def __init__(self, port: int, report: Callable[[str], None]) -> None:
        self._port = port
        self._report = report
        self._connections: dict[int, WatchedConnection] = {}
        self._round = 0
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="connections", daemon=True)
        if self.is_possible and port:
            self._thread.start()

    def accepted(self, descriptor: int) -> None:
        """Note a new connection, before anything is taken from it."""
        self._connections[descriptor] = WatchedConnection(descriptor, time.monotonic(), self._round)

    def closed(self, descriptor: int) -> None:
        """Note the end of a connection."""
        self._connections.pop(descriptor, None)

    def take(self, descriptor: int, key: str, size_bytes: int) -> None:
        """Note a message that was taken from a connection.

        That may be closed, and another one may have its descriptor's number.
        """
        connection = self._connections.get(descriptor)
        if connection is not None:
            connection.taken += size_bytes
            if connection.round < self._round:  # no message of a former one was left to be taken
                connection.key = key

    def taken_all(self) -> None:
        """Note that no message waits to be taken."""
        self._round += 1

    def close(self) -> None:
        """End the thread."""
        self._is_over.set()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self) -> None:
        size = least = 0
        with Path("/proc/self/statm").open("rb", buffering=0) as statm:
            while not self._is_over.wait(INTERVAL_S):
                size = int(os.pread(statm.fileno(), 100, 0).split()[1]) * PAGE_BYTES
                least = min(least, size)
                if size - least > GROWTH_BYTES:
                    least = size
                    self._look()

    def _look(self) -> None:
        now = time.monotonic()
        for connection in list(self._connections.values()):
            try:
                received = self._count_received(connection.descriptor)
            except OSError:  # closed by this end, which libzmq does not report
                self._connections.pop(connection.descriptor, None)
            else:
                connection.look(received, now)
        open_ones = [c for c in list(self._connections.values()) if not c.is_ended]
        chosen, keys = choose_to_end(open_ones)
        for key in keys:  # before the connections are seen to be broken
            self._report(key)
        for connection in chosen:
            connection.is_ended = True
            if not connection.key:
                self._report("")
            self._end(connection.descriptor)

    def _count_received(self, descriptor: int) -> int:
        """Return how many bytes have come; OSError where it is no connection of ours (any more)."""
        # Borrowed, not owned: detached in any case, so that nobody but libzmq closes it.
        connection = socket.socket(socket.AF_INET, socket.SOCK_STREAM, 0, descriptor)
        try:
            if connection.getsockname()[1] != self._port:
                raise OSError("another file has this number now")
            info = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, BYTES_RECEIVED_AT + 8)
        finally:
            connection.detach()
        (received,) = struct.unpack_from("=Q", info, BYTES_RECEIVED_AT)
        return int(received)

    def _end(self, descriptor: int) -> None:
        with suppress(OSError), socket.socket(fileno=os.dup(descriptor)) as connection:
            if connection.getsockname()[1] == self._port:
                # Reset when libzmq closes it: the peer would wait for room for a minute else.
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                connection.shutdown(socket.SHUT_RDWR)
