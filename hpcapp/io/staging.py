"""Write beside and rename: a reader of the output sees the old file or the whole new one.

Until it has its name nobody but its owner can read it; then it has the rights that any new file has
there. Used by every writer of this package.
"""

from __future__ import annotations

import os
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from hpccomponent.errors import OutputError
from hpccomponent.files.private_files import create_private

__all__ = ["check_place", "replacing"]


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Open a temporary file beside `path` that takes its place when the block ends well.

    Whatever ends the block otherwise, an interrupt included, removes the temporary file and
    leaves what was at `path`.

    Parameters
    ----------
    path : Path
        Where the file shall appear; of a symbolic link, the file it points to.

    Yields
    ------
    file
        Binary, open for writing.

    Raises
    ------
    OutputError
        The folder or the file cannot be written.
    """
    with _beside(path) as (target, beside):
        mode = _usual_mode(beside)
        with create_private(beside) as file:
            yield file
        beside.chmod(mode)
        os.replace(beside, target)


def check_place(path: Path) -> None:
    """Find out now whether a file can be written later, and leave nothing behind.

    Permissions are tried, not read: what root may do, or a read-only file system forbids,
    they do not tell.

    Parameters
    ----------
    path : Path
        Where a file will be written.

    Raises
    ------
    OutputError
        The folder does not exist or cannot be written, or `path` is not a file.
    """
    with _beside(path) as (_, beside):
        _usual_mode(beside)


def _usual_mode(path: Path) -> int:
    """Return the rights that a new file of this name has, by making one.

    The umask alone does not tell: a folder may have rules of its own.
    """
    with path.open("xb") as file:
        mode = stat.S_IMODE(os.fstat(file.fileno()).st_mode)
    path.unlink()
    return mode


@contextmanager
def _beside(path: Path) -> Iterator[tuple[Path, Path]]:
    """Give the file meant by `path` and a new name beside it, and free that name afterwards."""
    target = Path(os.path.realpath(path))
    beside = target.with_name(f".hpcapp-{secrets.token_hex(8)}.tmp")
    try:
        if target.exists() and not target.is_file():
            raise OutputError(f"{path}: is not a file", "name a file to write to")
        try:
            yield target, beside
        finally:
            beside.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(
            f"{path}: cannot be written: {error.strerror or error}", _advice(target)
        ) from error


def _advice(target: Path) -> str:
    if not target.parent.is_dir():
        return f"create the folder {target.parent} first"
    return f"check the name, and that {target.parent} has room and lets you write"
