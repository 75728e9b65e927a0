"""Blobs: values that travel to a machine once, and are named by what is in them.

The key of a blob is a hash over its encoded value, so that equal values are one blob, and a
receiver can tell that it got what the key names.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Sequence
from hashlib import blake2b

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import ProtocolError
from hpccomponent.protocol.frames import Buffer

KEY_BYTES = 16


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Blob:
    """A shared value: its key, and its encoding.

    The key is BLAKE2b of 128 bits over the lengths of header and buffers, the header, and the
    buffers, which must not change as long as the blob is used.
    """

    key: bytes
    header: bytes
    buffers: tuple[Buffer, ...]
    size_bytes: int

    def is_unchanged(self) -> bool:
        """Tell whether the value is still the one that the key names."""
        return self.key == _key(self.header, _lengths(self.buffers), self.buffers)


def make_blob(header: bytes, buffers: Sequence[Buffer]) -> Blob:
    """Name an encoded value by its content; its buffers are referred to without a copy.

    Examples
    --------
    >>> make_blob(b"h", [b"abc"]).key == make_blob(b"h", [bytearray(b"abc")]).key
    True
    >>> make_blob(b"h", [b"ab", b"c"]).key == make_blob(b"h", [b"abc"]).key
    False
    """
    sizes = _lengths(buffers)
    return Blob(_key(header, sizes, buffers), header, tuple(buffers), len(header) + sum(sizes))


def check_blob(
    key: bytes, header: bytes, sizes: Sequence[int], pieces: Iterable[Sequence[Buffer]]
) -> None:
    """Raise ProtocolError where a received blob is not what its key names."""
    if _key(header, sizes, (frame for frames in pieces for frame in frames)) != key:
        raise ProtocolError(f"blob {key.hex()} does not hold what its key names")


def _lengths(buffers: Sequence[Buffer]) -> list[int]:
    return [len(buffer) for buffer in buffers]


def _key(header: bytes, sizes: Sequence[int], pieces: Iterable[Buffer]) -> bytes:
    content = blake2b(
        struct.pack(f"<{len(sizes) + 1}Q", len(header), *sizes), digest_size=KEY_BYTES
    )
    content.update(header)
    for piece in pieces:
        content.update(piece)
    return content.digest()
