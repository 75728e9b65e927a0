"""Decompress the points of a LAZ file.

Arguments are the library, the byte at which the points begin, how many the header announces, and
the record of the compressor in hexadecimal. A request is a number of bytes of whole points, which
come next; so many fill the memory from its start. After the last of them, ``more`` tells by 1
whether the file holds more points than it announces. ``chunks`` and three numbers for each, its
first byte, its length and its points, fill the memory likewise, wherever these are; lazrs only.
"""

from __future__ import annotations

import io
import os
import struct

from hpccomponent.decoding.serving import serve

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import BinaryIO

    from hpccomponent.decoding.serving import Answer

    _Fill = Callable[[memoryview], object]
    _Opened = tuple[_Fill, Callable[[], bool]]


ONE_STREAM = 1
"""The compressor of the oldest files: no chunks, and lazrs has no word for it."""

_LAYERED = 3  # the compressor of point formats 6 to 10
_LAYERS_OF = {10: 9, 11: 1, 12: 2, 13: 1}  # by kind of item; extra bytes have one a byte
_ITEMS_AT = 34
_LEAST_CHUNK = 20  # bytes: its first point is not compressed
_LARGEST_CHUNK = 1 << 24  # points that lazrs makes room for: usual are 50,000
_SPARE = 8  # bytes behind the last point that are no others: the compressor flushes what it holds
_READ_AHEAD = 64  # bytes that laszip is given at once, so that it is known how far it has come
_ITEM = struct.Struct("<HHH")


def read_items(record: bytes) -> list[tuple[int, int, int]]:
    """Return kind, size in bytes and version of what a compressed point consists of."""
    items = record[_ITEMS_AT:]
    return list(_ITEM.iter_unpack(items[: len(items) // _ITEM.size * _ITEM.size]))


def main() -> None:
    """Serve the process that has started this one."""
    serve(_open)


def _open(path: str, memory: memoryview, arguments: list[str]) -> Answer:
    library, start, count, record = arguments
    layout = bytes.fromhex(record)
    opener = _open_lazrs if library == "lazrs" else _open_laszip
    fill, has_more = opener(path, int(start), int(count), layout)

    def answer(request: list[str]) -> int:
        if request[0] == "more":
            return int(has_more())
        if request[0] == "chunks":
            return _fill_chunks(path, memory, layout, list(map(int, request[1:])))
        size = int(request[0])
        fill(memory[:size])
        return size

    return answer


def _open_lazrs(path: str, start: int, count: int, record: bytes) -> _Opened:
    import lazrs

    file = open(path, "rb")  # noqa: SIM115 - as long as the process
    table_at = _find_chunk_table(file, start)
    file.seek(start)
    chunks = lazrs.read_chunk_table(file, lazrs.LazVlr(record))
    lengths = [length for _, length in chunks]
    if sum(lengths) > table_at - start:
        raise ValueError("its chunks are longer than the file")
    chunk_points = sum(points for points, _ in chunks)
    if chunk_points < count:
        raise ValueError(f"its chunks hold {chunk_points} of {count} points")
    largest = max((points for points, _ in chunks), default=0)
    if largest > max(count, _LARGEST_CHUNK):
        raise ValueError(f"a chunk of it holds {largest} points, the file {count}")
    if int.from_bytes(record[:2], "little") == _LAYERED:
        _check_layers(file, start + 8, lengths, read_items(record))
    file.seek(start)
    fill: _Fill = lazrs.ParLasZipDecompressor(file, record).decompress_many
    return fill, lambda: _holds_more(path, start + 8, count, chunks, record)


def _fill_chunks(path: str, memory: memoryview, record: bytes, numbers: list[int]) -> int:
    """Decompress chunks, of which all is untrusted; return how many bytes of points these are."""
    import lazrs

    chunks = list(zip(numbers[::3], numbers[1::3], numbers[2::3], strict=True))
    items = read_items(record)
    size = sum(size for _, size, _ in items) * sum(points for _, _, points in chunks)
    if size > len(memory):
        raise ValueError("its nodes hold more points than they announce")
    with open(path, "rb") as file:
        parts = []
        for at, length, _ in chunks:
            if int.from_bytes(record[:2], "little") == _LAYERED:
                _check_layers(file, at, [length], items)
            file.seek(at)
            parts.append(file.read(length))
    table = [(points, length) for _, length, points in chunks]
    lazrs.decompress_points_with_chunk_table(b"".join(parts), record, memory[:size], table)
    return size


def _holds_more(
    path: str, at: int, count: int, chunks: list[tuple[int, int]], record: bytes
) -> bool:
    """Tell whether chunks hold more than so many points.

    Most tables say nothing of the points of the last chunk. It says so itself where it has layers;
    else its bytes do not suffice, but for a few, for the points that it has.
    """
    import lazrs

    points, last = count, 0
    while points > chunks[last][0]:
        points -= chunks[last][0]
        at += chunks[last][1]
        last += 1
    if any(length for _, length in chunks[last + 1 :]):
        return True
    with open(path, "rb") as file:
        file.seek(at)
        chunk = file.read(chunks[last][1])
    size = sum(size for _, size, _ in read_items(record))
    if int.from_bytes(record[:2], "little") == _LAYERED:
        return int.from_bytes(chunk[size : size + 4], "little") > points
    short = chunk[:-_SPARE]
    try:
        lazrs.decompress_points_with_chunk_table(
            short, record, bytearray(points * size), [(points, len(short))]
        )
    except (lazrs.LazrsError, MemoryError):
        return False
    return True


def _find_chunk_table(file: BinaryIO, start: int) -> int:
    """Return the place of a table of chunks that can be one: lazrs believes what it announces."""
    size = file.seek(0, os.SEEK_END)
    file.seek(start)
    table_at = _read_number(file, 8)
    if table_at > size:  # written last where the writer could not go back
        file.seek(-8, os.SEEK_END)
        table_at = _read_number(file, 8)
    if not start + 8 <= table_at <= size - 8:
        raise ValueError("it has no table of chunks")
    file.seek(table_at + 4)
    chunks = _read_number(file, 4)
    if chunks * _LEAST_CHUNK > size:
        raise ValueError(f"its table announces {chunks} chunks")
    return table_at


def _check_layers(
    file: BinaryIO, at: int, lengths: list[int], items: list[tuple[int, int, int]]
) -> None:
    """Refuse chunks whose layers are longer than they: lazrs would take as much memory.

    A chunk begins with its first point and its number of points; the lengths of layers follow.
    """
    point = sum(size for _, size, _ in items)
    layers = sum(_LAYERS_OF.get(kind, size) for kind, size, _ in items)
    for length in lengths:
        file.seek(at + point + 4)
        if length and sum(struct.unpack(f"<{layers}I", file.read(4 * layers))) > length:
            raise ValueError("its layers are longer than their chunk")
        at += length


def _read_number(file: BinaryIO, size: int) -> int:
    return int.from_bytes(file.read(size), "little")


class _Sipped(io.FileIO):
    """A file that is read a little at a time."""

    def read(self, size: int | None = -1) -> bytes:
        return super().read(_READ_AHEAD if size is None or size < 0 else min(size, _READ_AHEAD))


def _open_laszip(path: str, start: int, count: int, record: bytes) -> _Opened:  # noqa: ARG001
    """Open a file with a library that reads the header itself."""
    import laszip

    file = _Sipped(path)
    is_one_stream = int.from_bytes(record[:2], "little") == ONE_STREAM
    end = os.path.getsize(path) if is_one_stream else _find_chunk_table(file, start)
    file.seek(0)
    fill: _Fill = laszip.LasUnZipper(file).decompress_into
    return fill, lambda: file.tell() + _SPARE < end
