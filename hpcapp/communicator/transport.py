"""The ROUTER socket and what guards it; the only module of the App that imports zmq.

::

    any thread ── wake() ──> socket pair ─┐
    components ── CURVE ──> ROUTER ───────┤
    libzmq ── ZAP: may this key in? ──────┼── wait() ──> receive(), take_disconnected()
    libzmq ── monitor: what failed ───────┘
                 └──> ConnectionWatch: who sends without end ──> take_flooders()

Everything but `RouterTransport.wake` is for one thread only.
"""

from __future__ import annotations

import logging
import socket
from collections import Counter, deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack

import zmq
from zmq.utils import z85

from hpcapp.communicator.connection_watch import ConnectionWatch, wire_bytes
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import ProtocolError, UsageError
from hpccomponent.protocol.frames import LARGEST_FRAME, Buffer
from hpccomponent.protocol.keys import KeyPair
from hpccomponent.protocol.sockets import (
    accept_probes,
    bound_socket,
    describe_event,
    open_monitor,
    read_event,
)

_log = logging.getLogger(__name__)

ZAP_ENDPOINT = "inproc://zeromq.zap.01"
ZAP_DOMAIN = b"hpc"
EVENTS_PER_ROUND = 200


@dataclass(frozen=True, slots=True)
class Received:
    """A wire message: who sent it, under which key, and its first frame."""

    identity: bytes
    key: str
    head: memoryview


class RouterTransport:
    """A ROUTER that only known keys reach, and that says what became of a message.

    `bind` is a ZeroMQ endpoint, with port 0 for any free one; UsageError where nothing can listen
    there. `is_allowed` tells of a public key (Z85) whether its owner may connect.
    """

    def __init__(
        self,
        bind: str,
        keys: KeyPair,
        is_allowed: Callable[[str], bool],
    ) -> None:
        self.bytes_sent = 0
        self.bytes_received = 0
        self.problems: Counter[str] = Counter()
        self._is_allowed = is_allowed
        self._was_disconnected = False
        self._has_more = False  # of the message that is being received
        self._source, self._key, self._wire_bytes = 0, "", 0  # likewise
        self._flooders: deque[str] = deque()
        self._turned_away: set[str] = set()
        with ExitStack() as stack:
            reading, self._writing = (stack.enter_context(end) for end in socket.socketpair())
            reading.setblocking(False)
            self._writing.setblocking(False)
            self._waking = reading
            context = stack.enter_context(zmq.Context())
            self._zap = stack.enter_context(context.socket(zmq.REP))
            self._zap.setsockopt(zmq.LINGER, 0)
            self._zap.bind(ZAP_ENDPOINT)
            self._router = stack.enter_context(context.socket(zmq.ROUTER))
            is_watched = ConnectionWatch.is_possible and bind.startswith("tcp:")
            _guard(self._router, keys, is_watched)
            self._monitor = stack.enter_context(open_monitor(self._router))
            try:
                self._router.bind(bind)
            except zmq.ZMQError as error:
                raise UsageError(
                    f"cannot listen on {bind}: {error.strerror}",
                    "give an address of this machine and a free port, as in tcp://127.0.0.1:0",
                ) from error
            self.endpoint: str = self._router.get_string(zmq.LAST_ENDPOINT)
            port = int(self.endpoint.rpartition(":")[2]) if is_watched else 0
            self._watch = ConnectionWatch(port, self._take_flooder)
            stack.callback(self._watch.close)
            self._poller = zmq.Poller()
            for source in (self._router, self._zap, self._monitor, reading):
                self._poller.register(source, zmq.POLLIN)
            self._stack = stack.pop_all()

    def wake(self) -> None:
        """Let `wait` return; from any thread."""
        try:
            self._writing.send(b"w")
        except OSError:
            return  # it is awake already, or closed

    def wait(self, timeout_s: float) -> None:
        """Wait until a message has come, or `wake` was called, or the time is over."""
        ready = dict(self._poller.poll(max(0, int(timeout_s * 1000.0))))
        if self._waking.fileno() in ready:
            self._waking.recv(4096)
        if self._monitor in ready or self._zap in ready:
            # Before a connection may send messages, the watch has to know of it.
            while self._hear_monitor() and self._zap in ready:
                pass
        if self._zap in ready:
            self._judge()

    def receive(self) -> Received | None:
        """Return the beginning of the next message that has come, if any.

        What `take_frames` has not taken of the one before is let go.
        """
        while self._has_more:
            self._receive_frame()
        if not self._router.poll(0):  # cheaper than to catch Again
            self._watch.taken_all()
            return None
        identity, head = self._router.recv(zmq.NOBLOCK, copy=False), None
        self._has_more = identity.more
        self._wire_bytes = 0
        try:
            self._key = str(identity.get("User-Id"))
            self._source = int(identity.get(zmq.SRCFD))
        except zmq.ZMQError:
            self._key, self._source = "", -1  # no handshake, no key: nobody's
        if self._has_more:
            head = self._receive_frame()
        buffer = head.buffer if head is not None else memoryview(b"")
        return Received(identity.bytes, self._key, buffer)

    def take_frames(self, most_frames: int, most_bytes: int) -> list[memoryview]:
        """Return the frames after the first one of the message that `receive` has returned last.

        Raise ProtocolError where there is more: nothing of it is kept.
        """
        frames: list[memoryview] = []
        size = 0
        while self._has_more:
            frame = self._receive_frame()
            size += len(frame)
            if len(frames) == most_frames or size > most_bytes:
                raise ProtocolError("a message carries more than it announces")
            frames.append(frame.buffer)
        return frames

    def _receive_frame(self) -> zmq.Frame:
        frame = self._router.recv(zmq.NOBLOCK, copy=False)
        self._has_more = frame.more
        self.bytes_received += len(frame)
        self._wire_bytes += wire_bytes(len(frame))
        if not self._has_more:
            self._watch.take(self._source, self._key, self._wire_bytes)
        return frame

    def send(self, identity: bytes, frames: Sequence[Buffer]) -> bool:
        """Send a message without waiting; large frames are not copied.

        Return False if there is no way to the receiver, or no room for the message on it. Frames
        must not change until they have been sent; nobody tells when.
        """
        try:
            self._router.send_multipart([identity, *frames], zmq.NOBLOCK, copy=False)
        except zmq.ZMQError as error:
            if error.errno not in (zmq.EHOSTUNREACH, zmq.EAGAIN):
                _log.warning("a message could not be sent: %s", error.strerror)
            return False
        self.bytes_sent += sum([len(frame) for frame in frames])
        return True

    def take_disconnected(self) -> bool:
        """Tell whether some connection has ended since the last call: time to probe them all."""
        was_disconnected, self._was_disconnected = self._was_disconnected, False
        return was_disconnected

    def take_flooders(self) -> list[str]:
        """Return the keys, since the last call, whose connections were ended: they never rest.

        A message that has no end, or more of them than can be taken; no connection is taken under
        these keys any more.
        """
        keys = set()
        while self._flooders:
            key = self._flooders.popleft()
            if key:
                keys.add(key)
                self._turned_away.add(key)
            else:
                self._note("a connection that sent without end was closed; its key is not known")
        return sorted(keys)

    def _take_flooder(self, key: str) -> None:
        self._flooders.append(key)
        self.wake()

    def close(self) -> None:
        """Close all sockets, after half a second at most for what is on its way."""
        self._stack.close()

    def _judge(self) -> None:
        """Answer ZeroMQ's question (RFC 27) whether a key may connect."""
        version, request, _domain, address, _identity, mechanism, *credentials = (
            self._zap.recv_multipart()
        )
        key = ""
        if mechanism == b"CURVE" and len(credentials) == 1:
            key = z85.encode(credentials[0]).decode()
        if key and key not in self._turned_away and self._is_allowed(key):
            self._zap.send_multipart([version, request, b"200", b"OK", key.encode(), b""])
            return
        self._note(f"a peer at {address.decode()} was refused: its key is not on the list")
        self._zap.send_multipart([version, request, b"400", b"key not on the list", b"", b""])

    def _hear_monitor(self) -> bool:
        """Take what the monitor says; True where there is more."""
        for _ in range(EVENTS_PER_ROUND):  # however many knock, messages have their turn
            if not self._monitor.poll(0):
                return False
            event, descriptor = read_event(self._monitor.recv_multipart())
            problem = describe_event(event)
            if event == zmq.Event.ACCEPTED:
                self._watch.accepted(descriptor)
            elif problem is not None:
                self._note(problem)
            else:
                self._watch.closed(descriptor)
                self._was_disconnected = True
        return True

    def _note(self, problem: str) -> None:
        self.problems[problem] += 1
        if self.problems[problem] == 1:  # a peer that keeps trying must not fill the log
            _log.warning("%s", problem)


def _guard(router: zmq.Socket[bytes], keys: KeyPair, is_watched: bool) -> None:
    bound_socket(router, LARGEST_FRAME)
    if is_watched:
        # libzmq aborts the process when a peer leaves behind a full queue, and probes in it
        # ("Assertion failed: !_io_error"). What the queue holds is bounded by the watch.
        router.setsockopt(zmq.RCVHWM, 0)
    accept_probes(router)
    # Without it a message to nobody is lost without a word, and a full queue drops silently.
    router.setsockopt(zmq.ROUTER_MANDATORY, 1)
    # A component that reconnects keeps its identity; another key under it is turned away above.
    router.setsockopt(zmq.ROUTER_HANDOVER, 1)
    router.setsockopt(zmq.CURVE_SERVER, 1)
    router.setsockopt(zmq.CURVE_PUBLICKEY, keys.public.encode())
    router.setsockopt(zmq.CURVE_SECRETKEY, keys.secret.encode())
    router.setsockopt(zmq.ZAP_DOMAIN, ZAP_DOMAIN)
