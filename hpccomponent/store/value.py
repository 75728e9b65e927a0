"""A value as one run of bytes that can be checked and mapped into memory.

::

    magic | checksum of what follows | sizes of header and buffers | header | buffers

Header and buffers are those of `protocol.codec`: nothing is unpickled. Each buffer starts at a
multiple of 64 bytes, so that arrays in a mapped file are aligned. The checksum is the CRC-32 of the
sums of each whole page of a piece, and of the bytes after its last; it begins with the CRC-32 of
the value's name, so that another value in its place is found, too. It finds what a disk or a
network has damaged, not what somebody forged: who may write there may write anything. A CRC-32 of
all bytes takes eight times as long, SHA-256 eighteen times. Used by the stores.
"""

from __future__ import annotations

import zlib
from typing import Any

import numpy as np

from hpccomponent.errors import HpcError
from hpccomponent.files.checksum import checksum
from hpccomponent.protocol.codec import NO_BLOBS, decode_values, encode_values
from hpccomponent.protocol.frames import Buffer

_MAGIC = b"hpcvalue3"
_CHECK_BYTES = 4
_ALIGNMENT = 64
_MOST_BUFFERS = 1 << 16


class DamagedError(ValueError):
    """Bytes that are not those of a whole value; a store says whose."""


def to_buffers(value: Any, name: str = "") -> list[Buffer]:
    """Encode a value as buffers, to be written in order; large arrays are not copied.

    Raise UsageError where it is of another type than may be stored, or nested too deeply.
    """
    header, buffers = encode_values((value,))
    parts: list[Buffer] = [header, *buffers]
    sizes = np.array([len(parts), *(memoryview(part).nbytes for part in parts)], "<u8").tobytes()
    body: list[Buffer] = [sizes]
    at = len(_MAGIC) + _CHECK_BYTES + len(sizes)
    for part in parts:
        padding = -at % _ALIGNMENT
        body += [bytes(padding), part]
        at += padding + memoryview(part).nbytes
    return [_MAGIC + checksum(body, _begin(name)).to_bytes(_CHECK_BYTES, "little"), *body]


def from_bytes(content: memoryview, name: str = "", *, is_checked: bool = False) -> Any:
    """Decode a value, and check it; DamagedError where these are other bytes.

    The content is all that `to_buffers` gave; large arrays are views of it, read-only. With
    `is_checked` the very same bytes were found whole before.
    """
    start = len(_MAGIC) + _CHECK_BYTES
    if content[: len(_MAGIC)] != _MAGIC:
        raise DamagedError("does not begin as a stored value does")
    check = int.from_bytes(content[len(_MAGIC) : start], "little")
    pieces = _split(content, start)
    if not is_checked and checksum(pieces, _begin(name)) != check:
        raise DamagedError("is cut or changed: its checksum is wrong")
    header, *buffers = pieces[2::2]
    try:
        (value,) = decode_values(bytes(header), buffers, NO_BLOBS)
    except (IndexError, ValueError, HpcError) as error:
        raise DamagedError(f"holds no value: {error}") from error
    return value


def _begin(name: str) -> int:
    """Return what the checksum of a value begins with."""
    return zlib.crc32(name.encode(), 0)


def _split(content: memoryview, at: int) -> list[memoryview]:
    """Find the sizes, and header and buffers, each behind its padding."""
    start = at
    count = int.from_bytes(content[start : start + 8], "little")
    at += 8 * (count + 1)
    if not 0 < count <= _MOST_BUFFERS or at > len(content):
        raise DamagedError("is cut or changed: it does not say what it holds")
    sizes = np.frombuffer(content[start + 8 : at], "<u8").tolist()
    pieces = [content[start:at]]
    for size in sizes:
        first = at + -at % _ALIGNMENT
        pieces += [content[at:first], content[first : first + size]]
        at = first + size
    if at != len(content):
        raise DamagedError("is cut or changed: its length is wrong")
    return pieces
