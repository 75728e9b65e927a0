"""The master's side of parcels: results that stay with a worker until they are asked for.

::

    Announce ──> within the limits? ──> queue of the worker ──> Fetch, Piece, ... ──> complete
    Results, Lost, while a parcel waits ──> behind it                                   │
                                       taken in the order in which they were sent <─────┘

A state machine: no socket, no thread, no clock. What is on its way from a worker at any time is
bounded, and so is what is on its way from all of them; a piece that got lost shows in the next
heartbeat, and is asked for again.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import field

import numpy as np

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import ProtocolError
from hpccomponent.protocol.frames import Buffer, aligned, check_payload, cut_payload, join_frames
from hpccomponent.protocol.messages import (
    Announce,
    Fetch,
    Heartbeat,
    Lost,
    Release,
    Results,
    decode_component_message,
)
from hpccomponent.protocol.parcels import MAX_HEAD_BYTES, UNASKED_BYTES

PIECE_BYTES = 1 << 20
WINDOW_BYTES = 8 << 20  # on its way from one worker: 80 MB/s where the round trip takes 0.1 s
MOST_ASKED_BYTES = 64 << 20  # on its way from all of them, but for one piece of each
MOST_WAITING = 500  # messages behind a parcel: two batches of 64 tasks, and what was taken back
RELEASE_BYTES = UNASKED_BYTES // 8

TakeBuffers = Callable[[Sequence[int]], Sequence[Buffer]]
"""Gives the buffers that came with results, of these sizes; raises where they have others."""


@dataclass(slots=True, eq=False)
class _PartialParcel:
    announce: Announce
    is_wanted: bool
    missing: int
    asked: int = 0  # up to where
    again: deque[tuple[int, int]] = field(default_factory=deque)  # asked for, and lost
    content: memoryview = field(default_factory=lambda: memoryview(b""))

    @property
    def number(self) -> int:
        return self.announce.number

    def take_range(self) -> tuple[int, int] | None:
        """Return from where to where to ask next; it counts as asked for."""
        head, payload = self.announce.head_bytes, self.announce.payload_bytes
        if self.again:
            return self.again.popleft()
        if not self.is_wanted or self.asked == head + payload:
            return None
        if not self.content:  # its pages are not there before they are written to
            before = aligned(head) - head  # so that the payload is aligned
            self.content = np.empty(before + head + payload, np.uint8).data[before:]
        start, self.asked = self.asked, min(head + payload, self.asked + PIECE_BYTES)
        return start, self.asked


@dataclass(frozen=True, slots=True, eq=False)
class _QueuedMessage:
    message: Results | Lost
    frames: Sequence[Buffer]

    @property
    def number(self) -> int | None:
        return self.message.number if isinstance(self.message, Results) else None

    @property
    def size(self) -> int:
        return sum(map(len, self.frames))


@dataclass(frozen=True, slots=True, eq=False)
class PieceRequest:
    """A piece of a parcel that has been asked for."""

    parcel: _PartialParcel
    start: int
    end: int

    @property
    def size(self) -> int:
        """Return how long the piece is, in bytes."""
        return self.end - self.start

    @property
    def sizes(self) -> tuple[int, int]:
        """Return how much of it is of the head, and of the payload: frames hold one of them."""
        head = self.parcel.announce.head_bytes
        of_head = max(0, min(head, self.end) - self.start)
        return of_head, self.size - of_head

    def fill(self, frames: Sequence[Buffer]) -> None:
        """Take the frames of the piece; ProtocolError where its length is not that asked for."""
        if sum(map(len, frames)) != self.size:
            raise ProtocolError("a piece of a result is not what was asked for")
        content, at = self.parcel.content, self.start
        for frame in frames:
            content[at : at + len(frame)] = frame
            at += len(frame)
        self.parcel.missing -= self.size


@dataclass(slots=True, eq=False)
class _WorkerQueue:
    """What a worker has said of its batches, from its first parcel on, in order."""

    items: deque[_PartialParcel | _QueuedMessage] = field(default_factory=deque)
    waiting_bytes: int = 0
    asked: dict[int, PieceRequest] = field(default_factory=dict)
    asked_bytes: int = 0
    heard: int = 0  # the number of the last results that it has sent or announced,
    taken: int = 0  # of the last that are wanted no more,
    said: int = 0  # and of the last of which it knows that
    untold_bytes: int = 0

    def note_taken(self, number: int, size_bytes: int) -> None:
        self.taken = max(self.taken, number)
        self.untold_bytes += size_bytes


class Fetcher:
    """Fetches parcels, and keeps what each worker says in order meanwhile."""

    def __init__(self, session: str) -> None:
        self.last = 0
        self.dropped = 0
        self._session = session
        self._queues: dict[bytes, _WorkerQueue] = {}
        self._asked_bytes = 0

    def is_fetching(self, worker: bytes) -> bool:
        """Tell whether results of this worker must `wait`."""
        return worker in self._queues and bool(self._queues[worker].items)

    def batches(self, worker: bytes) -> set[int]:
        """Return the batches of which something waits."""
        return {
            item.announce.batch if isinstance(item, _PartialParcel) else item.message.batch
            for item in (self._queues[worker].items if worker in self._queues else ())
        }

    def announce(self, worker: bytes, announce: Announce, limits: Sequence[int]) -> None:
        """Take the announcement of a parcel.

        `limits` are how large each of its results may be, in bytes; 0 where nobody waits for it.
        Raise ProtocolError where it is larger, or too much of this worker waits already.
        """
        limit = sum(limits)
        if announce.head_bytes > MAX_HEAD_BYTES:
            raise ProtocolError(f"it announces a head of {announce.head_bytes} bytes")
        # Between buffers, which are of 4 KiB and more, there are up to 63 bytes of padding.
        if limit and announce.payload_bytes > limit + limit // 32:
            raise ProtocolError(
                f"it announces results of {announce.payload_bytes} bytes where {limit} are allowed"
            )
        queue = self._queue(worker)
        if announce.number <= queue.heard:
            self.dropped += 1
            return
        queue.heard = announce.number
        size = announce.head_bytes + announce.payload_bytes
        self._append(queue, _PartialParcel(announce, limit > 0, size if limit else 0), 0)

    def note_taken(self, worker: bytes, results: Results, size_bytes: int) -> None:
        """Note that results which came unasked, and had nothing to wait for, have been taken."""
        self._queue(worker).note_taken(results.number, size_bytes)

    def wait(self, worker: bytes, message: Results | Lost, frames: Sequence[Buffer]) -> None:
        """Keep what a worker has sent until the parcels before it are complete.

        Raise ProtocolError where too much of this worker waits already.
        """
        waiting = _QueuedMessage(message, frames)
        self._append(self._queue(worker), waiting, waiting.size)

    def take(self, worker: bytes, number: int) -> PieceRequest | None:
        """Return what was asked for under this number, once; ProtocolError if nothing ever was."""
        if not 0 < number <= self.last:
            raise ProtocolError(f"it sends piece {number}, which nobody asked for")
        queue = self._queues.get(worker)
        if queue is None or number not in queue.asked:
            self.dropped += 1
            return None
        return self._forget_request(queue, number)

    def heartbeat(self, worker: bytes, message: Heartbeat) -> None:
        """Take what a worker says of requests and results: what got lost is asked for again.

        Messages keep their order: what was asked for up to `last_fetch`, and has not come, is
        lost, and so are results up to `last_results` that are not here.
        """
        queue = self._queue(worker)
        for number in [number for number in queue.asked if number <= message.last_fetch]:
            lost = self._forget_request(queue, number)
            lost.parcel.again.append((lost.start, lost.end))
        waiting = [item.number for item in queue.items if item.number is not None]
        queue.note_taken(waiting[0] - 1 if waiting else message.last_results, 0)
        if message.released < queue.taken:
            queue.said, queue.untold_bytes = message.released, RELEASE_BYTES

    def requests(self, worker: bytes) -> Iterator[Fetch | Release]:
        """Return what the worker is to be told now; it counts as told."""
        queue = self._queues.get(worker)
        if queue is None:
            return
        if queue.said < queue.taken and queue.untold_bytes >= RELEASE_BYTES:
            queue.said, queue.untold_bytes = queue.taken, 0
            yield Release(self._session, queue.taken)
        for item in queue.items:
            while isinstance(item, _PartialParcel) and self._has_room(queue):
                span = item.take_range()
                if span is None:
                    break
                self.last += 1
                request = queue.asked[self.last] = PieceRequest(item, *span)
                queue.asked_bytes += request.size
                self._asked_bytes += request.size
                yield Fetch(self._session, self.last, item.announce.number, *span)

    def complete(self, worker: bytes) -> Iterator[tuple[Results | Lost, TakeBuffers]]:
        """Yield what is complete, with what takes its buffers, up to the first that is not.

        Raise ProtocolError where a parcel holds something else than it announced.
        """
        queue = self._queues.get(worker)
        while queue is not None and queue.items:
            item = queue.items[0]
            if isinstance(item, _PartialParcel) and item.missing:
                return
            queue.items.popleft()
            if isinstance(item, _QueuedMessage):
                queue.waiting_bytes -= item.size
                queue.note_taken(item.number or 0, item.size)
                yield item.message, _frames_taker(item.frames)
                continue
            queue.note_taken(item.number, RELEASE_BYTES)  # told at once
            if item.is_wanted:
                yield _open(item)

    def retain(self, workers: Collection[bytes]) -> None:
        """Forget all workers but these."""
        for worker in [worker for worker in self._queues if worker not in workers]:
            self._asked_bytes -= self._queues.pop(worker).asked_bytes

    def _queue(self, worker: bytes) -> _WorkerQueue:
        return self._queues.setdefault(worker, _WorkerQueue())

    def _append(
        self, queue: _WorkerQueue, item: _PartialParcel | _QueuedMessage, size: int
    ) -> None:
        queue.waiting_bytes += size
        if len(queue.items) >= MOST_WAITING or queue.waiting_bytes > UNASKED_BYTES:
            raise ProtocolError("it sends results, but not those that it has announced before them")
        queue.items.append(item)

    def _has_room(self, queue: _WorkerQueue) -> bool:
        if not queue.asked:
            return True
        is_narrow = self._asked_bytes + PIECE_BYTES > MOST_ASKED_BYTES
        return not is_narrow and queue.asked_bytes + PIECE_BYTES <= WINDOW_BYTES

    def _forget_request(self, queue: _WorkerQueue, number: int) -> PieceRequest:
        request = queue.asked.pop(number)
        queue.asked_bytes -= request.size
        self._asked_bytes -= request.size
        return request


def _frames_taker(frames: Sequence[Buffer]) -> TakeBuffers:
    return lambda sizes: join_frames(frames, sizes)


def _open(parcel: _PartialParcel) -> tuple[Results, TakeBuffers]:
    announce = parcel.announce
    content = parcel.content.toreadonly()
    results = decode_component_message(content[: announce.head_bytes])
    if (
        not isinstance(results, Results)
        or (results.session, results.batch) != (announce.session, announce.batch)
        or [result.task for result in results.results] != announce.tasks
    ):
        raise ProtocolError("a parcel holds something else than it announced")

    def take_buffers(sizes: Sequence[int]) -> Sequence[Buffer]:
        payload = content[announce.head_bytes :]
        check_payload(payload, sizes)
        return cut_payload(payload, sizes)

    return results, take_buffers
