"""LAS files byte by byte, so that each can be odd in its own way."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

Vlr = tuple[bytes, int, bytes]
MakeLas = Callable[..., Path]


def pack_vlr(user: bytes, number: int, payload: bytes, is_long: bool = False) -> bytes:
    layout = "<2x16sHQ32x" if is_long else "<2x16sHH32x"
    return struct.pack(layout, user, number, len(payload)) + payload


@pytest.fixture
def make_las(tmp_path: Path) -> MakeLas:
    """Give a function that writes a file of LAS 1.2, or of 1.4 from point format 6 on."""

    def make(
        points: Sequence[bytes],
        point_format: int = 0,
        *,
        name: str = "a.las",
        vlrs: Sequence[Vlr] = (),
        announced_vlrs: int | None = None,
        announced: int | None = None,
        legacy: int | None = None,
        padding: bytes = b"",
        evlrs: Sequence[Vlr] = (),
        scale: float = 0.001,
        offset: float = 1000.0,
        length: int | None = None,
        minor: int | None = None,
        tail: bytes = b"",
    ) -> Path:
        minor = (4 if point_format >= 6 or evlrs else 2) if minor is None else minor
        size = 375 if minor == 4 else 227
        records = b"".join(pack_vlr(*vlr) for vlr in vlrs) + padding
        count = len(points) if announced is None else announced
        number = len(vlrs) if announced_vlrs is None else announced_vlrs
        length = len(points[0]) if length is None else length
        head = struct.pack(
            "<4s20x2B68xHIIBHI5I12d",
            b"LASF", 1, minor, size, size + len(records), number, point_format, length,
            count if legacy is None else legacy,
            *[0] * 5,
            *[scale] * 3, *[offset] * 3, *[0.0] * 6,
        )  # fmt: skip
        body = b"".join(points)
        if minor == 4:
            later = size + len(records) + len(body)
            head += bytes(8) + struct.pack("<QIQ", later, len(evlrs), count)
            head += bytes(15 * 8)
        path = tmp_path / name
        ends = b"".join(pack_vlr(*vlr, is_long=True) for vlr in evlrs)
        path.write_bytes(head + records + body + ends + tail)
        return path

    return make
