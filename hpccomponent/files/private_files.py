"""Files and folders that nobody but their owner may look into, whatever the umask says.

What lies between the parts of a job are somebody's points: it is made here.
"""

from __future__ import annotations

import errno
import os
import shutil
import stat
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from hpccomponent.posix import AT_ONCE, NO_LINK, block

_FILE, _FOLDER = 0o600, 0o700


def make_private_folder(path: Path) -> None:
    """Make a folder, and missing ones above it, for their owner alone; OSError where that fails."""
    if path.is_dir():
        return
    if not path.parent.is_dir():
        make_private_folder(path.parent)
    try:
        path.mkdir(_FOLDER)
    except FileExistsError:
        if not path.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR), path) from None
    else:
        path.chmod(_FOLDER)  # a umask may take away the owner's own rights


def create_private(path: Path, buffering: int = -1) -> BinaryIO:
    """Create a file for its owner alone, to be written; OSError where something is there."""

    def opener(name: str, flags: int) -> int:
        return os.open(name, flags | NO_LINK, _FILE)

    file = open(path, "xb", buffering=buffering, opener=opener)  # noqa: SIM115 - the caller's
    try:
        os.fchmod(file.fileno(), _FILE)
    except AttributeError:  # a system without modes: folders of a user are its own
        pass
    except OSError:  # a file system without modes
        if stat.S_IMODE(os.fstat(file.fileno()).st_mode) & 0o077:
            file.close()
            path.unlink(missing_ok=True)
            raise
    return file


def open_at_once(name: str, flags: int) -> int:
    """Open a file, as an `opener` of `open` does; a pipe that has its name is not waited for."""
    return os.open(name, flags | AT_ONCE)


def open_if_read(name: str, flags: int) -> int:
    """Open a file likewise; of a pipe that nobody reads it is an error."""
    descriptor = os.open(name, flags | AT_ONCE, 0o666)
    block(descriptor)
    return descriptor


def remove_path(path: Path) -> None:
    """Take away whatever has a name, if anything: a file, a link, or a folder with all in it.

    Folders that their owner may not look into are no obstacle; what is others' is left silently.
    """

    def try_again(remove: Callable[..., object], name: str, _error: object) -> None:
        for folder in (os.path.dirname(name), name):
            if os.path.isdir(folder) and not os.path.islink(folder):
                os.chmod(folder, _FOLDER)
        if remove in (os.open, os.scandir, os.lstat):  # it could not look into a folder
            shutil.rmtree(name, ignore_errors=True)
        else:
            remove(name)

    def quietly(remove: Callable[..., object], name: str, error: object) -> None:
        try:
            try_again(remove, name, error)
        except OSError:
            return

    try:
        path.unlink()
    except FileNotFoundError:
        return
    except OSError:  # it is a folder
        shutil.rmtree(path, onerror=quietly)
