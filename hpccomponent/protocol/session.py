"""The worker's side of the protocol as a state machine: events in, actions out, time injected.

::

              Registered                    Drain and nothing left, Farewell,
    joining ─────────────> working ───────> Refused, silence, repeated crashes ──> stopped
       ^                      │
       └──────────────────────┘ RegisterAgain

The component (``runtime/component.py``) does the I/O: it feeds in what arrives and carries out
the actions that every event returns.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from enum import Enum, IntEnum

import msgspec

from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.blob_cache import BlobCache
from hpccomponent.protocol.frames import SMALLEST_FRAME, Buffer, cut_payload
from hpccomponent.protocol.messages import (
    Announce,
    Batch,
    ComponentMessage,
    Drain,
    Farewell,
    Fetch,
    Forget,
    Goodbye,
    Heartbeat,
    Lost,
    MasterMessage,
    Need,
    Piece,
    Ping,
    Refused,
    Register,
    RegisterAgain,
    Registered,
    Release,
    Results,
    Share,
)
from hpccomponent.protocol.parcels import LARGE_BYTES, Parcels

REGISTER_S = 2.0  # between two registrations without an answer
WINDOW = 2  # batches in the channel at once: the worker never waits for the next one
MAX_CRASHES = 5  # of the worker in a row, without one finished batch between them
LONGEST_BACKOFF_S = 5.0


class ExitCode(IntEnum):
    """How a component ends, for the loader that started it."""

    DONE = 0  # the master said farewell, the lifeline closed, or SIGTERM came
    WORKER_CRASHES = 1  # the worker keeps dying: another build, or another machine
    REFUSED = 2  # bad connection file, or the master refused: starting it again is no use
    MASTER_SILENT = 5  # the master has been silent for too long


class SessionState(Enum):
    """Where a session stands."""

    JOINING = "joining"
    WORKING = "working"
    DRAINING = "draining"
    STOPPED = "stopped"


@dataclass(frozen=True, slots=True)
class Send:
    """Send a message to the master, with the buffers that it announces."""

    message: ComponentMessage
    buffers: Sequence[Buffer] = ()


@dataclass(frozen=True, slots=True)
class RunBatch:
    """Hand a batch to the worker process, after those of its blobs that the worker lacks."""

    batch: Batch
    frames: Sequence[Buffer]
    blobs: Sequence[bytes] = ()


@dataclass(frozen=True, slots=True)
class Keep:
    """Keep a blob."""

    blob: Share
    frames: Sequence[Buffer]


@dataclass(frozen=True, slots=True)
class Discard:
    """Let blobs go, in the worker process too."""

    keys: Sequence[bytes]


@dataclass(frozen=True, slots=True)
class StartWorker:
    """Start a worker process, `delay_s` seconds from now."""

    delay_s: float


@dataclass(frozen=True, slots=True)
class Stop:
    """End the component."""

    code: ExitCode
    reason: str


Action = Send | RunBatch | Keep | Discard | StartWorker | Stop


@dataclass(frozen=True, slots=True)
class _Outgoing:
    """What is to be said of a batch, once there is room for it: messages keep their order."""

    message: Results | Lost
    head: Buffer = b""
    payload: memoryview = memoryview(b"")


@dataclass(slots=True)
class _HeldBatch:
    batch: Batch
    frames: Sequence[Buffer]
    is_running: bool = False

    @property
    def blobs(self) -> dict[bytes, None]:
        return {key: None for call in self.batch.calls for key in call.blobs}


class WorkerSession:
    """One component's life with its master.

    `register` introduces the component. In seconds, `now` is the present moment of a monotonic
    clock, as in every event, and `silence_s` how long to wait for a master that says nothing, until
    the master names its own figure.
    """

    def __init__(self, register: Register, now: float, silence_s: float = 60.0) -> None:
        self.state = SessionState.JOINING
        self.session = ""
        self.largest_frame = SMALLEST_FRAME
        self.progress = 0
        self.dropped = 0
        self._register = register
        self._silence_s = silence_s
        self._heartbeat_s = REGISTER_S
        self._heard = now
        self._said = now
        self._batches: dict[int, _HeldBatch] = {}
        self._last_batch = 0
        self._last_fetch = 0
        self._crashes = 0
        self._worker_is_up = False
        self._cache = BlobCache(register.blob_bytes)
        self._parcels = Parcels()
        self._outgoing: deque[_Outgoing] = deque()

    def begin(self) -> list[Action]:
        """Introduce the component, and start its worker meanwhile."""
        return [Send(self._register), StartWorker(0.0)]

    def receive(self, message: MasterMessage, frames: Sequence[Buffer], now: float) -> list[Action]:
        """Take a message of the master; one of another session is dropped and counted."""
        if self.state is SessionState.STOPPED:
            return []
        match message:
            case Registered():
                self._join(message, now)
                return []
            case Refused():
                reason = f"the master refused this worker: {message.reason}"
                return self._stop(ExitCode.REFUSED, reason)
            case RegisterAgain():
                self._heard = self._said = now
                if self.state is SessionState.WORKING:
                    self.state = SessionState.JOINING
                return [Send(self._register)]
        if message.session != self.session:
            self.dropped += 1
            return []
        self._heard = now
        return self._obey(message, frames)

    def _obey(self, message: MasterMessage, frames: Sequence[Buffer]) -> list[Action]:
        """Take a message of this session."""
        match message:
            case Farewell():
                return self._stop(ExitCode.DONE, "the master said farewell")
            case Drain():
                self.state = SessionState.DRAINING
                return self._leave_if_drained()
            case Batch():
                return self._take(message, frames)
            case Share():
                return [Keep(message, frames)] if self._cache.put(message) else []
            case Forget():
                self._cache.forget(message.keys)
                return self._tidy() if not self._running() else []  # a busy worker does not listen
            case Fetch():
                return self._answer(message)
            case Release():
                self._parcels.release(message.number)
                return [*self._say_of_batches(), *self._leave_if_drained()]
            case Ping():
                self._last_batch, self._last_fetch = message.last_batch, message.last_fetch
        return []

    def worker_started(self) -> list[Action]:
        """Take the news that the worker process takes batches."""
        self._worker_is_up = True
        return self._feed()

    def worker_results(
        self, results: Results, head: Buffer, payload: memoryview, now: float
    ) -> list[Action]:
        """Take results of the worker, and pass them on, or announce them.

        The payload holds their buffers, laid out for `cut_payload`.
        """
        self.progress += len(results.results)
        self._said = now
        self._outgoing.append(_Outgoing(results, head, payload))
        actions = self._say_of_batches()
        if results.is_finished:
            self._batches.pop(results.batch, None)
            self._crashes = 0
        return [*actions, *self._tidy(), *self._feed(), *self._leave_if_drained()]

    def _say_of_batches(self) -> list[Action]:
        actions: list[Action] = []
        while self._outgoing:
            action = self._say(self._outgoing[0])
            if action is None:
                break
            actions.append(action)
            self._outgoing.popleft()
        return actions

    def _say(self, outgoing: _Outgoing) -> Send | None:
        """Return how results, or a loss, are told to the master; None where they have to wait."""
        message, head, payload = outgoing.message, outgoing.head, outgoing.payload
        if isinstance(message, Lost):
            return Send(message)
        size = len(head) + len(payload)
        if size > LARGE_BYTES:
            number = self._parcels.keep(head, payload)
            tasks = [result.task for result in message.results]
            return Send(
                Announce(message.session, message.batch, number, tasks, len(head), len(payload))
            )
        sent = self._parcels.send(size)
        if sent is None:
            return None
        sizes = [size for result in message.results for size in result.sizes]
        return Send(msgspec.structs.replace(message, number=sent), cut_payload(payload, sizes))

    def _answer(self, fetch: Fetch) -> list[Action]:
        buffers = self._parcels.cut(fetch.parcel, fetch.start, fetch.end)
        if buffers is None:
            self.dropped += 1
            return []
        return [Send(Piece(fetch.session, fetch.fetch), buffers)]

    def worker_died(self, reason: str) -> list[Action]:
        """Take the news that the worker process is gone: its batches are lost.

        The first 1000 characters of the reason are sent to the master.
        """
        self._worker_is_up = False
        self._cache.worker_has.clear()
        if self.state is SessionState.STOPPED:
            return []
        self._crashes += 1
        actions: list[Action] = []
        running = self._running()
        for number in running:
            session = self._batches.pop(number).batch.session
            lost = Lost(session, number, reason[:1000], number == running[0])
            self._outgoing.append(_Outgoing(lost))
        actions += self._say_of_batches()
        if self._crashes >= MAX_CRASHES:
            why = f"the worker process died {self._crashes} times in a row, last: {reason}"
            return [*actions, *self._depart(ExitCode.WORKER_CRASHES, why)]
        if self.state is SessionState.DRAINING and not self._batches:
            return actions + self._leave_if_drained()
        delay_s = 0.0 if self._crashes == 1 else 0.25 * 2.0 ** (self._crashes - 1)
        return [*actions, StartWorker(min(delay_s, LONGEST_BACKOFF_S))]

    def tick(self, now: float) -> list[Action]:
        """Take the time: heartbeats, registration anew, and an end to a silent master."""
        if self.state is SessionState.STOPPED:
            return []
        if now - self._heard > self._silence_s:
            silence = f"the master has been silent for {self._silence_s:g} s"
            return self._stop(ExitCode.MASTER_SILENT, silence)
        if now < self.next_tick():
            return []
        self._said = now
        if self.state is SessionState.JOINING:
            return [Send(self._register)]
        waiting = [outgoing.message.batch for outgoing in self._outgoing]
        heartbeat = Heartbeat(
            self.session,
            self.progress,
            self._last_batch,
            list(dict.fromkeys([*self._batches, *waiting])),
            self._last_fetch,
            self._parcels.last,
            self._parcels.released,
        )
        return [Send(heartbeat)]

    def next_tick(self) -> float:
        """Return when `tick` has something to do next, in seconds of the clock."""
        interval = REGISTER_S if self.state is SessionState.JOINING else self._heartbeat_s
        return min(self._said + interval, self._heard + self._silence_s + 0.001)

    def terminate(self, reason: str) -> list[Action]:
        """Leave at once, unless stopped; the master gives its batches to others, without blame.

        The first 1000 characters of the reason are sent to the master.
        """
        return self._depart(ExitCode.DONE, reason)

    def _join(self, message: Registered, now: float) -> None:
        if message.session != self.session:
            self._last_batch = self._last_fetch = 0
            self._parcels.clear()
            self._outgoing.clear()
            self._batches = {n: batch for n, batch in self._batches.items() if batch.is_running}
        self.session = message.session
        self.largest_frame = min(message.largest_frame, self._register.largest_frame)
        self._heartbeat_s = message.heartbeat_s
        self._silence_s = message.silence_s
        self._heard = self._said = now
        if self.state is SessionState.JOINING:
            self.state = SessionState.WORKING

    def _take(self, batch: Batch, frames: Sequence[Buffer]) -> list[Action]:
        if batch.batch in self._batches:
            self.dropped += 1
            return []
        held_batch = _HeldBatch(batch, frames)
        missing = self._cache.use(held_batch.blobs)
        if missing:
            # Put back rather than held: should this answer get lost, the batch counts as lost too.
            return [Send(Need(batch.session, batch.batch, missing))]
        self._batches[batch.batch] = held_batch
        return [*self._tidy(), *self._feed()]

    def _tidy(self) -> list[Action]:
        """Let go of what has not been used for longest, where more is kept than announced."""
        if not self._cache.is_full():
            return []
        needed = {key for batch in self._batches.values() for key in batch.blobs}
        keys = self._cache.evict(needed)
        return [Discard(keys)] if keys else []

    def _running(self) -> list[int]:
        return [number for number, batch in self._batches.items() if batch.is_running]

    def _feed(self) -> list[Action]:
        if not self._worker_is_up or self.state is SessionState.STOPPED:
            return []
        running = len(self._running())
        waiting = [batch for batch in self._batches.values() if not batch.is_running]
        actions: list[Action] = []
        for batch in waiting[: WINDOW - running]:
            batch.is_running = True
            actions.append(RunBatch(batch.batch, batch.frames, self._cache.hand_over(batch.blobs)))
            batch.frames = ()
        return actions

    def _leave_if_drained(self) -> list[Action]:
        is_busy = self._batches or self._parcels or self._outgoing
        if self.state is SessionState.DRAINING and not is_busy:
            return self._depart(ExitCode.DONE, "drained")
        return []

    def _depart(self, code: ExitCode, reason: str) -> list[Action]:
        if self.state is SessionState.STOPPED:
            return []
        goodbye: list[Action] = [Send(Goodbye(self.session, reason[:1000]))] if self.session else []
        return goodbye + self._stop(code, reason)

    def _stop(self, code: ExitCode, reason: str) -> list[Action]:
        if self.state is SessionState.STOPPED:
            return []
        self.state = SessionState.STOPPED
        return [Stop(code, reason)]
