"""The checksum of what is written to files and stores, and of all that a task has written.

What a task leaves in a file or a store is no part of its result: its checksum is, so that two runs
of the task can be compared.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable

Buffer = bytes | bytearray | memoryview

PAGE = 4096
"""Bytes of which the checksum knows the sum."""

_written = 0


def note_written(*pieces: Buffer) -> None:
    """Count pieces among what this process has written, in their order."""
    global _written
    _written = checksum(pieces, _written)


def take_written() -> int:
    """Return the checksum of what has been written since the last call."""
    global _written
    taken, _written = _written, 0
    return taken


def checksum(pieces: Iterable[Buffer], check: int = 0) -> int:
    """Return the checksum of some bytes, which depends on how they are cut into pieces.

    Pieces cut between pages give what they give as one; of a page what matters is the sum of its
    words, in whatever order. `check` is that of the pieces before these.
    """
    import numpy as np  # not above: a worker starts without it

    for piece in pieces:
        view = memoryview(piece).cast("B")
        whole = len(view) - len(view) % PAGE
        words = np.frombuffer(view[:whole], "<u8").reshape(-1, PAGE // 8)
        check = zlib.crc32(np.add.reduce(words, axis=1).data, check)
        check = zlib.crc32(view[whole:], check)
    return check
