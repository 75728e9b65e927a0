"""Folders that a process holds for as long as it lives, so that nobody's can be told from others'.

::

    hpcapp-k3j9x2/          mode 0700
    └── .owner              who holds it, as JSON; locked by that process (flock)

The system lets go of a lock when the process that holds it ends, however it ends: a folder whose
lock can be had was left by one that was killed. Neither its age nor its name says so. A file system
without such locks (some network ones) holds folders that have no owner, and are nobody's to remove;
so does a system without them (Windows), where each process removes its own alone.
"""

from __future__ import annotations

import errno
import getpass
import json
import os
import shlex
import shutil
import socket
import stat
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from pathlib import Path

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import OutputError
from hpccomponent.files.private_files import create_private, make_private_folder, remove_path
from hpccomponent.posix import AS_BYTES, AT_ONCE, NO_LINK, fcntl, user_number

_OWNER = ".owner"
_PREFIX = "hpcapp-"
_UNSUPPORTED = {errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.ENOLCK, errno.EINVAL}
_OPEN = NO_LINK | AT_ONCE | AS_BYTES  # no link is followed, no pipe waited for
_MOST_BYTES = 4096  # of what an owner says of itself
_LONGEST = 200  # characters of a command
_TRIES = 3  # a worker that is late may put something into a folder that is being removed


@dataclass(frozen=True, slots=True)
class FolderOwner:
    """Who holds a folder."""

    user: str
    host: str
    pid: int
    command: str

    def __str__(self) -> str:
        return f"{self.user}@{self.host}, process {self.pid} ({self.command})"

    @classmethod
    def this_process(cls) -> FolderOwner:
        """Describe this process."""
        try:
            user = getpass.getuser()
        except (KeyError, OSError):  # nobody has its number
            user = str(user_number())
        command = shlex.join([os.path.basename(sys.argv[0]) or "python", *sys.argv[1:]])
        return cls(user, socket.gethostname(), os.getpid(), command[:_LONGEST])


@dataclass(frozen=True, slots=True, eq=False)
class HeldFolder:
    """A folder that this process holds by a descriptor's lock; None where there are no locks."""

    path: Path
    lock: int | None

    def let_go(self) -> None:
        """Leave the folder to whoever takes it next."""
        if self.lock is not None:
            with suppress(OSError):
                fcntl.flock(self.lock, fcntl.LOCK_UN)  # a child may have the descriptor, too
            os.close(self.lock)

    def remove(self) -> None:
        """Take the folder away, as far as the system lets us."""
        if fcntl is None:
            shutil.rmtree(self.path, ignore_errors=True)
            return
        for _ in range(_TRIES):
            with _opened(self.path) as folder:
                if folder is None or not self._is_still(folder):
                    break
                _empty(folder)
            with suppress(OSError):
                self.path.rmdir()
        self.let_go()

    def _is_still(self, folder: int) -> bool:
        """Tell whether an open folder is the one that is held, or what is left of it."""
        return self.lock is None or not os.fstat(self.lock).st_nlink or _is_at(self.lock, folder)


def create_held(path: Path) -> HeldFolder:
    """Make a folder for this process where nothing is, and those above it; else OutputError."""
    try:
        make_private_folder(path.parent)
        path.mkdir(0o700)
        try:
            path.chmod(0o700)
            return HeldFolder(path, _create_lock(path))
        except BaseException:
            path.rmdir()
            raise
    except OSError as error:
        raise OutputError(
            f"{path}: the folder cannot be made: {error.strerror or error}",
            f"check that {path.parent} has room and lets you write",
        ) from error


def hold(path: Path, *, waits: bool = False) -> HeldFolder | None:
    """Take a folder that was made by `create_held` and that nobody holds any more.

    Return None where it is not there, not this user's, or held; with `waits` wait for its holder.
    """
    with _opened(path) as folder:
        if folder is None:
            return None
        lock = _open_lock(folder, os.O_RDWR)
        if lock is None:  # nobody has locked what is no file
            remove_path(path / _OWNER)
            with suppress(OSError):
                return HeldFolder(path, _create_lock(path))
            return None
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | (0 if waits else fcntl.LOCK_NB))
            if _is_at(lock, folder):
                _write_owner(lock)
                return HeldFolder(path, lock)
        except OSError as error:
            if error.errno in _UNSUPPORTED:
                os.close(lock)
                return HeldFolder(path, None)
        except BaseException:
            os.close(lock)
            raise
        os.close(lock)
        return None


def read_owner(path: Path) -> FolderOwner | None:
    """Return who has said of itself that it holds a folder of this user."""
    from hpccomponent.foreign_json import decode  # most commands ask nobody

    with _opened(path) as folder:
        if folder is None:
            return None
        file = _open_lock(folder, os.O_RDONLY)
        if file is None:
            return None
        try:
            return decode(os.read(file, _MOST_BYTES), FolderOwner)
        except (OSError, ValueError):
            return None
        finally:
            os.close(file)


def remove_abandoned(parent: Path, prefix: str) -> list[FolderOwner]:
    """Remove the folders that processes of this user on this machine have left behind.

    Return who holds such a folder still, or has left it on another machine.
    """
    living: list[FolderOwner] = []
    try:
        with os.scandir(parent) as entries:
            names = sorted(entry.name for entry in entries if entry.name.startswith(prefix))
    except OSError:
        return living
    host = socket.gethostname() if names else ""
    for name in names:
        path = parent / name
        owner = read_owner(path)
        if owner is None:  # it is being made, or nobody's, or another user's
            continue
        folder = hold(path) if owner.host == host else None
        if folder is None:
            living.append(owner)
        else:
            folder.remove()
    return living


@contextmanager
def temporary_room() -> Iterator[Path]:
    """Yield the system's folder for temporary files, while something is written there.

    Raise OutputError where there is none, or no room in it; the system's own error names no file.
    """
    problem = "no temporary folder can be had"
    try:
        parent = Path(tempfile.gettempdir())
        problem = f"{parent}: a temporary file cannot be written"
        yield parent
    except OSError as error:
        raise OutputError(
            f"{problem}: {error.strerror or error}", "set TMPDIR to a folder with room"
        ) from error


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yield a temporary folder, which the block's end removes; OutputError where none can be made.

    What is left of a process that was killed, the next one removes.
    """
    with temporary_room() as parent:
        remove_abandoned(parent, _PREFIX)
        folder = create_held(parent / f"{_PREFIX}{os.urandom(6).hex()}")
    try:
        yield folder.path
    finally:
        folder.remove()


def remove_killed() -> None:
    """Remove what killed processes of this user have left in the system's temporary folder."""
    with suppress(OSError):
        remove_abandoned(Path(tempfile.gettempdir()), _PREFIX)


def _create_lock(folder: Path) -> int | None:
    """Create and lock the file that says who holds a folder; None where there are no locks."""
    if fcntl is None:
        return None
    path = folder / _OWNER
    with create_private(path) as file:
        lock = os.dup(file.fileno())
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)  # who looks at it meanwhile lets go at once
        _write_owner(lock)
    except OSError as error:
        os.close(lock)
        path.unlink(missing_ok=True)
        if error.errno in _UNSUPPORTED:
            return None
        raise
    return lock


def _write_owner(lock: int) -> None:
    """Write down who holds a lock."""
    encoded = json.dumps(asdict(FolderOwner.this_process())).encode()
    os.lseek(lock, 0, os.SEEK_SET)
    os.write(lock, encoded)
    os.ftruncate(lock, len(encoded))


@contextmanager
def _opened(path: Path) -> Iterator[int | None]:
    """Yield the descriptor of a folder of this user; None where it is none, or a link to one."""
    try:
        folder = os.open(path, os.O_RDONLY | os.O_DIRECTORY | _OPEN)
    except (OSError, AttributeError):  # the latter where no folder can be opened
        yield None
        return
    try:
        yield folder if _is_own(folder, stat.S_ISDIR) else None
    finally:
        os.close(folder)


def _open_lock(folder: int, flags: int) -> int | None:
    """Open the file by which an open folder is held; None where it is no file of this user."""
    try:
        lock = os.open(_OWNER, flags | _OPEN, dir_fd=folder)
    except OSError:
        return None
    if _is_own(lock, stat.S_ISREG):
        return lock
    os.close(lock)
    return None


def _empty(folder: int) -> None:
    """Remove what is in an open folder, the lock last: whoever changes its name gains nothing."""
    names = sorted(os.listdir(folder), key=_OWNER.__eq__)
    for name in names:
        with suppress(OSError):
            if stat.S_ISDIR(os.stat(name, dir_fd=folder, follow_symlinks=False).st_mode):
                shutil.rmtree(name, ignore_errors=True, dir_fd=folder)
            else:
                os.unlink(name, dir_fd=folder)


def _is_own(file: int, is_kind: Callable[[int], bool]) -> bool:
    """Tell whether something open is this user's, and of a kind."""
    status = os.fstat(file)
    return is_kind(status.st_mode) and status.st_uid == user_number()


def _is_at(lock: int, folder: int) -> bool:
    """Tell whether an open file is still the one by which a folder is held."""
    try:
        status = os.stat(_OWNER, dir_fd=folder, follow_symlinks=False)
    except OSError:
        return False
    return os.path.samestat(status, os.fstat(lock))
