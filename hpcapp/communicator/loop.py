"""The communicator's thread: feeds the scheduler, and carries out what it decides.

::

    submit, cancel (any thread) ──> inbox ──┐
    RouterTransport ── messages ────────────┼──> scheduler ──> actions ──> transport, futures
    clock ── ticks, probes ─────────────────┘
"""

from __future__ import annotations

import logging
import secrets
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterable, Sequence

from hpcapp.communicator.fetching import Fetcher, TakeBuffers
from hpcapp.communicator.pending import PendingTasks
from hpcapp.communicator.results import open_results
from hpcapp.communicator.scheduling.scheduler import Scheduler
from hpcapp.communicator.scheduling.state import (
    Action,
    AskRegister,
    Assign,
    Deliver,
    Dismiss,
    Fail,
    Forgotten,
    Refuse,
    Retire,
    Welcome,
    Worker,
)
from hpcapp.communicator.submission import Submission
from hpcapp.communicator.transport import Received, RouterTransport
from hpccomponent.clock import Clock
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import JobError, ProtocolError, UsageError
from hpccomponent.protocol.frames import LARGEST_FRAME, Buffer, join_frames, split_buffers
from hpccomponent.protocol.messages import (
    Announce,
    Batch,
    ComponentMessage,
    Drain,
    Farewell,
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
    Results,
    Share,
    decode_component_message,
    encode_message,
)
from hpccomponent.protocol.parcels import LARGE_BYTES

_BROKEN = "its connection broke"
_FLOODS = "it sent a message without end, or more of them than can be taken"

_log = logging.getLogger(__name__)

CLOSE_S = 5.0  # what closes is given half a second; whatever holds it up longer is left behind
MOST_REASON = 1000  # characters of what a worker is told, and others of it
MESSAGES_PER_ROUND = 200  # then the inbox and the clock have their turn


@dataclass(frozen=True, slots=True)
class Timing:
    """How often the parties speak, and how long they listen; all in seconds.

    A component's heartbeats are `heartbeat_s` apart, probes of every connection `probe_s`. A worker
    is lost after `liveness_s` without a message, a component leaves after `silence_s` without one
    from the master, and tasks fail after `worker_wait_s` without any worker.
    """

    heartbeat_s: float = 1.0
    liveness_s: float = 15.0
    silence_s: float = 60.0
    worker_wait_s: float = 60.0
    probe_s: float = 0.5


class EventLoop:
    """One thread that owns the sockets, the scheduler, and the results of futures.

    It closes the transport.
    """

    def __init__(
        self,
        scheduler: Scheduler,
        pending: PendingTasks,
        transport: RouterTransport,
        clock: Clock,
        timing: Timing,
    ) -> None:
        self.session = secrets.token_hex(8)
        self.counts: Counter[str] = Counter()
        self.workers_changed = threading.Condition()
        self.scheduler = scheduler
        self.pending = pending
        self._fetcher = Fetcher(self.session)
        self._transport = transport
        self._clock = clock
        self._timing = timing
        self._inbox: deque[Callable[[], list[Action]]] = deque()
        self._is_asleep = False
        self._is_closing = False
        self._is_abandoned = False
        self._probe_at = clock.now()
        self._end: JobError | None = None
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="communicator", daemon=True)
        self._thread.start()

    # -- from any thread -----------------------------------------------------------------------

    def post(self, event: Callable[[], list[Action]]) -> None:
        """Have the event loop's thread call `event`, and carry out the actions that it returns."""
        self._inbox.append(event)
        if self._is_asleep:
            self._is_asleep = False  # one waker is enough
            self._transport.wake()

    def submit(self, number: int, submission: Submission) -> None:
        """Take a task."""
        self.pending.add(number, submission)
        self.post(lambda: self.scheduler.submit(submission.task(number)))
        if self._end is not None:  # nobody would ever answer
            self.pending.fail_all(self._end)

    def cancel(self, number: int) -> None:
        """Forget a task whose future was cancelled."""

        def event() -> list[Action]:
            return self.scheduler.cancel(number) if self.pending.is_cancelled(number) else []

        self.post(event)

    def close(self, abandon: bool = False) -> None:
        """End the thread once all tasks are done, or at once, failing those that are not."""

        def event() -> list[Action]:
            self._is_closing = True
            self._is_abandoned = self._is_abandoned or abandon
            return []

        self.post(event)

    def join(self, timeout_s: float | None = None) -> None:
        """Wait for all futures, `timeout_s` at most, and then a little for the sockets to close."""
        if self._is_over.wait(timeout_s):
            self._thread.join(CLOSE_S)

    # -- on the event loop's thread ----------------------------------------------------------------

    def _run(self) -> None:
        reason = "the communicator was shut down"
        try:
            while not (self._is_closing and (self._is_abandoned or not len(self.pending))):
                self._is_asleep = True
                patience_s = max(0.0, self._probe_at - self._clock.now())
                # The flag first, then the look: a post in between sees the flag, and wakes.
                self._transport.wait(0.0 if self._inbox else min(patience_s, 0.5))
                self._is_asleep = False
                self._take_inbox()
                self._turn_flooders_away()
                self._take_messages()
                self._keep_time()
            for identity in self.scheduler.workers:
                self._say(identity, Farewell(self.session))
        except BaseException as error:
            # Whatever it is, nobody may wait for ever for a future of ours.
            _log.exception("the communicator broke")
            reason = f"the communicator broke: {error!r}"
        finally:
            self._end = JobError(reason, "submit the work anew")
            self.pending.fail_all(self._end)
            self._is_over.set()
            self._transport.close()

    def _take_inbox(self) -> None:
        if not self._inbox:
            return
        while self._inbox:
            self._carry_out(self._inbox.popleft()())
        self._carry_out(self.scheduler.dispatch())

    def _turn_flooders_away(self) -> None:
        for key in self._transport.take_flooders():
            for worker in list(self.scheduler.workers.values()):
                if worker.key == key:
                    self._carry_out(self.scheduler.expose(worker.identity, _FLOODS))

    def _take_messages(self) -> None:
        for _ in range(MESSAGES_PER_ROUND):
            received = self._transport.receive()
            if received is None:
                return
            sender = self.scheduler.workers.get(received.identity)
            try:
                if sender is not None and sender.key != received.key:
                    raise ProtocolError("it came under another key than its sender registered with")
                self._take_message(received, decode_component_message(received.head))
            except ProtocolError as error:
                self.counts["dropped"] += 1
                reason = error.problem[:MOST_REASON]
                _log.warning("a message of %r was dropped: %s", received.identity[:100], reason)
                if sender is not None and sender.key == received.key:
                    self._carry_out(self.scheduler.expose(received.identity, reason))

    def _take_message(self, received: Received, message: ComponentMessage) -> None:
        worker, scheduler = received.identity, self.scheduler
        if isinstance(message, Register):
            self._carry_out(scheduler.register(worker, message, received.key))
            self._announce()
            return
        if message.session != self.session and worker in scheduler.workers:
            self.counts["dropped"] += 1
            return
        match message:
            case Announce() | Piece():
                self._fetch(worker, message)
            case Results() | Lost():
                if self._fetcher.is_fetching(worker):
                    self._fetch(worker, message)
                else:
                    self._take_unasked(received, message)
            case Heartbeat():
                self._take_heartbeat(worker, message)
            case Need():
                self._take_need(worker, message)
            case Goodbye():
                self._carry_out(scheduler.goodbye(worker, message.reason))

    def _take_heartbeat(self, worker: bytes, message: Heartbeat) -> None:
        if worker in self.scheduler.workers:
            self._fetcher.heartbeat(worker, message)
            self._ask(worker)
        held_batches = [*message.held, *self._fetcher.batches(worker)]
        self._carry_out(
            self.scheduler.heartbeat(worker, message.progress, message.last_batch, held_batches)
        )

    def _fetch(self, identity: bytes, message: Announce | Piece | Results | Lost) -> None:
        """Take what has to do with a parcel, and then whatever is complete by that."""
        worker, fetcher = self.scheduler.workers.get(identity), self._fetcher
        if worker is None:
            self.counts["dropped"] += 1
            self._carry_out([AskRegister(identity)])
            return
        worker.seen = self._clock.now()
        match message:
            case Announce():
                limits = self._limits(worker, message.batch, message.tasks)
                fetcher.announce(identity, message, limits)
            case Piece():
                request = fetcher.take(identity, message.fetch)
                self._ask(identity)  # before this one is copied
                if request is not None:  # head and payload are cut into frames apart
                    request.fill(self._take_frames(identity, request.sizes))
            case Lost():
                fetcher.wait(identity, message, [])
            case Results():
                sizes = [size for result in message.results for size in result.sizes]
                fetcher.wait(identity, message, self._take_frames(identity, sizes))
        self._ask(identity)
        for complete, take_buffers in fetcher.complete(identity):
            self._take_in_order(identity, complete, take_buffers)
        self._ask(identity)

    def _ask(self, worker: bytes) -> None:
        for request in self._fetcher.requests(worker):
            self._say(worker, request)

    def _take_in_order(
        self, worker: bytes, message: Results | Lost, take_buffers: TakeBuffers
    ) -> None:
        if isinstance(message, Results):
            self._take_results(worker, message, take_buffers)
            return
        self._carry_out(
            self.scheduler.batch_lost(worker, message.batch, message.reason, message.is_blamed)
        )

    def _take_unasked(self, received: Received, message: Results | Lost) -> None:
        worker = received.identity

        def take_buffers(sizes: Sequence[int]) -> list[Buffer]:
            return join_frames(self._take_frames(worker, sizes), sizes)

        self._take_in_order(worker, message, take_buffers)
        if isinstance(message, Results) and worker in self.scheduler.workers:
            size = len(received.head) + sum([sum(result.sizes) for result in message.results])
            self._fetcher.note_taken(worker, message, size)
            self._ask(worker)

    def _take_frames(self, worker: bytes, sizes: Sequence[int]) -> list[memoryview]:
        """Receive the frames of buffers of these sizes, and no more.

        Raise ProtocolError where they are more than a worker may send unasked, and than one piece.
        """
        if sum(sizes) > LARGE_BYTES:
            raise ProtocolError(f"it sends {sum(sizes)} bytes that were not asked for")
        largest = min(LARGEST_FRAME, self.scheduler.workers[worker].register.largest_frame)
        most_frames = sum([-(-size // largest) for size in sizes])
        return self._transport.take_frames(most_frames, sum(sizes))

    def _limits(self, worker: Worker, batch: int, tasks: Sequence[int]) -> list[int]:
        assignments = self.scheduler.dispatcher.assignments
        return assignments.most_bytes(worker, batch, tasks, self.scheduler.tasks)

    def _take_results(self, identity: bytes, message: Results, take_buffers: TakeBuffers) -> None:
        """Take results once all of them are what they must be; of a liar, none."""
        worker, answers = self.scheduler.workers.get(identity), []
        if worker is not None:
            limits = self._limits(worker, message.batch, [r.task for r in message.results])
            answers = open_results(message.results, limits, take_buffers, self.pending.find)
        actions = self.scheduler.results(
            identity,
            message.batch,
            message.results,
            message.is_finished,
            lambda index: answers[index].digest(),
        )
        maker = self.scheduler.workers.get(identity)
        # The next batch leaves first: whoever waits for a result may take its time with it.
        self._carry_out([action for action in actions if not isinstance(action, Deliver)])
        for action in actions:
            if isinstance(action, Deliver):
                name = None if maker is None else maker.machine
                self.pending.deliver(action.task, action.result, answers[action.index].value, name)

    def _take_need(self, worker: bytes, message: Need) -> None:
        # A value that was changed after it was shared is refused by every worker, for ever.
        for number in self.pending.find_changed(message.keys):
            error = UsageError(
                "a shared value was changed while tasks use it",
                "change a copy, or share it once it is complete",
            )
            self.pending.fail(number, error)
            self._carry_out(self.scheduler.cancel(number))
        self._carry_out(self.scheduler.need(worker, message.batch, message.keys))

    def _keep_time(self) -> None:
        now = self._clock.now()
        if not self._transport.take_disconnected() and now < self._probe_at:
            return
        self._probe_at = now + self._timing.probe_s
        self._fetcher.retain(self.scheduler.workers)
        ping = Ping(self.session, self.scheduler.dispatcher.assignments.last, self._fetcher.last)
        broken = [identity for identity in self.scheduler.workers if not self._say(identity, ping)]
        if broken:
            self._carry_out(self.scheduler.disconnected(broken, _BROKEN))
        self._carry_out(self.scheduler.tick())
        self._announce()

    def _announce(self) -> None:
        with self.workers_changed:
            self.workers_changed.notify_all()

    def _carry_out(self, actions: Iterable[Action]) -> None:
        remaining = deque(actions)
        while remaining:
            action = remaining.popleft()
            match action:
                case Assign():
                    if not self._assign(action):
                        remaining.extend(
                            self.scheduler.undelivered(action.worker, action.batch, _BROKEN)
                        )
                case Retire():
                    _log.warning("%s gets no more of this job: %s", action.machine, action.reason)
                case Fail():
                    self.pending.fail(action.task, action.error)
                case Welcome():
                    timing = self._timing
                    self._say(
                        action.worker,
                        Registered(
                            self.session, timing.heartbeat_s, timing.silence_s, action.largest_frame
                        ),
                    )
                case Refuse():
                    _log.warning("a worker was refused: %s", action.reason)
                    self._say(action.worker, Refused(action.reason))
                case AskRegister():
                    self._say(action.worker, RegisterAgain())
                case Forgotten():
                    self._say(action.worker, Forget(self.session, [action.key]))
                case Dismiss():
                    self._say(action.worker, Drain(self.session))

    def _say(self, identity: bytes, message: MasterMessage) -> bool:
        return self._transport.send(identity, [encode_message(message)])

    def _assign(self, action: Assign) -> bool:
        worker = self.scheduler.workers.get(action.worker)
        if worker is None:
            return True  # an earlier action found it lost; its tasks have been placed anew
        largest = min(LARGEST_FRAME, worker.register.largest_frame)
        for blob in action.blobs:
            sizes = [len(buffer) for buffer in blob.buffers]
            share = encode_message(Share(self.session, blob.key, blob.header, sizes))
            self.counts["blobs"] += 1
            if not self._transport.send(
                action.worker, [share, *split_buffers(blob.buffers, largest)]
            ):
                return False
        calls, buffers = self.pending.calls(action.tasks)
        self.counts["batches"] += 1
        message = encode_message(Batch(self.session, action.batch, calls))
        return self._transport.send(action.worker, [message, *split_buffers(buffers, largest)])
