"""LAZ: compressed points, by lazrs, or by laszip where lazrs cannot read them."""

from __future__ import annotations

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

_ONE_STREAM = 1  # the compressor of the oldest files: no chunks, and lazrs has no word for it
_ITEM_SIZES_AT = 34
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

        def fill(points: ByteArray) -> None:
            with _translated(path):
                decompress(points)

        return fill
    raise UsageError(
        f"{path}: compressed points need the package {choices[0][0]}", "pip install 'hpcapp[las]'"
    )


def _open_lazrs(file: BinaryIO, record: bytes) -> Fill:
    lazrs = import_module("lazrs")
    return cast(Fill, lazrs.ParLasZipDecompressor(file, record).decompress_many)


def _open_laszip(file: BinaryIO, record: bytes) -> Fill:  # noqa: ARG001 - it reads the header itself
    file.seek(0)
    return cast(Fill, import_module("laszip").LasUnZipper(file).decompress_into)


def _check_record(record: bytes, header: LasHeader, path: Path) -> int:
    """Return the compressor; what it makes must be points of the length that the header says."""
    items = record[_ITEM_SIZES_AT:]
    sizes = [size for _, size, _ in _ITEM.iter_unpack(items[: len(items) // 6 * 6])]
    if len(record) < _ITEM_SIZES_AT or sum(sizes) != header.record_length:
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
