"""The rule for all that a call writes: nothing that it reads, and nothing else of it, is lost.

::

    files written ─┐
                   ├─ check_files ─> nothing, or one OutputError before anything is opened
    files read ────┘

A path stands for where it leads: two are one file by a link of either kind, by another spelling, or
by letters that differ in case alone, which some disks do not tell apart; also where there is no
file yet.
"""

from __future__ import annotations

import enum
import os
import stat
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import permutations
from pathlib import Path
from typing import TypeAlias
from unicodedata import normalize

from hpccomponent.dataclass import dataclass
from hpccomponent.errors import OutputError
from hpccomponent.posix import AS_BYTES

STANDARD_INPUT = ("-", "/dev/stdin", "/dev/fd/0", "/proc/self/fd/0")
STANDARD_OUTPUT = ("-", "/dev/stdout", "/dev/fd/1", "/proc/self/fd/1")
"""Their names."""

_Key: TypeAlias = "tuple[object, ...]"


class Role(enum.Enum):
    """How something is written."""

    FILE = enum.auto()  # replaced as a whole
    STREAM = enum.auto()  # as it comes; it may be a pipe or a device
    FOLDER = enum.auto()  # a new one, whose files nobody else writes
    SCRATCH = enum.auto()  # a folder that may be there, for new files under names of their own
    PRINTED = enum.auto()  # on the standard output


@dataclass(frozen=True, slots=True)
class Read:
    """A file or a folder that a call reads; its option is empty for what the call is about."""

    path: Path
    option: str = ""


@dataclass(frozen=True, slots=True)
class Written:
    """A file or a folder that a call writes.

    An option names it, in Python none. It needs one of `suffixes`, in any case, if there are any;
    `what` is what they stand for, as "page". With `is_beside` it lies beside what the option names,
    with `makes_folders` missing folders above it are made.
    """

    path: Path
    option: str = ""
    role: Role = Role.FILE
    suffixes: tuple[str, ...] = ()
    what: str = "file"
    is_beside: bool = False
    makes_folders: bool = False

    def __str__(self) -> str:
        if self.role is Role.PRINTED:
            return self.option
        if self.is_beside:
            return f"{self.path} (beside {self.option or 'it'})"
        return f"{self.option} {self.path}".strip()

    @property
    def advice(self) -> str:
        """What to do where it cannot be written there."""
        if self.role is Role.PRINTED:
            return "lead the standard output elsewhere"
        return f"give another {self.option}" if self.option else "give another name"

    def check_place(self) -> None:
        """Find out whether it can be written, and leave nothing behind; OutputError where not."""
        try:
            match self.role:
                case Role.FILE:
                    check_place(self.path, self.makes_folders)
                case Role.STREAM:
                    _check_stream(self.path)
                case Role.FOLDER:
                    check_folder(self.path)
                case Role.PRINTED if sys.stdout is None:
                    raise OutputError(f"{self}: the standard output is closed", "write to a file")
        except OutputError as error:
            if not self.is_beside:
                raise
            problem = f"beside {self.option or 'it'}, {error.problem}"
            raise OutputError(problem, self.advice) from None


def check_files(written: Sequence[Written], read: Sequence[Read] = ()) -> None:
    """Find out, before anything is opened, whether a call can write its files and loses none.

    All of the call are given, and of a folder that is read all that is in it. Raise OutputError
    where a file cannot be written, is written twice, or is read.
    """
    for one in written:
        if one.suffixes and one.path.suffix.lower() not in one.suffixes:
            raise OutputError(
                f"{one}: is no {one.what}", f"give a file that ends in {one.suffixes[0]}"
            )
    placed = [(one, *_find_place(one.path)) for one in written]
    for (one, own, _), (other, other_own, other_above) in permutations(placed, 2):
        if one.role is other.role is Role.PRINTED:
            problem = f"{one} and {other} both want the standard output"
            raise OutputError(problem, "give one of them")
        if own & other_own:
            raise OutputError(f"{one} and {other} are one file", "give each a name of its own")
        if own & other_above and one.role is not Role.SCRATCH:
            raise OutputError(f"{other} lies in {one}", other.advice)
    for source in read:
        key = _find_inode(source.path)
        for one, own, above in placed:
            if one.role is Role.SCRATCH:
                continue
            if key in own:
                kept = f"the file of {source.option}" if source.option else "the input itself"
                raise OutputError(f"{one} is {kept}", one.advice)
            if key in above and one.role is not Role.PRINTED and os.path.lexists(one.path):
                problem = f"{one} is there, in the folder of {source.option or 'the input'}"
                raise OutputError(problem, one.advice)
    for one in written:
        one.check_place()


def _find_inode(path: Path) -> _Key | None:
    """Return what tells what is at a path from all else; an empty one of a device."""
    try:
        found = os.stat(path)
    except OSError:
        return None
    return () if stat.S_ISCHR(found.st_mode) else (found.st_dev, found.st_ino)


def _find_place(path: Path) -> tuple[set[_Key], set[_Key]]:
    """Return what a path is known by, and what the folders above it are known by.

    What is there by its inode; that, and what is not there, by the nearest folder that is, and the
    names below it. A device, which loses nothing, by nothing.
    """
    real = Path(os.path.realpath(path))
    own: set[_Key] = set()
    above: set[_Key] = set()
    base: _Key = ()
    for part in (*reversed(real.parents), real):
        above |= own
        base = (*base, normalize("NFC", part.name).casefold())
        inode = _find_inode(path if part is real else part)
        own = {base} if inode is None else {base, inode}
        base = inode or base
    return (set(), set()) if () in own else (own, above)


@contextmanager
def staged(path: Path) -> Iterator[tuple[Path, Path]]:
    """Give the file meant by `path` and a new name beside it, and free that name afterwards."""
    target = Path(os.path.realpath(path))
    beside = name_beside(target)
    with translated(path, target):
        if target.exists() and not target.is_file():
            raise OutputError(f"{path}: is not a file", "name a file to write to")
        try:
            yield target, beside
        finally:
            beside.unlink(missing_ok=True)


def name_beside(path: Path) -> Path:
    """Return a new name in the folder of a path."""
    return path.with_name(f".hpcapp-{os.urandom(8).hex()}.tmp")


@contextmanager
def translated(path: Path, target: Path) -> Iterator[None]:
    """Turn the system's errors of writing into ours: advice is on where `path` leads to."""
    try:
        yield
    except OSError as error:
        advice = f"check the name, and that {target.parent} has room and lets you write"
        raise OutputError(
            f"{path}: cannot be written: {error.strerror or error}",
            advice if target.parent.is_dir() else f"create the folder {target.parent} first",
        ) from error


def usual_mode(path: Path) -> int:
    """Return the rights that a new file of this name has, by making one.

    The umask alone does not tell: a folder may have rules of its own.
    """
    with path.open("xb") as file:
        mode = stat.S_IMODE(os.fstat(file.fileno()).st_mode)
    path.unlink()
    return mode


def usual_folder_mode(path: Path) -> int:
    """Return the rights that a new folder of this name has, by making one."""
    path.mkdir()
    mode = stat.S_IMODE(path.stat().st_mode)
    path.rmdir()
    return mode


def check_place(path: Path, makes_folders: bool = False) -> None:
    """Find out now whether a file can be written later, and leave nothing behind.

    Permissions are tried, not read: what root may do, or a read-only file system forbids, they do
    not tell. Raise OutputError where the folder cannot be written or is missing (unless
    `makes_folders`), or `path` is not a file.
    """
    with staged(path) as (target, beside):
        if not makes_folders or target.parent.is_dir():
            usual_mode(beside)
            return
        folder = target.parent
        while not os.path.lexists(folder.parent):
            folder = folder.parent
        usual_folder_mode(name_beside(folder))


def _check_stream(path: Path) -> None:
    """Do the same for a file that is written as it comes; a pipe or a device is tried later."""
    with translated(path, path):
        if not path.exists():
            check_place(path)
        elif path.is_dir():
            raise OutputError(f"{path}: is not a file", "name a file to write to")
        elif path.is_file():
            os.close(os.open(path, os.O_WRONLY | AS_BYTES))


def check_folder(path: Path) -> None:
    """Find out now whether a folder can be written later, and leave nothing behind.

    Raise OutputError where it cannot, or there is something in it.
    """
    target = Path(os.path.realpath(path))
    with translated(path, target):
        if target.exists() and not target.is_dir():
            raise OutputError(f"{path}: is not a folder", "tiles need a new folder")
        if target.is_dir() and any(target.iterdir()):
            raise OutputError(f"{path}: is not empty", "name a new folder, or remove this one")
        usual_folder_mode(name_beside(target))
