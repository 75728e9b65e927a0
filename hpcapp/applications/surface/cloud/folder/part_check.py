"""The last record of a file of points, by which it is found out whether all are there."""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path

from hpccomponent.files.checksum import checksum
from hpccomponent.files.private_files import open_at_once
from hpccomponent.store.value import DamagedError

_LAST = struct.Struct("<8sQII")  # magic, bytes before it, their checksum, that of the name
_MAGIC = b"hpcpart1"
_BYTES_AT_ONCE = 1 << 22  # whole pages


def with_check(pieces: Iterable[memoryview | bytes], path: Path) -> Iterator[memoryview | bytes]:
    """Yield the records of a part, and behind them the last one.

    All pieces but the last are of whole pages (see `hpccomponent.files.checksum.PAGE`).
    """
    length = check = 0
    for piece in pieces:
        check = checksum([piece], check)
        length += len(piece)
        yield piece
    yield _LAST.pack(_MAGIC, length, check, _name(path))


def check_part(path: Path) -> int:
    """Find out whether a file is as it was written; return the bytes before its last record.

    DamagedError names the file where it is not.
    """
    try:
        with open(path, "rb", opener=open_at_once) as file:
            length = os.fstat(file.fileno()).st_size - _LAST.size
            check, left = 0, max(length, 0)
            while left and (piece := file.read(min(left, _BYTES_AT_ONCE))):
                check, left = checksum([piece], check), left - len(piece)
            last = file.read(_LAST.size)
    except OSError as error:
        raise DamagedError(f"{path} cannot be read: {error.strerror or error}") from error
    if left or last != _LAST.pack(_MAGIC, max(length, 0), check, _name(path)):
        raise DamagedError(f"{path} is cut or changed: its checksum is wrong")
    return length


def _name(path: Path) -> int:
    """Return a number for a file's name and that of its folder: another part has another."""
    return zlib.crc32(f"{path.parent.name}/{path.name}".encode())
