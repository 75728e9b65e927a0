"""What a file may claim of memory: its counts are somebody else's words, and what is packed swells.

One rule for all readers: what a file holds may take a gibibyte, and four times its size. A file of
a few bytes that is meant to be large is within the first, numbers that are widened as they are read
(2 bytes to 8) within the second.
"""

from __future__ import annotations

from pathlib import Path

from hpccomponent.errors import InputError

_LEAST = 1 << 30  # bytes
_FILE_SIZES = 4  # beside that


def most_memory(path: Path) -> int:
    """Return how many bytes of memory what a file holds may take."""
    return _LEAST + _FILE_SIZES * path.stat().st_size


class Claims:
    """What a file has claimed so far; all of it together is bounded."""

    def __init__(self, path: Path) -> None:
        self._path, self._most, self._claimed = path, most_memory(path), 0

    def add(self, size: int, what: str) -> None:
        """Allow so many bytes more, before they are taken; InputError where that is too much."""
        self._claimed += size
        if self._claimed > self._most:
            raise InputError(
                f"{self._path}: {what}: with that it claims {self._claimed} bytes, a file of its "
                f"size may claim {self._most}",
                "export it again, uncompressed if it is meant to be so large",
            )
