"""What both ends' sockets have in common: bounded queues, heartbeats, and failures in words."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import zmq

__all__ = ["MONITORED_EVENTS", "bound_socket", "describe_event"]

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


def bound_socket(socket: zmq.Socket[bytes], largest_frame: int, heartbeat_s: float = 1.0) -> None:
    """Set the limits that keep one peer from hanging or filling the other.

    Parameters
    ----------
    socket : zmq.Socket
        Not yet bound or connected.
    largest_frame : int
        Longest buffer frame that the peer may send, in bytes; libzmq drops peers that send more.
    heartbeat_s : float
        How often ZeroMQ itself probes the connection, in seconds; four are waited for an answer.
    """
    socket.setsockopt(zmq.LINGER, LINGER_MS)
    socket.setsockopt(zmq.SNDHWM, HIGH_WATER_MARK)
    socket.setsockopt(zmq.RCVHWM, HIGH_WATER_MARK)
    socket.setsockopt(zmq.MAXMSGSIZE, largest_frame + FRAME_ALLOWANCE)
    socket.setsockopt(zmq.HEARTBEAT_IVL, max(1, int(heartbeat_s * HEARTBEAT_MS)))
    socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, max(1, int(heartbeat_s * HEARTBEAT_TIMEOUT_MS)))
    socket.setsockopt(zmq.HEARTBEAT_TTL, max(1, int(heartbeat_s * HEARTBEAT_TIMEOUT_MS)))
    socket.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)


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
