"""What both ends' sockets have in common: bounded queues, heartbeats, and failures in words."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import zmq

__all__ = ["bound_socket", "describe_event", "open_monitor", "send_heartbeats"]

HIGH_WATER_MARK = 1000  # messages; the credit window stays far below, so that it is never reached
LINGER_MS = 500  # long enough for a farewell on a live link, short enough not to be felt on exit
HEARTBEAT_MS = 1000
HEARTBEAT_TIMEOUT_MS = 4000
HANDSHAKE_MS = 5000
# A control frame holds headers of up to 4 MiB and at most 1 MB of further tasks.
FRAME_ALLOWANCE = 8 * 1024 * 1024

MONITORED_EVENTS = (
    zmq.Event.HANDSHAKE_FAILED_AUTH
    | zmq.Event.HANDSHAKE_FAILED_NO_DETAIL
    | zmq.Event.HANDSHAKE_FAILED_PROTOCOL
    | zmq.Event.DISCONNECTED
)
_WORDS = {
    zmq.Event.HANDSHAKE_FAILED_AUTH: "a peer was refused: its key is not on the list",
    zmq.Event.HANDSHAKE_FAILED_PROTOCOL: "a peer with a wrong key, or without CURVE, was refused",
    zmq.Event.HANDSHAKE_FAILED_NO_DETAIL: "a peer broke off the handshake: its key, or the key it "
    "holds of this end, is wrong",
}


def bound_socket(socket: zmq.Socket[bytes], largest_frame: int) -> None:
    """Set the limits that keep one peer from hanging or filling the other.

    Parameters
    ----------
    socket : zmq.Socket
        Not yet bound or connected.
    largest_frame : int
        Longest buffer frame that the peer may send, in bytes; libzmq drops peers that send more.
    """
    socket.setsockopt(zmq.LINGER, LINGER_MS)
    socket.setsockopt(zmq.SNDHWM, HIGH_WATER_MARK)
    socket.setsockopt(zmq.RCVHWM, HIGH_WATER_MARK)
    socket.setsockopt(zmq.MAXMSGSIZE, largest_frame + FRAME_ALLOWANCE)
    socket.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)


def send_heartbeats(socket: zmq.Socket[bytes]) -> None:
    """Have ZeroMQ probe the connection from this end, which each end then takes the time of.

    For the component only. The master learns of a peer that has gone silent from the time to live
    that the probes carry: were it to probe too, libzmq 4.3 would abort it, because the timer of a
    probe writes to a connection that has broken while its peer's messages were waiting to be read
    ("Assertion failed: !_io_error").

    Parameters
    ----------
    socket : zmq.Socket
        Not yet connected.
    """
    socket.setsockopt(zmq.HEARTBEAT_IVL, HEARTBEAT_MS)
    socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, HEARTBEAT_TIMEOUT_MS)
    socket.setsockopt(zmq.HEARTBEAT_TTL, HEARTBEAT_TIMEOUT_MS)


@contextmanager
def open_monitor(socket: zmq.Socket[bytes]) -> Iterator[zmq.Socket[bytes]]:
    """Watch a socket's connections; give the socket from which `describe_event` reads.

    libzmq's own thread waits for room where a monitor's queue is full or its reader is gone, and
    everything else with it, the end too. So the queue has no bound, and the watch ends first.

    Parameters
    ----------
    socket : zmq.Socket
        Not yet bound or connected; closed after this.
    """
    endpoint = f"inproc://monitor-{id(socket)}"
    with socket.context.socket(zmq.PAIR) as reader:
        reader.setsockopt(zmq.LINGER, 0)
        reader.setsockopt(zmq.RCVHWM, 0)
        socket.monitor(endpoint, MONITORED_EVENTS)
        try:
            reader.connect(endpoint)
            yield reader
        finally:
            socket.disable_monitor()


def describe_event(frames: Sequence[bytes]) -> str | None:
    """Say in words what a socket monitor reported.

    Parameters
    ----------
    frames : sequence of bytes
        A message from a monitor socket: event and value, then the endpoint.

    Returns
    -------
    str or None
        None for a disconnection, which is no failure by itself.
    """
    number, _ = struct.unpack("=hi", frames[0])
    return _WORDS.get(zmq.Event(number))
