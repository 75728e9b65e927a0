"""The packets of an E57 scan: whether they hold more points than the XML declares.

Every number may be wrong: packets are followed as long as they lead on, within the file.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

_SECTION = struct.Struct("<B7xQQ")  # identity, length, place of the first packet
_PACKET = struct.Struct("<BBHH")  # kind, flags, length less one, number of streams
_VECTOR, _POINTS = 1, 1  # kinds of a section, and of a packet
_PAGE, _HELD = 1024, 1020  # bytes of a page, and those but its checksum
_FLUSHED = 64  # bits that an encoder may add at the end of a stream


def hold_more(path: Path, place: int, bits: Sequence[int], points: int) -> bool:
    """Tell whether the packets of a scan surely hold more than so many points.

    The place is that of the section, in bytes from the start of the file; bits are those of a value
    of each field, 0 where all values are the same, or it is not known.
    """
    with path.open("rb") as file:
        head = _read(file, _held(place), _SECTION.size)
        if len(head) < _SECTION.size:
            return False
        kind, length, first = _SECTION.unpack(head)
        if kind != _VECTOR:
            return False
        sizes = _sum_streams(file, _held(first), _held(place) + length, len(bits))
    rooms = [(8 * size - _FLUSHED) // b for size, b in zip(sizes, bits, strict=True) if b]
    return bool(rooms) and min(rooms) > points


def _sum_streams(file: BinaryIO, at: int, end: int, fields: int) -> list[int]:
    """Return the bytes that packets hold of each field."""
    sizes = [0] * fields
    while at < end:
        head = _read(file, at, _PACKET.size + 2 * fields)
        if len(head) < _PACKET.size:
            break
        kind, _, length, streams = _PACKET.unpack_from(head)
        if kind == _POINTS and streams == fields and len(head) == _PACKET.size + 2 * fields:
            for i, size in enumerate(struct.unpack_from(f"<{fields}H", head, _PACKET.size)):
                sizes[i] += size
        at += length + 1
    return sizes


def _held(place: int) -> int:
    """Return how many bytes pages hold before a place in the file."""
    return place // _PAGE * _HELD + min(place % _PAGE, _HELD)


def _read(file: BinaryIO, at: int, size: int) -> bytes:
    """Read what pages hold, without their checksums."""
    page, skipped = divmod(at, _HELD)
    file.seek(page * _PAGE)
    pages = file.read(_PAGE * (2 + (skipped + size) // _HELD))
    held = b"".join(pages[i : i + _HELD] for i in range(0, len(pages), _PAGE))
    return held[skipped : skipped + size]
