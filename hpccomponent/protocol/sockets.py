"""What both ends' sockets have in common: bounded queues, probes, and failures in words."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import zmq

HIGH_WATER_MARK = 1000  # messages; the credit window stays far below, so that it is never reached
LINGER_MS = 500  # long enough for a farewell on a live link, short enough not to be felt on exit
PROBE_MS = 250  # often: a probe's time to live is forgotten with the next message
SILENCE_MS = 4000
HANDSHAKE_MS = 5000
# A control frame holds headers of up to 4 MiB and at most 1 MB of further tasks.
FRAME_ALLOWANCE = 8 * 1024 * 1024

MONITORED_EVENTS = (
    zmq.Event.HANDSHAKE_FAILED_AUTH
    | zmq.Event.HANDSHAKE_FAILED_PROTOCOL
    | zmq.Event.DISCONNECTED
    | zmq.Event.ACCEPTED
)
_WORDS = {
    zmq.Event.HANDSHAKE_FAILED_AUTH: "a peer was refused: its key is not on the list",
    zmq.Event.HANDSHAKE_FAILED_PROTOCOL: "a peer with a wrong key, or without CURVE, was refused",
    zmq.Event.HANDSHAKE_FAILED_NO_DETAIL: "it broke off the handshake; where it always does, a key "
    "in the connection file is wrong",
}


def bound_socket(socket: zmq.Socket[bytes], largest_frame: int) -> None:
    """Set the limits that keep peers from hanging or filling a socket, not yet bound or connected.

    libzmq drops peers that send frames of buffers of more than `largest_frame` bytes.
    """
    socket.setsockopt(zmq.LINGER, LINGER_MS)
    socket.setsockopt(zmq.SNDHWM, HIGH_WATER_MARK)
    socket.setsockopt(zmq.RCVHWM, HIGH_WATER_MARK)
    socket.setsockopt(zmq.MAXMSGSIZE, largest_frame + FRAME_ALLOWANCE)
    socket.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)


def accept_probes(socket: zmq.Socket[bytes]) -> None:
    """Have a socket that will listen find out which peers are silent, without probes of its own.

    A peer whose machine vanishes or is suspended is found by TCP, as the master's messages are not
    confirmed, and one that is frozen by the time to live that its last probe has named. Probes of
    this end would be nothing but a danger: libzmq 4.3 aborts the process when it is to probe a
    connection that has broken while messages of the peer waited ("Assertion failed: !_io_error").
    """
    socket.setsockopt(zmq.TCP_MAXRT, SILENCE_MS)


def send_probes(socket: zmq.Socket[bytes]) -> None:
    """Have ZeroMQ probe a socket, not yet connected, from this end; see `accept_probes`."""
    socket.setsockopt(zmq.HEARTBEAT_IVL, PROBE_MS)
    socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, SILENCE_MS)
    socket.setsockopt(zmq.HEARTBEAT_TTL, SILENCE_MS)


@contextmanager
def open_monitor(
    socket: zmq.Socket[bytes], tells_breaks: bool = False
) -> Iterator[zmq.Socket[bytes]]:
    """Watch a socket, not yet bound or connected; give that whose messages `read_event` takes.

    libzmq's own thread waits for room where a monitor's queue is full or its reader is gone, and
    everything else with it, the end too. So the queue has no bound, and the watch ends before the
    watched socket is closed. With `tells_breaks` handshakes are reported that the peer breaks off:
    one that listens where a key is wrong, one that connects only where it ends or loses patience.
    """
    breaks = zmq.Event.HANDSHAKE_FAILED_NO_DETAIL if tells_breaks else 0
    endpoint = f"inproc://monitor-{id(socket)}"
    with socket.context.socket(zmq.PAIR) as reader:
        reader.setsockopt(zmq.LINGER, 0)
        reader.setsockopt(zmq.RCVHWM, 0)
        socket.monitor(endpoint, MONITORED_EVENTS | breaks)
        try:
            reader.connect(endpoint)
            yield reader
        finally:
            socket.disable_monitor()


def read_event(frames: Sequence[bytes]) -> tuple[zmq.Event, int]:
    """Return what a socket monitor reported, with its value: a connection's descriptor, mostly.

    The frames are event and value, then the endpoint.
    """
    number, value = struct.unpack("=hi", frames[0])
    return zmq.Event(number), value


def describe_event(event: zmq.Event) -> str | None:
    """Say in words what has failed; None where nothing has, as for a disconnection by itself."""
    return _WORDS.get(event)
