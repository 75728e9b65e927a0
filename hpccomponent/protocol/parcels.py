"""What a component owes its master: results that were sent, or are kept until they are fetched.

::

    results ──> small: sent, as long as little of that kind is on its way ──> Release
            └─> large: a parcel, announced ──> Fetch, Piece, Fetch, Piece ... ──> Release

A component may send little that its master has not asked for, so that the master can tell an
honest one from one that sends without end.
"""

from __future__ import annotations

from collections.abc import Sequence

from hpccomponent.protocol.frames import Buffer

UNASKED_BYTES = 4 << 20
"""How much of results may be on its way that the master has not asked for, heads with them."""

LARGE_BYTES = 1 << 20
"""Results above this wait to be fetched."""

MAX_HEAD_BYTES = 8 << 20  # of one `Results`: its worker sends one of 256 KiB before the next result


class Parcels:
    """The results of one component that have not been released, by number, which count from 1.

    `last` and `released` are the numbers of the last results, and of the last that were released.
    """

    def __init__(self) -> None:
        self._parcels: dict[int, tuple[memoryview, memoryview]] = {}
        self._unasked: dict[int, int] = {}
        self._unasked_bytes = 0
        self.last = 0
        self.released = 0

    def __len__(self) -> int:
        return len(self._parcels)

    def send(self, size_bytes: int) -> int | None:
        """Return a number for results that are sent unasked, or None where they have to wait."""
        if self._unasked_bytes + size_bytes > UNASKED_BYTES:
            return None
        self.last += 1
        self._unasked[self.last] = size_bytes
        self._unasked_bytes += size_bytes
        return self.last

    def keep(self, head: Buffer, payload: Buffer) -> int:
        """Keep a new parcel, its buffers laid out for `cut_payload`, and return its number."""
        self.last += 1
        self._parcels[self.last] = memoryview(head), memoryview(payload)
        return self.last

    def cut(self, parcel: int, start: int, end: int) -> Sequence[Buffer] | None:
        """Return the bytes from `start` to `end` of a parcel, without copying."""
        head, payload = self._parcels.get(parcel, (memoryview(b""), memoryview(b"")))
        size = len(head)
        if not start < end <= size + len(payload):
            return None
        parts = head[start:end], payload[max(0, start - size) : max(0, end - size)]
        return [part for part in parts if len(part)]

    def release(self, number: int) -> None:
        """Let go of everything up to a number."""
        self.released = max(self.released, min(number, self.last))
        for parcel in [parcel for parcel in self._parcels if parcel <= number]:
            del self._parcels[parcel]
        for sent in [sent for sent in self._unasked if sent <= number]:
            self._unasked_bytes -= self._unasked.pop(sent)

    def clear(self) -> None:
        """Let go of everything."""
        self.release(self.last)
