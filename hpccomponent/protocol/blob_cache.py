"""Which blobs a component keeps, and which of them its worker process has."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Collection, Iterable

from hpccomponent.protocol.messages import Share

MAX_BLOBS = 500  # each keeps a file open


class BlobCache:
    """The blobs of one component by least recent use, `limit_bytes` beside what batches need."""

    def __init__(self, limit_bytes: int) -> None:
        self.worker_has: set[bytes] = set()
        self._limit_bytes = limit_bytes
        self._size_bytes = 0
        self._sizes: OrderedDict[bytes, int] = OrderedDict()
        self._forgotten: set[bytes] = set()

    def put(self, blob: Share) -> bool:
        """Take a blob in; return false if it is here already."""
        self._forgotten.discard(blob.key)
        if blob.key in self._sizes:
            return False
        self._sizes[blob.key] = len(blob.header) + sum(blob.sizes)
        self._size_bytes += self._sizes[blob.key]
        return True

    def use(self, keys: Iterable[bytes]) -> list[bytes]:
        """Note that a batch names these blobs; return the keys of those that are not here."""
        missing = []
        for key in keys:
            if key in self._sizes:
                self._sizes.move_to_end(key)
            else:
                missing.append(key)
        return missing

    def hand_over(self, keys: Iterable[bytes]) -> list[bytes]:
        """Return those that the worker process lacks; from now on it has them."""
        lacking = [key for key in keys if key not in self.worker_has]
        self.worker_has.update(lacking)
        return lacking

    def is_full(self) -> bool:
        """Tell whether `evict` may find something to let go."""
        return self._is_over() or bool(self._forgotten)

    def evict(self, needed: Collection[bytes]) -> list[bytes]:
        """Let go of forgotten blobs, and beyond the limit of old ones, and return their keys."""
        evicted = [key for key in self._forgotten if key not in needed]
        for key in evicted:
            self._remove(key)
        for key in [key for key in self._sizes if key not in needed]:
            if not self._is_over():
                break
            self._remove(key)
            evicted.append(key)
        return evicted

    def forget(self, keys: Iterable[bytes]) -> None:
        """Note that nobody will name these blobs again: those that are here are the next to go."""
        self._forgotten.update(key for key in keys if key in self._sizes)

    def _is_over(self) -> bool:
        return self._size_bytes > self._limit_bytes or len(self._sizes) > MAX_BLOBS

    def _remove(self, key: bytes) -> None:
        self._forgotten.discard(key)
        self._size_bytes -= self._sizes.pop(key)
        self.worker_has.discard(key)
