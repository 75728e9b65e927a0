"""Files that several processes use: whether they see the same ones, and how one is written.

Who may import it: tasks, the master that asks them, and the store of a folder.
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterable
from pathlib import Path

from hpccomponent.files.private_files import create_private
from hpccomponent.protocol.declared import Flag
from hpccomponent.runtime.tasks import declare

__all__ = ["sees_files", "write_whole"]

_BUFFER = 1 << 18  # bytes of small pieces that are written together


@declare(result=Flag(), limit=4096)
def sees_files(*files: tuple[str, int]) -> bool:
    """Tell whether some files are there (a task).

    Parameters
    ----------
    *files : tuple of (str, int)
        Path and length in bytes of each. A name with a random part in it is found nowhere by
        chance; a name that a user gave is, so let a random one be among them.

    Returns
    -------
    bool

    Examples
    --------
    >>> sees_files((__file__, os.path.getsize(__file__))), sees_files((__file__, -1))
    (True, False)
    """
    try:
        return all(os.stat(path).st_size == length for path, length in files)
    except OSError:
        return False


def write_whole(path: Path, buffers: Iterable[bytes | bytearray | memoryview]) -> None:
    """Write a file that is there when all of it is, and never in part; only its owner can read it.

    Others may read it meanwhile: a task may run twice, and who is late writes the same again.

    Parameters
    ----------
    path : Path
        What has been there is replaced.
    buffers : iterable of bytes-like
        The contents, one after the other.

    Raises
    ------
    OSError
        It cannot be written; nothing is left behind.
    """
    beside = path.with_name(f".{secrets.token_hex(8)}.tmp")
    try:
        with create_private(beside, _BUFFER) as file:
            file.writelines(buffers)
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)
