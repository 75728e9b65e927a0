"""A DEALER over CURVE without libzmq, for what libzmq would not send: messages without an end.

As a program: ``python -m raw_peer CONNECTION_FILE FLOOD`` says "ready" once it floods, and "closed"
when its connections are. The wire is that of RFC 23 (ZMTP 3.1) and RFC 26 (CurveZMQ).
"""

from __future__ import annotations

import itertools
import os
import select
import socket
import struct
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

from nacl import bindings as nacl
from zmq.utils import z85

from hpccomponent.protocol.connection import Connection, read_connection
from hpccomponent.protocol.frames import LARGEST_FRAME
from hpccomponent.protocol.messages import (
    PROTOCOL_VERSION,
    Heartbeat,
    MasterMessage,
    Piece,
    Register,
    Registered,
    Result,
    Results,
    decode_master_message,
    encode_message,
)
from hpccomponent.runtime.numerics import numerics_id, package_version

GREETING = b"\xff" + bytes(8) + b"\x7f\x03\x01" + b"CURVE".ljust(20, b"\0") + bytes(32)
MORE, LONG, COMMAND = 1, 2, 4  # flags of a frame
SEALED_COMMAND = 2  # of what is in it


class RawPeer:
    """One connection; what it sends need not be whole."""

    def __init__(self, connection: Connection, identity: str) -> None:
        self._socket = connect(connection)
        self._nonces = itertools.count(1)
        self._shake_hands(connection, identity.encode())

    def send(self, frames: list[bytes], is_last: bool = True) -> None:
        """Send the frames of a message, the end of it only where `is_last`."""
        flags = [MORE] * (len(frames) - is_last) + [0] * is_last
        self._socket.sendall(b"".join(map(self._seal, flags, frames)))

    def probe(self) -> None:
        """Send a heartbeat of ZeroMQ's own, which wants an answer."""
        self._socket.sendall(self._seal(SEALED_COMMAND, b"\x04PING\x00\x00"))

    def reset(self) -> None:
        """Break the connection, whatever is on its way."""
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        self._socket.close()

    def _seal(self, flags: int, frame: bytes) -> bytes:
        nonce = struct.pack(">Q", next(self._nonces))
        box = nacl.crypto_box_afternm(
            bytes([flags]) + frame, b"CurveZMQMESSAGEC" + nonce, self._shared
        )
        return _frame(b"\x07MESSAGE" + nonce + box, flags & MORE)

    def receive(self) -> MasterMessage:
        """Return the next message of the master; what comes with it is dropped."""
        frames = []
        has_more = True
        while has_more:
            body = self._receive_frame()
            plain = nacl.crypto_box_open_afternm(
                body[16:], b"CurveZMQMESSAGES" + body[8:16], self._shared
            )
            if plain[0] & SEALED_COMMAND:
                continue
            has_more = bool(plain[0] & MORE)
            frames.append(plain[1:])
        return decode_master_message(frames[0])

    def register(self, name: str) -> str:
        """Become a worker, and return the session."""
        numerics = numerics_id("portable")
        message = Register(
            PROTOCOL_VERSION, package_version(), name, "1", "portable", numerics, 1, 1 << 30,
            LARGEST_FRAME,
        )  # fmt: skip
        self.send([encode_message(message)])
        while not isinstance(answer := self.receive(), Registered):
            pass
        return answer.session

    def _shake_hands(self, connection: Connection, identity: bytes) -> None:
        server, own, secret = (
            z85.decode(key)
            for key in (connection.server_key, connection.public_key, connection.secret_key)
        )
        short, short_secret = nacl.crypto_box_keypair()
        self._receive(len(GREETING))
        nonce = struct.pack(">Q", next(self._nonces))
        box = nacl.crypto_box(bytes(64), b"CurveZMQHELLO---" + nonce, server, short_secret)
        hello = b"\x05HELLO\x01\x00" + bytes(72) + short + nonce + box
        self._socket.sendall(_frame(hello, COMMAND))
        welcome = self._receive_frame()
        opened = nacl.crypto_box_open(
            welcome[24:], b"WELCOME-" + welcome[8:24], server, short_secret
        )
        server_short, cookie = opened[:32], opened[32:]
        self._shared = nacl.crypto_box_beforenm(server_short, short_secret)
        vouch_nonce = os.urandom(16)
        vouch = nacl.crypto_box(short + server, b"VOUCH---" + vouch_nonce, server_short, secret)
        metadata = _property(b"Socket-Type", b"DEALER") + _property(b"Identity", identity)
        nonce = struct.pack(">Q", next(self._nonces))
        box = nacl.crypto_box_afternm(
            own + vouch_nonce + vouch + metadata, b"CurveZMQINITIATE" + nonce, self._shared
        )
        self._socket.sendall(_frame(b"\x08INITIATE" + cookie + nonce + box, COMMAND))
        assert self._receive_frame().startswith(b"\x05READY")

    def _receive_frame(self) -> bytes:
        flags, size = self._receive(2)
        if flags & LONG:
            (size,) = struct.unpack(">Q", bytes([size]) + self._receive(7))
        return self._receive(size)

    def _receive(self, size: int) -> bytes:
        content = b""
        while len(content) < size:
            part = self._socket.recv(size - len(content))
            if not part:
                raise ConnectionResetError("the master closed the connection")
            content += part
        return content


def connect(connection: Connection) -> socket.socket:
    """Connect, and greet: what a peer without any key can do."""
    host, port = connection.endpoint.removeprefix("tcp://").rsplit(":", 1)
    connected = socket.create_connection((host, int(port)), timeout=30.0)
    connected.sendall(GREETING)
    return connected


def _frame(body: bytes, flags: int) -> bytes:
    if len(body) < 256:
        return bytes([flags, len(body)]) + body
    return bytes([flags | LONG]) + struct.pack(">Q", len(body)) + body


def _property(name: bytes, value: bytes) -> bytes:
    return bytes([len(name)]) + name + struct.pack(">I", len(value)) + value


def send_for_ever(frame: bytes, count: int = 1) -> Callable[[RawPeer, str], None]:
    """Make a flood: one message without end."""

    def flood(peer: RawPeer, session: str) -> None:
        del session
        while True:
            peer.send([frame] * count, is_last=False)

    return flood


def drip(peer: RawPeer, session: str) -> None:
    """Send a message without end, slowly."""
    del session
    while True:
        peer.send([bytes(64 << 10)], is_last=False)
        time.sleep(0.005)  # the slowness is what this peer is for


def send_heartbeats(peer: RawPeer, session: str) -> None:
    """Send whole messages, as fast as possible."""
    heartbeat = encode_message(Heartbeat(session, 0, 0, []))
    while True:
        peer.send([heartbeat])


def send_heads(peer: RawPeer, session: str) -> None:
    """Send whole messages that are as large as a first frame may be."""
    head = encode_message(Results(session, 1, [Result(1, 0.0, bytes(8_000_000), [])], False))
    while True:
        peer.send([head])


def send_results(peer: RawPeer, session: str) -> None:
    """Send results that nobody waits for."""
    size = 1 << 20
    head = encode_message(Results(session, 1, [Result(1, 0.0, b"\x90", [size])], False))
    while True:
        peer.send([head, *[bytes(1 << 18)] * 4])


def send_pieces(peer: RawPeer, session: str) -> None:
    """Send pieces of results that nobody has asked for."""
    head = encode_message(Piece(session, 1))
    while True:
        peer.send([head, *[bytes(1 << 18)] * 4])


def leave_probes_behind(peer: RawPeer, session: str) -> None:
    """Send more whole messages than a queue holds, with probes between them, and vanish."""
    heartbeat = encode_message(Heartbeat(session, 0, 0, []))
    for _ in range(300):
        for _ in range(20):
            peer.send([heartbeat])
        peer.probe()
    peer.reset()


FLOODS: dict[str, Callable[[RawPeer, str], None]] = {
    "large frames": send_for_ever(bytes(LARGEST_FRAME)),
    "frames of a byte": send_for_ever(b"x", 500),
    "frames of 34 bytes": send_for_ever(bytes(34), 500),
    "a drip": drip,
    "heartbeats": send_heartbeats,
    "heads": send_heads,
    "results": send_results,
    "pieces": send_pieces,
    "probes left behind": leave_probes_behind,
}


def send_to_all(senders: list[Callable[[], None]]) -> None:
    """Send on many connections by turns, until all are closed."""
    while senders:
        for send in list(senders):
            try:
                send()
            except OSError:
                senders.remove(send)


def send_in_waves(connection: Connection) -> None:
    """Send 64 MiB of frames without end, without a key, and again when the master has ended most.

    So it has twice as much to hold at most, however late it looks.
    """
    open_ones: list[socket.socket] = []
    for most in (50, 0):
        wave = [connect(connection) for _ in range(100)]
        for own in wave:
            with suppress(OSError):
                own.sendall(bytes([COMMAND | LONG]) + struct.pack(">Q", 8 << 20))
                own.sendall(bytes((64 << 20) // len(wave)))
        open_ones += wave
        while len(open_ones) > most:
            open_ones = wait_for_an_end(open_ones)


def wait_for_an_end(sockets: list[socket.socket]) -> list[socket.socket]:
    """Wait until the other end closes some connections; return those that are still open."""
    poll = select.poll()
    for own in sockets:
        poll.register(own, select.POLLRDHUP)
    ended = {descriptor for descriptor, _ in poll.poll()}
    return [own for own in sockets if own.fileno() not in ended]


def say(word: str) -> None:
    sys.stdout.write(f"{word}\n")
    sys.stdout.flush()


def main() -> None:
    connection, flood = read_connection(Path(sys.argv[1])), sys.argv[2]
    if flood == "before it registers":
        peer = RawPeer(connection, "silent")
        say("ready")
        with suppress(OSError):
            send_for_ever(bytes(LARGEST_FRAME))(peer, "")
    elif flood == "many connections":
        peers = [RawPeer(connection, f"one of many {number}") for number in range(40)]
        say("ready")
        send_to_all([partial(p.send, [bytes(LARGEST_FRAME)], is_last=False) for p in peers])
    elif flood == "without a key":
        say("ready")
        send_in_waves(connection)
    else:
        peer = RawPeer(connection, connection.worker)
        session = peer.register(connection.worker)
        say("ready")
        with suppress(OSError):
            FLOODS[flood](peer, session)
    say("closed")


if __name__ == "__main__":
    main()
