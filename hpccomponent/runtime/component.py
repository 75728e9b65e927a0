"""The component: I/O around the worker session, on one thread.

::

    master ══ CURVE ══> DEALER ──┐                      ┌──> channel ──> worker process
                                 ├── poll ── session ───┤
    lifeline, SIGTERM ───────────┘                      └──> DEALER ══> master

Heartbeats go on while the worker computes, because the worker is a process of its own.
"""

from __future__ import annotations

import logging
import math
import os
import secrets
import signal
import socket
import time
from collections.abc import Sequence
from contextlib import ExitStack, suppress

import zmq

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import ProtocolError
from hpccomponent.limits import available_cores, total_memory
from hpccomponent.protocol.blobs import check_blob
from hpccomponent.protocol.connection import Connection
from hpccomponent.protocol.frames import (
    LARGEST_FRAME,
    check_payload,
    group_frames,
    split_buffers,
)
from hpccomponent.protocol.messages import (
    PROTOCOL_VERSION,
    Batch,
    Forget,
    Lost,
    Register,
    Results,
    Share,
    decode_component_message,
    decode_master_message,
    encode_message,
)
from hpccomponent.protocol.session import (
    Action,
    Discard,
    ExitCode,
    Keep,
    RunBatch,
    Send,
    StartWorker,
    Stop,
    WorkerSession,
)
from hpccomponent.protocol.sockets import (
    bound_socket,
    describe_event,
    open_monitor,
    read_event,
    send_probes,
)
from hpccomponent.runtime.channel import ChannelClosedError, MemoryFile
from hpccomponent.runtime.numerics import numerics_id, package_version
from hpccomponent.runtime.process import WorkerProcess

_log = logging.getLogger(__name__)

CONNECT_AGAIN_S = 2.0
BLOB_SHARE = 4  # a quarter of the machine's memory keeps blobs


@dataclass(frozen=True, slots=True)
class ComponentOptions:
    """What a component is started with.

    `build` names a worker build of the loader's catalogue; `tasks` are ``NAME=module:function`` of
    those that are no entry points. The component leaves when the other end of the pipe `lifeline`
    closes, or a master has not answered yet after `silence_s` seconds.
    """

    build: str = "portable"
    tasks: Sequence[str] = ()
    lifeline: int | None = None
    silence_s: float = 60.0


def run_component(connection: Connection, options: ComponentOptions) -> ExitCode:
    """Serve one master until it, the lifeline or a signal ends the component."""
    with ExitStack() as stack:
        return _Component(connection, options, stack).run()


class _Component:
    def __init__(self, connection: Connection, options: ComponentOptions, stack: ExitStack) -> None:
        self._options = options
        self._endpoint = connection.endpoint
        self._register = _introduce(connection, options)
        self._session = WorkerSession(self._register, time.monotonic(), options.silence_s)
        self._stop: Stop | None = None
        self._worker: WorkerProcess | None = None
        self._start_at: float | None = None
        self._connect_at: float | None = None
        self._blobs: dict[bytes, MemoryFile] = {}  # that the worker process maps, by their keys
        stack.callback(self._free_blobs)
        stack.callback(self._end_worker)
        context = stack.enter_context(zmq.Context())
        self._socket = stack.enter_context(_open_socket(context, connection, self._register))
        self._monitor = stack.enter_context(open_monitor(self._socket, tells_breaks=True))
        self._signals = stack.enter_context(_catch_signals())
        self._poller = zmq.Poller()
        sources = [self._socket, self._monitor, self._signals, options.lifeline]
        for source in sources:
            if source is not None:
                self._poller.register(source, zmq.POLLIN)
        self._socket.connect(connection.endpoint)

    def run(self) -> ExitCode:
        self._carry_out(self._session.begin())
        while self._stop is None:
            ready = dict(self._poller.poll(self._patience_ms()))
            if self._signals.fileno() in ready:
                self._carry_out(self._session.terminate("this component was told to end"))
            if self._options.lifeline in ready:
                self._carry_out(self._session.terminate("the lifeline closed"))
            if self._worker is not None and self._worker.channel.fileno() in ready:
                self._hear_worker(self._worker)
            if self._socket in ready:
                self._hear_master()
            if self._monitor in ready:
                self._hear_monitor()
            self._keep_time()
        level = logging.INFO if self._stop.code is ExitCode.DONE else logging.ERROR
        _log.log(level, "worker %s leaves: %s", self._register.worker, self._stop.reason)
        return self._stop.code

    def _patience_ms(self) -> int:
        alarms = [self._start_at, self._connect_at]
        moments = [self._session.next_tick(), *(at for at in alarms if at is not None)]
        return max(0, math.ceil((min(moments) - time.monotonic()) * 1000.0))

    def _keep_time(self) -> None:
        now = time.monotonic()
        if self._start_at is not None and now >= self._start_at:
            self._start_at = None
            self._worker = WorkerProcess(self._options.tasks, self._options.build)
            self._poller.register(self._worker.channel.fileno(), zmq.POLLIN)
            self._carry_out(self._session.worker_started())
        if self._connect_at is not None and now >= self._connect_at:
            self._connect_at = None
            self._socket.disconnect(self._endpoint)
            self._socket.connect(self._endpoint)
        self._carry_out(self._session.tick(now))

    def _hear_master(self) -> None:
        while self._stop is None and self._socket.poll(0):  # cheaper than to catch Again
            frames = self._socket.recv_multipart(zmq.NOBLOCK, copy=False)
            try:
                message = decode_master_message(frames[0].buffer)
                buffers = [frame.buffer for frame in frames[1:]]
                if isinstance(message, Batch):
                    group_frames(buffers, _sizes(message))  # or it would fail on its way out
                elif isinstance(message, Share):
                    pieces = group_frames(buffers, message.sizes)
                    check_blob(message.key, message.header, message.sizes, pieces)
            except ProtocolError as error:
                self._session.dropped += 1
                _log.warning("a message was dropped: %s", error)
                continue
            self._carry_out(self._session.receive(message, buffers, time.monotonic()))

    def _hear_worker(self, worker: WorkerProcess) -> None:
        try:
            control, payload = worker.channel.receive()
            results = decode_component_message(control)
            if isinstance(results, Lost):
                raise ProtocolError(results.reason)
            if not isinstance(results, Results):
                raise ProtocolError("the worker process sent something else than results")
            check_payload(payload, [size for result in results.results for size in result.sizes])
        except (ProtocolError, OSError) as error:
            reason = self._end_worker()
            if not isinstance(error, ChannelClosedError):
                reason = str(error)
            _log.warning("%s", reason)
            self._carry_out(self._session.worker_died(reason))
        else:
            now = time.monotonic()
            self._carry_out(self._session.worker_results(results, control, payload, now))

    def _hear_monitor(self) -> None:
        event, _ = read_event(self._monitor.recv_multipart())
        trouble = describe_event(event)
        if trouble is not None:
            _log.warning("the connection to %s failed: %s", self._endpoint, trouble)
        if event in (zmq.Event.HANDSHAKE_FAILED_AUTH, zmq.Event.HANDSHAKE_FAILED_PROTOCOL):
            # ZeroMQ tries no more, but the master may learn of this worker a little later.
            self._connect_at = time.monotonic() + CONNECT_AGAIN_S

    def _carry_out(self, actions: Sequence[Action]) -> None:
        for action in actions:
            match action:
                case Send():
                    self._send(action)
                case RunBatch():
                    self._run(action)
                case Keep():
                    self._keep(action)
                case Discard():
                    self._discard(action)
                case StartWorker():
                    self._start_at = time.monotonic() + action.delay_s
                case Stop():
                    self._stop = action

    def _send(self, action: Send) -> None:
        frames = split_buffers(action.buffers, self._session.largest_frame)
        try:
            message = encode_message(action.message)
            self._socket.send_multipart([message, *frames], zmq.NOBLOCK, copy=False)
        except zmq.Again:
            # The master reads nothing, or is not there: silence will end this component.
            _log.debug("no room to send a %s", type(action.message).__name__)

    def _run(self, action: RunBatch) -> None:
        if self._worker is None:
            return
        try:
            for key in action.blobs:
                self._worker.channel.send_file(self._blobs[key])
            pieces = group_frames(action.frames, _sizes(action.batch))
            self._worker.channel.send(encode_message(action.batch), pieces)
        except (ChannelClosedError, OSError) as error:
            reason = self._end_worker()
            if not isinstance(error, ChannelClosedError):
                reason = f"a batch could not be handed to the worker process: {error}"
            self._carry_out(self._session.worker_died(reason))

    def _keep(self, action: Keep) -> None:
        """Copy a blob out of its frames, once for all tasks."""
        blob, pieces = action.blob, group_frames(action.frames, action.blob.sizes)
        try:
            self._blobs[blob.key] = MemoryFile(encode_message(blob), pieces)
        except OSError as error:
            why = f"there is no room for a blob: {error}"
            self._carry_out(self._session.terminate(why))

    def _discard(self, action: Discard) -> None:
        for key in action.keys:
            self._blobs.pop(key).close()
        if self._worker is not None:
            forget = Forget(self._session.session, list(action.keys))
            with suppress(ChannelClosedError):  # the end of the channel is heard soon
                self._worker.channel.send(encode_message(forget), [])

    def _free_blobs(self) -> None:
        for file in self._blobs.values():
            file.close()

    def _end_worker(self) -> str:
        worker, self._worker = self._worker, None
        if worker is None:
            return ""
        self._poller.unregister(worker.channel.fileno())
        return worker.end()


def _sizes(batch: Batch) -> list[int]:
    return [size for call in batch.calls for size in call.sizes]


def _introduce(connection: Connection, options: ComponentOptions) -> Register:
    memory_bytes = total_memory() or os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return Register(
        protocol=PROTOCOL_VERSION,
        package=package_version(),
        worker=connection.worker,
        incarnation=secrets.token_hex(8),
        build=options.build,
        numerics=numerics_id(options.build),
        cores=available_cores(),
        memory_bytes=memory_bytes,
        largest_frame=LARGEST_FRAME,
        blob_bytes=memory_bytes // BLOB_SHARE,
    )


def _open_socket(
    context: zmq.Context[zmq.Socket[bytes]], connection: Connection, register: Register
) -> zmq.Socket[bytes]:
    dealer = context.socket(zmq.DEALER)
    bound_socket(dealer, LARGEST_FRAME)
    send_probes(dealer)
    dealer.setsockopt(zmq.ROUTING_ID, f"{register.worker}/{register.incarnation}".encode())
    dealer.setsockopt(zmq.CURVE_SERVERKEY, connection.server_key.encode())
    dealer.setsockopt(zmq.CURVE_PUBLICKEY, connection.public_key.encode())
    dealer.setsockopt(zmq.CURVE_SECRETKEY, connection.secret_key.encode())
    return dealer


def _catch_signals() -> socket.socket:
    """Turn SIGTERM into a readable socket, and leave Ctrl-C to the master."""
    reading, writing = socket.socketpair()
    writing.setblocking(False)
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def wake(number: int, frame: object) -> None:
        del number, frame
        # A second SIGTERM may come when the pair is full, or closed because we leave already.
        with suppress(OSError):
            writing.send(b"t")

    signal.signal(signal.SIGTERM, wake)
    return reading
