"""Write beside and rename: a reader of the output sees the old file or the whole new one.

Until it has its name nobody but its owner can read it; then it has the rights that any new file has
there. Used by every writer of this package.
"""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from hpccomponent.errors import OutputError
from hpccomponent.files.private_files import create_private, make_private_folder


@contextmanager
def replacing(path: Path) -> Iterator[BinaryIO]:
    """Open a temporary file beside `path` that takes its place when the block ends well.

    Whatever ends the block otherwise, an interrupt included, removes the temporary file and
    leaves what was at `path`: of a symbolic link, the file it points to.

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

    Raises
    ------
    OutputError
        The folder does not exist or cannot be written, or `path` is not a file.
    """
    with _beside(path) as (_, beside):
        _usual_mode(beside)


@contextmanager
def replacing_folder(path: Path) -> Iterator[Path]:
    """Make a temporary folder beside `path` that gets its name when the block ends well.

    Raises
    ------
    OutputError
        There is something at `path`, or the folder cannot be written.
    """
    check_folder(path)
    beside = _name_beside(path.absolute())
    try:
        with _translated(path, path):
            mode = _usual_folder_mode(beside)
            make_private_folder(beside)
            yield beside
            beside.chmod(mode)
            os.replace(beside, path)
    finally:
        shutil.rmtree(beside, ignore_errors=True)


def check_folder(path: Path) -> None:
    """Find out now whether a folder can be written later, and leave nothing behind.

    Raises
    ------
    OutputError
        It cannot, or there is something in it.
    """
    if path.exists() and not path.is_dir():
        raise OutputError(f"{path}: is not a folder", "tiles need a new folder")
    with _translated(path, path):
        if path.is_dir() and any(path.iterdir()):
            raise OutputError(f"{path}: is not empty", "name a new folder, or remove this one")
        _usual_folder_mode(_name_beside(path))


def _usual_mode(path: Path) -> int:
    """Return the rights that a new file of this name has, by making one.

    The umask alone does not tell: a folder may have rules of its own.
    """
    with path.open("xb") as file:
        mode = stat.S_IMODE(os.fstat(file.fileno()).st_mode)
    path.unlink()
    return mode


def _usual_folder_mode(path: Path) -> int:
    """Return the rights that a new folder of this name has, by making one."""
    path.mkdir()
    mode = stat.S_IMODE(path.stat().st_mode)
    path.rmdir()
    return mode


def _name_beside(path: Path) -> Path:
    return path.with_name(f".hpcapp-{os.urandom(8).hex()}.tmp")


@contextmanager
def _beside(path: Path) -> Iterator[tuple[Path, Path]]:
    """Give the file meant by `path` and a new name beside it, and free that name afterwards."""
    target = Path(os.path.realpath(path))
    beside = _name_beside(target)
    with _translated(path, target):
        if target.exists() and not target.is_file():
            raise OutputError(f"{path}: is not a file", "name a file to write to")
        try:
            yield target, beside
        finally:
            beside.unlink(missing_ok=True)


@contextmanager
def _translated(path: Path, target: Path) -> Iterator[None]:
    """Turn the system's errors of writing into ours: advice is on where `path` leads to."""
    try:
        yield
    except OSError as error:
        advice = f"check the name, and that {target.parent} has room and lets you write"
        raise OutputError(
            f"{path}: cannot be written: {error.strerror or error}",
            advice if target.parent.is_dir() else f"create the folder {target.parent} first",
        ) from error
