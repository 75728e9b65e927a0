"""LAZ: compressed points, by lazrs, or by laszip where lazrs cannot read them."""

from __future__ import annotations

import os
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import BinaryIO, cast

from hpcapp.io.las.header import LasHeader
from hpccomponent.errors import InputError, UsageError
from hpccomponent.surface.types.points import ByteArray

__all__ = ["Fill", "open_decompressor"]

Fill = Callable[[ByteArray], object]
"""Fills an array with the bytes of the points that come next."""

_LAYERED = 3  # the compressor of point formats 6 to 10
_LAYERS_OF = {10: 9, 11: 1, 12: 2, 13: 1}  # by kind of item; extra bytes have one a byte
_ONE_STREAM = 1  # the compressor of the oldest files: no chunks, and lazrs has no word for it
_ITEMS_AT = 34
_LEAST_CHUNK = 20  # bytes: its first point is not compressed
_ITEM = struct.Struct("<HHH")


def open_decompressor(file: BinaryIO, path: Path, header: LasHeader) -> Fill:
    """Open the compressed points of a file.

    Parameters
    ----------
    file : file
        Binary, open for reading.
    path : Path
        Its name, for messages.
    header : LasHeader

    Returns
    -------
    callable
        Fills arrays of uint8, of a whole number of points each; raises an InputError where the
        points cannot be decompressed.

    Raises
    ------
    InputError
        As the callable does.
    UsageError
        The library that decompresses is not installed.
    """
    record = header.records.get(("laszip encoded", 22204), b"")
    choices = [("lazrs", _open_lazrs), ("laszip", _open_laszip)]
    if _check_record(record, header, path) == _ONE_STREAM:
        del choices[0]
    for library, opener in choices:
        if find_spec(library) is None:
            continue
        with _translated(path):
            file.seek(header.points_start)
            decompress = opener(file, record)

        return _translating(decompress, path)
    raise UsageError(
        f"{path}: compressed points need the package {choices[0][0]}", "pip install 'hpcapp[las]'"
    )


def _translating(decompress: Fill, path: Path) -> Fill:
    def fill(points: ByteArray) -> None:
        with _translated(path):
            decompress(points)

    return fill


def _open_lazrs(file: BinaryIO, record: bytes) -> Fill:
    lazrs = import_module("lazrs")
    start = file.tell()
    table_at = _find_chunk_table(file, start)
    file.seek(start)
    lengths = [length for _, length in lazrs.read_chunk_table(file, lazrs.LazVlr(record))]
    if sum(lengths) > table_at - start:
        raise ValueError("its chunks are longer than the file")
    if int.from_bytes(record[:2], "little") == _LAYERED:
        _check_layers(file, start + 8, lengths, _items(record))
    file.seek(start)
    return cast(Fill, lazrs.ParLasZipDecompressor(file, record).decompress_many)


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


def _items(record: bytes) -> list[tuple[int, int, int]]:
    """Return kind, size and version of what a compressed point consists of."""
    items = record[_ITEMS_AT:]
    return list(_ITEM.iter_unpack(items[: len(items) // _ITEM.size * _ITEM.size]))


def _read_number(file: BinaryIO, size: int) -> int:
    return int.from_bytes(file.read(size), "little")


def _open_laszip(file: BinaryIO, record: bytes) -> Fill:  # noqa: ARG001 - it reads the header itself
    file.seek(0)
    return cast(Fill, import_module("laszip").LasUnZipper(file).decompress_into)


def _check_record(record: bytes, header: LasHeader, path: Path) -> int:
    """Return the compressor; what it makes must be points of the length that the header says."""
    if sum(size for _, size, _ in _items(record)) != header.record_length:
        raise _damaged(path, "its record of the compressor does not fit the points")
    return int.from_bytes(record[:2], "little")


@contextmanager
def _translated(path: Path) -> Iterator[None]:
    """Turn errors of the libraries into ours; lazrs panics with what is no Exception."""
    try:
        yield
    except MemoryError:
        raise
    except Exception as error:
        raise _damaged(path, str(error)) from error
    except BaseException as error:
        if type(error).__module__ != "pyo3_runtime":
            raise
        raise _damaged(path, "lazrs gave up") from error


def _damaged(path: Path, why: str) -> InputError:
    return InputError(
        f"{path}: the points cannot be decompressed: {why}",
        "the file is damaged: copy or export it again",
    )
