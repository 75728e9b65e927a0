"""A worker's session and the master's fetcher, on a wire of the test's own that loses messages."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import pytest

from hpcapp.communicator.fetching import (
    MOST_ASKED_BYTES,
    PIECE_BYTES,
    WINDOW_BYTES,
    Fetcher,
    PieceRequest,
)
from hpccomponent.errors import ProtocolError
from hpccomponent.protocol.frames import Buffer
from hpccomponent.protocol.messages import (
    Announce,
    Batch,
    Call,
    ComponentMessage,
    Drain,
    Fetch,
    Goodbye,
    Heartbeat,
    Lost,
    MasterMessage,
    Piece,
    Ping,
    Register,
    Registered,
    Release,
    Result,
    Results,
    encode_message,
)
from hpccomponent.protocol.parcels import UNASKED_BYTES
from hpccomponent.protocol.session import Action, Send, WorkerSession

WORKER = b"worker"
LARGE = 3 * UNASKED_BYTES + 5
REGISTER = Register(1, "1", "w", "i", "b", "n", 1, 1, 1 << 20)


def content_of(task: int, size: int) -> bytes:
    return (task.to_bytes(8, "little") * (size // 8 + 1))[:size]


def never(message: object) -> bool:
    del message
    return False


class Wire:
    """A session whose worker has any number of batches, a fetcher, and what is between them."""

    def __init__(self) -> None:
        self.session = WorkerSession(REGISTER, 0.0)
        self.fetcher = Fetcher("s")
        self.taken: list[tuple[int, bytes]] = []
        self.said: list[MasterMessage | ComponentMessage] = []  # by either, what got lost with it
        self.up: deque[tuple[ComponentMessage, list[Buffer]]] = deque()
        self.down: deque[MasterMessage] = deque()
        self.is_delivering = False
        self.now = 0.0
        self.is_lost: Callable[[object], bool] = never
        self.session.begin()
        self.session.worker_started()
        self.tell(Registered("s", 1.0, 1000.0, 1 << 20))

    def finish(self, task: int, size: int) -> None:
        """Have a batch of one task done, whose result has this size."""
        self.tell(Batch("s", task, [Call(task, "t", b"", [])]))
        results = Results("s", task, [Result(task, 0.1, b"", [size])], True)
        value = memoryview(content_of(task, size))
        self.carry_out(
            self.session.worker_results(results, encode_message(results), value, self.now)
        )

    def beat(self) -> None:
        """Let a ping and a heartbeat pass."""
        self.tell(Ping("s", 1000, self.fetcher.last))
        self.now += 2.0
        self.carry_out(self.session.tick(self.now))

    def tell(self, message: MasterMessage) -> None:
        self.said.append(message)
        if not self.is_lost(message):
            self.down.append(message)
        self.deliver()

    def carry_out(self, actions: list[Action]) -> None:
        for action in actions:
            if isinstance(action, Send):
                self.said.append(action.message)
                if not self.is_lost(action.message):
                    self.up.append((action.message, list(action.buffers)))
        self.deliver()

    def deliver(self) -> None:
        """Let everything arrive, in order, but for what is said by what arrives just now."""
        if self.is_delivering:
            return
        self.is_delivering = True
        while self.up or self.down:
            while self.down:
                self.carry_out(self.session.receive(self.down.popleft(), (), self.now))
            if self.up:
                self.hear(*self.up.popleft())
        self.is_delivering = False

    def hear(self, message: ComponentMessage, buffers: list[Buffer]) -> None:
        fetcher = self.fetcher
        if isinstance(message, Results) and not fetcher.is_fetching(WORKER):
            self.taken.append((message.batch, bytes(buffers[0])))
            fetcher.note_taken(WORKER, message, len(buffers[0]))
        elif isinstance(message, Results):
            fetcher.wait(WORKER, message, buffers)
        elif isinstance(message, Announce):
            fetcher.announce(WORKER, message, [LARGE])
        elif isinstance(message, Heartbeat):
            fetcher.heartbeat(WORKER, message)
        elif isinstance(message, Piece):
            asked = fetcher.take(WORKER, message.fetch)
            assert asked is not None
            asked.fill(buffers)
        for complete, take_buffers in fetcher.complete(WORKER):
            assert isinstance(complete, Results)
            (value,) = take_buffers(complete.results[0].sizes)
            self.taken.append((complete.batch, bytes(value)))
        for request in list(fetcher.requests(WORKER)):
            self.tell(request)

    def count(self, kind: type) -> int:
        return sum(isinstance(message, kind) for message in self.said)


def first_of(kind: type) -> Callable[[object], bool]:
    """Lose the first message of a kind."""
    seen: list[object] = []

    def is_lost(message: object) -> bool:
        if isinstance(message, kind) and not seen:
            seen.append(message)
            return True
        return False

    return is_lost


def test_small_results_are_sent_at_once_and_large_ones_are_fetched_in_order() -> None:
    wire = Wire()
    sizes = {1: 100, 2: LARGE, 3: 100, 4: LARGE, 5: 100}
    for task, size in sizes.items():
        wire.finish(task, size)
    assert wire.taken == [(task, content_of(task, size)) for task, size in sizes.items()]
    assert wire.count(Announce) == 2
    assert wire.count(Fetch) >= 2 * LARGE // PIECE_BYTES


def test_a_component_that_is_drained_leaves_when_its_last_result_is_fetched() -> None:
    wire = Wire()
    wire.is_lost = lambda message: isinstance(message, Fetch)
    wire.finish(1, LARGE)
    wire.tell(Drain("s"))
    assert not wire.count(Goodbye)
    wire.is_lost = never
    wire.beat()
    assert wire.taken == [(1, content_of(1, LARGE))]
    assert wire.count(Goodbye) == 1


@pytest.mark.parametrize("kind", [Fetch, Piece, Release, Heartbeat, Ping])
def test_what_gets_lost_is_asked_for_again(kind: type) -> None:
    wire = Wire()
    wire.is_lost = first_of(kind)
    wire.finish(1, LARGE)
    for _ in range(2):
        wire.beat()
    assert wire.taken == [(1, content_of(1, LARGE))]
    assert len(wire.session._parcels) == 0
    wire.finish(2, LARGE)
    assert wire.taken[1:] == [(2, content_of(2, LARGE))]


def test_an_announcement_that_got_lost_is_not_kept_for_ever() -> None:
    wire = Wire()
    wire.is_lost = first_of(Announce)
    wire.finish(1, LARGE)
    assert len(wire.session._parcels) == 1
    wire.beat()
    assert len(wire.session._parcels) == 0
    assert wire.taken == []  # the heartbeat does not name the batch: it is sent again


def test_little_is_sent_unasked_however_many_results_there_are() -> None:
    wire = Wire()
    wire.is_lost = lambda message: isinstance(message, Release | Fetch)
    for task in range(1, 30):
        wire.finish(task, UNASKED_BYTES // 10)
    wire.carry_out(wire.session.worker_died("it crashed"))
    assert wire.count(Results) == 9
    assert wire.count(Announce) == wire.count(Lost) == 0
    wire.beat()
    (heartbeat,) = [message for message in wire.said if isinstance(message, Heartbeat)]
    assert heartbeat.held == [*range(10, 30)]
    wire.is_lost = never
    for _ in range(3):
        wire.beat()
    assert [task for task, _ in wire.taken] == list(range(1, 30))


def announce(number: int, size: int) -> Announce:
    return Announce("s", number, number, [number], 100, size)


def asked_bytes(requests: list[Fetch | Release]) -> int:
    return sum(request.end - request.start for request in requests if isinstance(request, Fetch))


def test_what_is_on_its_way_is_bounded_for_each_and_for_all() -> None:
    fetcher = Fetcher("s")
    size = 2 * WINDOW_BYTES
    shares = []
    for number in range(100):
        worker = str(number).encode()
        fetcher.announce(worker, announce(1, size), [size])
        shares.append(asked_bytes(list(fetcher.requests(worker))))
    assert shares[0] == WINDOW_BYTES
    assert min(shares) == PIECE_BYTES  # nobody waits for all others
    assert sum(shares) <= MOST_ASKED_BYTES + 100 * PIECE_BYTES
    fetcher.retain([b"99"])
    again = Fetcher.requests(fetcher, b"99")
    assert asked_bytes(list(again)) == WINDOW_BYTES - PIECE_BYTES


def fetch_first(fetcher: Fetcher) -> PieceRequest:
    fetcher.announce(WORKER, announce(1, 1000), [1000])
    (request,) = fetcher.requests(WORKER)
    assert isinstance(request, Fetch)
    asked = fetcher.take(WORKER, request.fetch)
    assert asked is not None
    return asked


def test_liars_are_found_out() -> None:
    fetcher = Fetcher("s")
    with pytest.raises(ProtocolError, match="are allowed"):
        fetcher.announce(WORKER, announce(1, 2000), [1000])
    with pytest.raises(ProtocolError, match="a head of"):
        fetcher.announce(WORKER, Announce("s", 1, 1, [1], 2**40, 0), [1000])
    with pytest.raises(ProtocolError, match="nobody asked for"):
        fetcher.take(WORKER, 1)
    with pytest.raises(ProtocolError, match="not what was asked for"):
        fetch_first(fetcher).fill([b"short"])


@pytest.mark.parametrize(
    "content",
    [
        b"\xc1" * 1100,
        encode_message(Heartbeat("s", 0, 0, [])) + bytes(1000),
        encode_message(Results("s", 1, [Result(2, 0.0, b"", [1000])], True)) + bytes(1000),
    ],
)
def test_a_parcel_must_hold_what_was_announced(content: bytes) -> None:
    fetcher = Fetcher("s")
    head = len(content) - 1000
    fetcher.announce(WORKER, Announce("s", 1, 1, [1], head, 1000), [1000])
    (request,) = fetcher.requests(WORKER)
    assert isinstance(request, Fetch)
    asked = fetcher.take(WORKER, request.fetch)
    assert asked is not None
    asked.fill([content])
    with pytest.raises(ProtocolError):
        list(fetcher.complete(WORKER))


def test_a_parcel_that_nobody_waits_for_is_not_fetched() -> None:
    fetcher = Fetcher("s")
    fetcher.announce(WORKER, announce(1, 1000), [0])
    assert list(fetcher.complete(WORKER)) == []
    assert list(fetcher.requests(WORKER)) == [Release("s", 1)]


def test_what_waits_behind_a_parcel_is_bounded() -> None:
    fetcher = Fetcher("s")
    fetcher.announce(WORKER, announce(1, 1000), [1000])
    results = Results("s", 1, [], False, 2)
    fetcher.wait(WORKER, results, [bytes(UNASKED_BYTES)])
    with pytest.raises(ProtocolError, match="announced before"):
        fetcher.wait(WORKER, results, [b"x"])
    other = b"other"
    with pytest.raises(ProtocolError, match="announced before"):
        list(map(fetcher.wait, [other] * 1000, [Lost("s", 1, "", False)] * 1000, [[]] * 1000))
