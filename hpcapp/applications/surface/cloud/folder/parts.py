"""The files of a cloud in a folder: packed points, and attributes beside them; see `disk`."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

from hpcapp.applications.surface.cloud.arrangement import PackedPoints
from hpcapp.applications.surface.cloud.folder.layout import FoldedLayout
from hpcapp.applications.surface.cloud.folder.part_check import with_check
from hpcapp.geometry.lattice import find_keys, merge_counts
from hpcapp.geometry.points import Float32Array, IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import OutputError
from hpccomponent.files.whole_files import write_whole


@dataclass(frozen=True, slots=True, eq=False)
class FilePart:
    """The blocks of one file that belong to a cloud.

    `file` is its name as seen from the folder. Of the blocks (b,) there are the sorted keys, the
    counts of points, and which point of the file is the first of each.
    """

    file: str
    keys: IntArray
    counts: IntArray
    starts: IntArray

    @classmethod
    def whole(cls, number: int, keys: IntArray, counts: IntArray) -> FilePart:
        """Return all that `write_part` has written as a part of this number."""
        return cls(_name_part(number), keys, counts, np.cumsum(counts) - counts)

    def filled(self) -> FilePart:
        """Return it without the blocks that hold no points."""
        return self._take(np.flatnonzero(self.counts), self.file)

    def without(self, keys: IntArray, folder: str) -> FilePart:
        """Return it without blocks of sorted keys (k,), for an index that sees it in `folder`."""
        kept = np.flatnonzero(find_keys(keys, self.keys) == len(keys))
        return self._take(kept, os.path.normpath(os.path.join(folder, self.file)))

    def _take(self, rows: IntArray, file: str) -> FilePart:
        return FilePart(file, self.keys[rows], self.counts[rows], self.starts[rows])


def write_part(
    folder: Path, number: int, pieces: Sequence[PackedPoints]
) -> tuple[IntArray, IntArray]:
    """Write part `number`, from 0, of an arranged cloud; return its blocks and their counts, (b,).

    The points of a block come in the order of the pieces; if there are none, no file is written.
    OutputError where the disk is full, or the folder cannot be written.
    """
    if not pieces:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    with translated(folder):
        write_whole(
            folder / _name_part(number),
            with_check(FoldedLayout.of(pieces).write(pieces), folder / _name_part(number)),
        )
    keys = np.concatenate([piece.keys for piece in pieces])
    return merge_counts(keys, np.concatenate([piece.counts for piece in pieces]))


def write_attribute(
    folder: Path, name: str, part: FilePart, number: int, values: Float32Array
) -> FilePart:
    """Write one part of an attribute: values (n,) in the order of the points that `part` has.

    OutputError where the disk is full, or the folder cannot be written.
    """
    file = f"{name}.{number}"
    piece = np.ascontiguousarray(values).view(np.uint8).data
    with translated(folder):
        write_whole(folder / file, with_check([piece], folder / file))
    return replace(part, file=file)


def _name_part(number: int) -> str:
    return f"points.{number}"


@contextmanager
def translated(folder: Path) -> Iterator[None]:
    """Say of a folder what the system says of its files."""
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"{folder}: the points cannot be put there: {error.strerror or error}",
            "name a temporary folder with 21 bytes of room for each point, twice",
        ) from error
