"""Paths as people write them: with ``~`` in front, or naming what is no file."""

from __future__ import annotations

import errno
import glob
import os
import stat
from pathlib import Path

from hpccomponent.errors import UsageError
from hpccomponent.posix import AS_BYTES, AT_ONCE

_KINDS = (
    (stat.S_ISFIFO, "it is a pipe, not a regular file"),
    (stat.S_ISSOCK, "it is a socket, not a regular file"),
    (stat.S_ISCHR, "it is a device, not a regular file"),
    (stat.S_ISBLK, "it is a device, not a regular file"),
)


def home_folder() -> Path:
    """Return ``$HOME``, or the home that the system knows; UsageError where neither is known."""
    named = os.environ.get("HOME") or os.environ.get("USERPROFILE", "")
    if not named:
        try:
            import pwd

            named = pwd.getpwuid(os.getuid()).pw_dir
        except (ImportError, KeyError):
            named = ""
    if not os.path.isabs(named):
        raise UsageError("the home folder of this user is not known", "set HOME to it")
    return Path(named)


def expand_home(path: str | Path) -> Path:
    """Return a path with its home folder written out, if it begins with ``~`` or ``~USER``.

    Raise UsageError where there is no such user.

    Examples
    --------
    >>> expand_home("scans/a.ply")
    PosixPath('scans/a.ply')
    """
    text = os.fspath(path)
    if not text.startswith("~"):
        return Path(path)
    user, slash, rest = text[1:].partition("/")
    if not user:
        return home_folder() / rest
    try:
        import pwd

        home = pwd.getpwnam(user).pw_dir
    except (ImportError, KeyError):
        raise UsageError(
            f"{text}: this machine knows no user {user!r}",
            f"write the whole path, or ./{text} for a file of that name",
        ) from None
    return Path(home) / rest if slash else Path(home)


def expand_pattern(name: str) -> list[str]:
    """Return the files that fit a pattern, sorted; what is no pattern, or is there, stays.

    Examples
    --------
    >>> expand_pattern("a.ply"), expand_pattern("no-such-folder/*.ply")
    (['a.ply'], [])
    """
    if not glob.has_magic(name) or os.path.exists(name):
        return [name]
    return sorted(glob.glob(name, recursive=True))


def check_regular(path: Path) -> None:
    """Raise UsageError unless a path is a regular file, or nothing yet; nothing is opened."""
    try:
        refuse_special(os.stat(path).st_mode, path)
    except FileNotFoundError:
        return
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}", "name a regular file") from error


def read_regular(path: Path, most: int = -1) -> bytes:
    """Read a regular file, at most `most` bytes of it; by default all.

    Raise OSError where it cannot be read, or is something else: a pipe is not waited for.
    """
    descriptor = os.open(path, os.O_RDONLY | AT_ONCE | AS_BYTES)
    try:
        refuse_special(os.fstat(descriptor).st_mode, path)
        with open(descriptor, "rb", closefd=False) as file:
            return file.read(most)
    finally:
        os.close(descriptor)


def refuse_special(mode: int, path: Path) -> None:
    """Raise OSError, whose `strerror` says so, where a mode is not that of a regular file.

    For a folder it is IsADirectoryError.
    """
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    for is_kind, words in _KINDS:
        if is_kind(mode):
            raise OSError(errno.EINVAL, words, str(path))
