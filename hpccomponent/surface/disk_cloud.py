"""An arranged cloud in a folder: 24 bytes a point there, and an index of its blocks in memory.

::

    points.0   points.1   points.2 ...       packed points of one part of the input each,
    └ blocks in the order of their keys      offsets and normals side by side (float32)
    index.npz                                arrangement, box, and the blocks of each part

Reading some blocks takes a run of each part and puts these together in the order of the parts.
Who may import it: applications, and tasks on machines that see the folder.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from hpccomponent.errors import JobError, OutputError
from hpccomponent.surface.arranged_cloud import Points, cut_blocks, find_runs
from hpccomponent.surface.arrangement import (
    Arrangement,
    PackedPoints,
    pack_points,
    unpack_points,
)
from hpccomponent.surface.lattice import find_keys, unique_keys
from hpccomponent.surface.points import FloatArray, IntArray

__all__ = ["DiskCloud", "DiskCloudWriter", "open_disk_cloud"]

_INDEX = "index.npz"
_COLUMNS = 6  # float32 a point: offset and normal
_POINT_BYTES = 4 * _COLUMNS


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """The blocks of one file: block i holds its points offsets[i] to offsets[i + 1]."""

    keys: IntArray
    offsets: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class DiskCloud:
    """An arranged cloud in a folder; see `ArrangedCloud`.

    Parameters
    ----------
    folder : Path
    arrangement : Arrangement
    origin, low, high : ndarray of float64, shape (3,)
    keys, counts : ndarray of int64, shape (b,)
    parts : list of _Part
        Of its files.
    """

    folder: Path
    arrangement: Arrangement
    origin: FloatArray
    low: FloatArray
    high: FloatArray
    keys: IntArray
    counts: IntArray
    parts: list[_Part]

    def __len__(self) -> int:
        return int(self.counts.sum())

    def take_blocks(self, keys: IntArray) -> Points:
        """See `ArrangedCloud`.

        Raises
        ------
        JobError
            The folder is not there any more, or not whole.
        """
        rows = find_keys(self.keys, keys)
        rows = rows[rows < len(self.keys)]
        counts = self.counts[rows]
        records = np.empty((int(counts.sum()), _COLUMNS), np.float32)
        filled = np.cumsum(counts) - counts  # where the next point of each block belongs
        for number, part in enumerate(self.parts):
            own = find_keys(part.keys, self.keys[rows])
            held = np.flatnonzero(own < len(part.keys))
            if not len(held):
                continue
            lengths = np.diff(part.offsets)[own[held]]
            starts = np.cumsum(lengths) - lengths
            targets = np.repeat(filled[held] - starts, lengths) + np.arange(lengths.sum())
            records[targets] = self._read(number, own[held])
            filled[held] += lengths
        packed = PackedPoints(self.keys[rows], counts, records[:, :3], records[:, 3:])
        return unpack_points(self.arrangement, packed)

    def groups(self, points: int) -> Iterator[Points]:
        """See `ArrangedCloud`."""
        for run in cut_blocks(self.counts, points):
            yield self.take_blocks(self.keys[run])

    def _read(self, number: int, blocks: IntArray) -> NDArray[np.float32]:
        """Read the points in some blocks of a part."""
        path = self.folder / f"points.{number}"
        offsets = self.parts[number].offsets
        runs = [(int(offsets[run.start]), int(offsets[run.stop])) for run in find_runs(blocks)]
        wanted = np.empty((sum(stop - start for start, stop in runs), _COLUMNS), np.float32)
        at = 0
        try:
            with path.open("rb", buffering=0) as file:
                for start, stop in runs:
                    file.seek(start * _POINT_BYTES)
                    _fill(file, wanted[at : at + stop - start], path)
                    at += stop - start
        except OSError as error:
            raise JobError(
                f"{path}: the points that were put there cannot be read: {error.strerror}",
                "run the job again; nobody may touch its temporary folder meanwhile",
            ) from error
        return wanted


def _fill(file: Any, rows: NDArray[np.float32], path: Path) -> None:
    view = rows.reshape(-1).view(np.uint8).data
    while len(view):
        taken = file.readinto(view)
        if not taken:
            raise JobError(
                f"{path} has become shorter",
                "run the job again; nobody may touch its temporary folder meanwhile",
            )
        view = view[taken:]


class DiskCloudWriter:
    """Writes an arranged cloud part by part.

    Parameters
    ----------
    folder : Path
        Exists, and holds no other cloud.
    arrangement : Arrangement
    origin : ndarray of float64, shape (3,)
        What was subtracted from the input's coordinates.
    """

    def __init__(self, folder: Path, arrangement: Arrangement, origin: FloatArray) -> None:
        self._folder = folder
        self._arrangement = arrangement
        self._origin = origin
        self._parts: list[_Part] = []
        self._low, self._high = np.full(3, np.inf), np.full(3, -np.inf)

    def add(self, positions: FloatArray, normals: FloatArray) -> None:
        """Arrange the next points of the cloud and write them.

        Parameters
        ----------
        positions, normals : ndarray of float64, shape (n, 3)

        Raises
        ------
        OutputError
            The disk is full, or the folder cannot be written.
        """
        if not len(positions):
            return
        packed = pack_points(self._arrangement, positions, normals)
        snapped, _ = unpack_points(self._arrangement, packed)
        self._low = np.minimum(self._low, [column.min() for column in snapped.T])
        self._high = np.maximum(self._high, [column.max() for column in snapped.T])
        records = np.concatenate([packed.offsets, packed.normals], axis=1)
        with (
            _translated(self._folder),
            (self._folder / f"points.{len(self._parts)}").open("wb") as file,
        ):
            file.write(records.data)
        self._parts.append(_Part(packed.keys, np.append(0, np.cumsum(packed.counts))))

    def finish(self) -> DiskCloud:
        """Write the index and return the cloud.

        Raises
        ------
        OutputError
            The disk is full, or the folder cannot be written.
        """
        every = np.concatenate([part.keys for part in self._parts])
        with _translated(self._folder):
            np.savez(
                self._folder / _INDEX,
                edge=np.float64(self._arrangement.edge),
                corner=self._arrangement.origin,
                origin=self._origin,
                box=np.stack([self._low, self._high]),
                blocks=np.array([len(part.keys) for part in self._parts], np.int64),
                keys=every,
                counts=np.concatenate([np.diff(part.offsets) for part in self._parts]),
            )
        return open_disk_cloud(self._folder)


def open_disk_cloud(folder: Path) -> DiskCloud:
    """Open a cloud that a `DiskCloudWriter` has written.

    Parameters
    ----------
    folder : Path

    Returns
    -------
    DiskCloud

    Raises
    ------
    JobError
        The folder holds none.
    """
    try:
        with np.load(folder / _INDEX, allow_pickle=False) as index:
            held = {name: index[name] for name in index.files}
        bounds = np.cumsum(held["blocks"])[:-1]
        every, counts = held["keys"], held["counts"]
        parts = [
            _Part(keys, np.append(0, np.cumsum(sizes)))
            for keys, sizes in zip(np.split(every, bounds), np.split(counts, bounds), strict=True)
        ]
        keys = unique_keys(every)
        totals = np.bincount(np.searchsorted(keys, every), counts, len(keys)).astype(np.int64)
        arrangement = Arrangement(held["corner"], float(held["edge"]))
        low, high = held["box"]
        return DiskCloud(folder, arrangement, held["origin"], low, high, keys, totals, parts)
    except (OSError, ValueError, KeyError, BadZipFile) as error:
        raise JobError(
            f"{folder} holds no arranged points: {error}", "run the job again"
        ) from error


@contextmanager
def _translated(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"{folder}: the points cannot be put there: {error.strerror or error}",
            "name a temporary folder with 24 bytes of room for each point, twice",
        ) from error
