"""What a store is, and that of a folder.

A name holds nothing or a whole value: who reads while it is written sees what was there before.
"""

from __future__ import annotations

import mmap
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

from hpccomponent.errors import JobError, OutputError, UsageError
from hpccomponent.files.checksum import note_written
from hpccomponent.files.private_files import make_private_folder, open_at_once, remove_path
from hpccomponent.files.whole_files import write_whole
from hpccomponent.store.value import DamagedError, from_bytes, to_buffers

_NAME = re.compile(r"[A-Za-z0-9_-][A-Za-z0-9._-]*(/[A-Za-z0-9_-][A-Za-z0-9._-]*)*")


class Store(Protocol):
    """Values by name.

    A name is made of letters, digits, ``.``, ``_`` and ``-``, in parts that ``/`` separates, none
    of which begins with a dot.
    """

    def put(self, name: str, value: Any, *, replaces: bool = True) -> None:
        """Store an ndarray, int, float, bool, str, bytes, None, or tuple, list, dict of these.

        Without `replaces`, what has that name stays. Raise UsageError where the name is none, or
        the value of another type, OutputError or CloudError where it cannot be written.
        """

    def get(self, name: str) -> Any:
        """Return a value; its large arrays are read-only.

        Raise UsageError where the name is none, JobError where it is not there, or not as it was
        stored, and CloudError where the bucket does not give it.
        """

    def has(self, name: str) -> bool:
        """Tell whether there is a value of a name.

        Raise UsageError where the name is none, CloudError where the bucket does not answer.
        """

    def list(self, prefix: str = "") -> list[str]:
        """Return the names that begin so, sorted; CloudError where the bucket does not answer."""

    def delete(self, name: str) -> None:
        """Take a value away, if it is there.

        Raise UsageError where the name is none, OutputError or CloudError where it stays.
        """


def check_name(name: str) -> None:
    """Raise UsageError where a name is none; see `Store`."""
    if not _NAME.fullmatch(name):
        raise UsageError(
            f"{name!r} cannot be the name of a value",
            "use letters, digits, '.', '_' and '-', in parts separated by '/'",
        )


class FolderStore:
    """Values as files, which only their owner can read; see `Store`.

    The folder is made where there is none, for its owner alone, else OutputError. Without
    `makes_folders` neither it nor those in it are: what is put where there is none is refused.
    """

    def __init__(self, folder: Path, *, makes_folders: bool = True) -> None:
        self._folder = folder
        self._checked: set[tuple[int, ...]] = set()  # files that were found whole
        self._makes_folders = makes_folders
        if makes_folders:
            with self._translated(folder):
                make_private_folder(folder)

    def put(self, name: str, value: Any, *, replaces: bool = True) -> None:
        """See `Store.put`; a value appears when all of it is written."""
        check_name(name)
        path = self._folder / name
        buffers = to_buffers(value, name)
        if not replaces and self.has(name):
            note_written(*buffers)
            return
        with self._translated(path):
            if self._makes_folders:
                make_private_folder(path.parent)
            write_whole(path, buffers)

    def get(self, name: str) -> Any:
        """See `Store.get`; arrays stay in the mapped file until they are used.

        A file is checked when it is first read: parts of a mesh are asked for again and again.
        """
        check_name(name)
        path = self._folder / name
        try:
            with open(path, "rb", opener=open_at_once) as file:
                status = os.fstat(file.fileno())
                mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        except FileNotFoundError:
            raise JobError(f"{path} is not there", "run the job again") from None
        except (OSError, ValueError) as error:  # an empty file cannot be mapped
            why = getattr(error, "strerror", None) or error
            raise JobError(f"{path} cannot be read: {why}", "run the job again") from error
        file_id = (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns)
        try:
            value = from_bytes(memoryview(mapped), name, is_checked=file_id in self._checked)
        except DamagedError as error:
            raise JobError(f"{path} {error}", "delete it, and run the job again") from error
        self._checked.add(file_id)
        return value

    def has(self, name: str) -> bool:
        """See `Store.has`."""
        check_name(name)
        return (self._folder / name).is_file()

    def list(self, prefix: str = "") -> list[str]:
        """See `Store.list`."""
        base = self._folder / prefix.rpartition("/")[0]
        files = (path for path in base.rglob("*") if path.is_file())
        names = (path.relative_to(self._folder).as_posix() for path in files)
        return sorted(n for n in names if n.startswith(prefix) and _NAME.fullmatch(n))

    def delete(self, name: str) -> None:
        """See `Store.delete`."""
        check_name(name)
        path = self._folder / name
        with self._translated(path):
            remove_path(path)

    @contextmanager
    def _translated(self, path: Path) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise OutputError(
                f"{path}: cannot be written: {error.strerror or error}",
                f"check that {self._folder} has room and lets you write, or name another store",
            ) from error
