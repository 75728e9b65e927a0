"""Files that are there when all of them is, and never in part."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path

from hpccomponent.files.checksum import note_written
from hpccomponent.files.private_files import create_private

_BUFFER = 1 << 18  # bytes of small pieces that are written together


def write_whole(path: Path, buffers: Iterable[bytes | bytearray | memoryview]) -> None:
    """Write a file that is there when all of it is, and never in part; only its owner can read it.

    It replaces what has been there. Others may read it meanwhile: a task may run twice, and who is
    late writes the same again. After an OSError nothing is left behind.
    """
    beside = path.with_name(f".{os.urandom(8).hex()}.tmp")
    try:
        with create_private(beside, _BUFFER) as file:
            for buffer in buffers:
                file.write(buffer)
                note_written(buffer)
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)
