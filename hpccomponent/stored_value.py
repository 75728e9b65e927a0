"""A value as one run of bytes that can be checked and mapped into memory.

::

    magic | CRC-32 of what follows | sizes of header and buffers | header | buffers

Header and buffers are those of `protocol.codec`: nothing is unpickled. Each buffer starts at a
multiple of 64 bytes, so that arrays in a mapped file are aligned. The check finds what a disk or
a network has damaged, not what somebody forged: who may write there may write anything. A
cryptographic hash would take seven times as long, as much as writing a mesh. Used by the stores.
"""

from __future__ import annotations

import zlib
from typing import Any

import numpy as np

from hpccomponent.errors import HpcError
from hpccomponent.protocol.codec import NO_BLOBS, decode_values, encode_values
from hpccomponent.protocol.frames import Buffer

__all__ = ["DamagedError", "from_bytes", "to_buffers"]

_MAGIC = b"hpcvalue2"
_CHECK_BYTES = 4
_ALIGNMENT = 64
_MOST_BUFFERS = 1 << 16


class DamagedError(ValueError):
    """Bytes that are not those of a whole value; a store says whose."""


def to_buffers(value: Any) -> list[Buffer]:
    """Encode a value.

    Parameters
    ----------
    value : ndarray, int, float, bool, str, bytes, None, or tuple, list, dict of these

    Returns
    -------
    list of bytes-like
        To be written one after the other; large arrays are not copied.

    Raises
    ------
    UsageError
        The value is of another type, or nested too deeply.
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
    check = 0
    for some in body:
        check = zlib.crc32(some, check)
    return [_MAGIC + check.to_bytes(_CHECK_BYTES, "little"), *body]


def from_bytes(content: memoryview, *, is_checked: bool = False) -> Any:
    """Decode a value, and check it.

    Parameters
    ----------
    content : memoryview of bytes
        All that `to_buffers` gave. Large arrays are views of it, read-only.
    is_checked : bool
        Whether the very same bytes were found whole before.

    Returns
    -------
    object
        The value.

    Raises
    ------
    DamagedError
        These are other bytes.
    """
    start = len(_MAGIC) + _CHECK_BYTES
    if content[: len(_MAGIC)] != _MAGIC:
        raise DamagedError("does not begin as a stored value does")
    check = int.from_bytes(content[len(_MAGIC) : start], "little")
    if not is_checked and zlib.crc32(content[start:]) != check:
        raise DamagedError("is cut or changed: its checksum is wrong")
    try:
        header, *buffers = _split(content, start)
        (value,) = decode_values(bytes(header), buffers, NO_BLOBS)
    except (IndexError, ValueError, HpcError) as error:
        raise DamagedError(f"holds no value: {error}") from error
    return value


def _split(content: memoryview, at: int) -> list[memoryview]:
    """Find header and buffers."""
    count = int(np.frombuffer(content[at : at + 8], "<u8")[0])
    if count > _MOST_BUFFERS:
        raise DamagedError(f"names {count} buffers")
    sizes = np.frombuffer(content[at + 8 : at + 8 * (count + 1)], "<u8").tolist()
    at += 8 * (count + 1)
    parts = []
    for size in sizes:
        at += -at % _ALIGNMENT
        parts.append(content[at : at + size])
        at += size
    return parts
