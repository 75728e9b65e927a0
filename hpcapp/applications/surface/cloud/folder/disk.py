"""An arranged cloud in a folder: some 17 bytes a point there, and an index of its blocks in memory.

::

    points.0   points.1   points.2 ...       packed points of one part of the input each, folded
    └ blocks in the order of their keys      (see `layout`), and a last record with their checksum
    confidence.0   confidence.1 ...          an attribute that a pass has added: float32, in the
                                             order of the blocks that it stands for
    index                                    arrangement, box, the blocks of each part, estimates

Each part may be written by another machine that sees the folder; who has all of them writes the
index, without which there is no cloud. An index may also name parts in a folder beside it, and
leave out some of their blocks: so a cloud in which little is changed is not written again.
Whether all of it is as it was written is found out by `DiskCloud.check`, which a job asks that goes
on from what another has left.

Reading some blocks takes a run of each part and puts these together in the order of the parts.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import field
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud, CloudMeasures, Place, Points
from hpcapp.applications.surface.cloud.arrangement import (
    RECORDS_AT_ONCE,
    Arrangement,
    PackedPoints,
    unpack_near,
    unpack_points,
    unpacking_arguments,
)
from hpcapp.applications.surface.cloud.folder.layout import FoldedLayout, RecordLayout, SingleLayout
from hpcapp.applications.surface.cloud.folder.part_check import check_part
from hpcapp.applications.surface.cloud.folder.parts import FilePart, translated
from hpcapp.geometry.lattice import find_keys, merge_counts
from hpcapp.geometry.points import ByteArray, Float32Array, FloatArray, IntArray, PointCloud
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import HpcError, JobError
from hpccomponent.files.private_files import open_at_once
from hpccomponent.files.whole_files import write_whole
from hpccomponent.posix import read_into
from hpccomponent.store.value import DamagedError, from_bytes, to_buffers

_INDEX = "index"

ReadLayout = Callable[[int], RecordLayout]
"""Finds the layout of an open file."""


@dataclass(frozen=True, slots=True, eq=False)
class DiskCloud:
    """An arranged cloud in a folder, see `ArrangedCloud`; passes may have added attributes."""

    folder: Path
    arrangement: Arrangement
    origin: FloatArray
    low: FloatArray
    high: FloatArray
    keys: IntArray
    counts: IntArray
    parts: list[FilePart]
    noted: CloudMeasures | None = None
    attributes: Mapping[str, Sequence[FilePart]] = field(default_factory=dict)

    def __len__(self) -> int:
        return int(self.counts.sum())

    @property
    def is_here(self) -> bool:
        """Never: they need not fit into memory."""
        return False

    @property
    def place(self) -> Place:
        """See `ArrangedCloud`."""
        return str(self.folder)

    def uses(self, folder: Path) -> bool:
        """Tell whether parts of it lie in some folder."""
        every = (part for parts, _ in self._columns() for part in parts)
        names = {os.path.normpath((self.folder / part.file).parent) for part in every}
        return os.path.normpath(folder) in names

    def check(self) -> None:
        """Find out whether every part is as it was written, by reading all of them.

        DamagedError names one that is not.
        """
        for parts, read_layout in self._columns():
            for file in sorted({part.file for part in parts}):
                most = max(_count_records(part) for part in parts if part.file == file)
                path = Path(os.path.normpath(self.folder / file))
                length = check_part(path)
                with open(path, "rb", opener=open_at_once) as opened:
                    if read_layout(opened.fileno()).end(most) > length:
                        raise DamagedError(f"{path} holds other points")

    def _columns(self) -> Iterator[tuple[Sequence[FilePart], ReadLayout]]:
        """Yield the parts of the points and of each attribute, and how they lie there."""
        yield self.parts, FoldedLayout.read
        yield from ((parts, SingleLayout.read) for parts in self.attributes.values())

    def take_blocks(self, keys: IntArray) -> Points:
        """See `ArrangedCloud` and `take_packed`."""
        return unpack_points(self.arrangement, self.take_packed(keys))

    def take_within(self, keys: IntArray, low: FloatArray, high: FloatArray) -> Points:
        """See `ArrangedCloud`."""
        packed = self.take_packed(keys)
        positions, rows = unpack_near(self.arrangement, packed, low, high)
        return positions, packed.to_records()[rows, 3:].astype(np.float64)

    def take_columns(self, keys: IntArray) -> PointCloud:
        """See `ArrangedCloud`."""
        attributes = {
            name: self._take(parts, keys, SingleLayout)[1][:, 0]
            for name, parts in self.attributes.items()
        }
        return PointCloud(*self.take_blocks(keys), None, attributes, self.origin)

    def take_all(self, most: float, refusal: HpcError) -> PointCloud:
        """See `ArrangedCloud`."""
        if len(self) > most:
            raise refusal
        return self.take_columns(self.keys)

    def take_packed(self, keys: IntArray) -> PackedPoints:
        """Return the points in some blocks as they lie there; see `take_blocks`.

        JobError where the folder is not there any more, or not whole.
        """
        rows, records = self._take(self.parts, keys, FoldedLayout)
        return PackedPoints.from_records(self.keys[rows], self.counts[rows], records)

    def _take(
        self, parts: Sequence[FilePart], keys: IntArray, kind: type[FoldedLayout | SingleLayout]
    ) -> tuple[IntArray, Float32Array]:
        """Return which blocks there are of some, and their records."""
        rows = find_keys(self.keys, keys)
        rows = rows[rows < len(self.keys)]
        counts = self.counts[rows]
        records = np.empty((int(counts.sum()), kind.columns), np.float32)
        filled = np.cumsum(counts) - counts  # (k,): the row at which each block goes on
        for part in parts:
            own = find_keys(part.keys, self.keys[rows])
            held = np.flatnonzero(own < len(part.keys))
            if not len(held):
                continue
            own = own[held]
            begins, sizes, starts = part.starts[own], part.counts[own], filled[held]
            filled[held] += sizes  # the parts fill a block one after the other
            # Some blocks at a time, whose bytes stay in the cache.
            breaks = np.flatnonzero(np.diff(np.cumsum(sizes) // RECORDS_AT_ONCE)) + 1
            bounds = [0, *breaks.tolist(), len(held)]
            with self._opened(part) as file:
                layout = kind.read(file)
                for some in itertools.starmap(slice, pairwise(bounds)):
                    content = _read_runs(file, layout, begins[some], sizes[some])
                    layout.place(content, sizes[some], starts[some], records)
        return rows, records

    def sample(self, points: int) -> PointCloud:
        """Return every so many-th point of each part, about `points`, in the order of the parts.

        JobError where the folder is not there any more, or not whole.
        """
        step = -(-len(self) // points)
        keys, found = [], []
        for part in self.parts:
            ends = np.cumsum(part.counts)
            every = np.arange(0, int(part.counts.sum()), step)
            # (s,): the block of each record that is taken, and then its row in the file.
            block = np.searchsorted(ends, every, side="right")
            rows = part.starts[block] + every - (ends - part.counts)[block]
            keys.append(part.keys[block])
            records = np.empty((len(rows), FoldedLayout.columns), np.float32)
            with self._opened(part) as file:
                layout = FoldedLayout.read(file)
                mapped = np.memmap(self.folder / part.file, np.uint8, "r", layout.first)
                folded = mapped[: layout.end(_count_records(part)) - layout.first]
                content = folded.reshape(-1, layout.size)[rows].reshape(-1)
                layout.place(content, np.array([len(rows)]), np.zeros(1, np.int64), records)
            found.append(records)
        every = np.concatenate(keys)
        ones = np.ones(len(every), np.int64)
        packed = PackedPoints.from_records(every, ones, np.concatenate(found))
        return PointCloud(*unpack_points(self.arrangement, packed))

    def count_cells(
        self, keys: IntArray, origin: FloatArray, size: float
    ) -> tuple[IntArray, IntArray]:
        """See `ArrangedCloud`."""
        packed = unpacking_arguments(self.arrangement, self.take_packed(keys))
        return kernels.count_packed(*packed, origin, size)

    @property
    def measured(self) -> CloudMeasures:
        """See `ArrangedCloud`."""
        assert self.noted is not None  # noqa: S101 - or there is nothing to ask
        return self.noted

    @contextmanager
    def _opened(self, part: FilePart) -> Iterator[int]:
        """Open the file of a part, and translate what goes wrong while it is read."""
        path = self.folder / part.file
        try:
            with path.open("rb", buffering=0) as file:
                yield file.fileno()
        except (OSError, ValueError, IndexError) as error:
            what = error.strerror if isinstance(error, OSError) else "it is not whole"
            raise JobError(
                f"{path}: the points that were put there cannot be read: {what}",
                "run the job again; nobody may touch its temporary folder meanwhile",
            ) from error


def _read_runs(file: int, layout: RecordLayout, begins: IntArray, sizes: IntArray) -> ByteArray:
    """Return the bytes of some records: so many from each of some on, one run after the other."""
    content = np.empty(layout.size * int(sizes.sum()), np.uint8)
    # Blocks that stand side by side in the file are read at once.
    breaks = np.flatnonzero(begins[1:] != begins[:-1] + sizes[:-1]) + 1
    firsts = np.append(0, breaks)
    starts = layout.first + layout.size * begins[firsts]
    ends = layout.size * np.cumsum(sizes)[np.append(breaks, len(sizes)) - 1]
    view, at = content.data, 0
    for start, end in zip(starts.tolist(), ends.tolist(), strict=True):
        while at < end:  # it may be less than was asked for
            taken = read_into(file, view[at:end], start)
            if not taken:
                raise ValueError("the file has become shorter")
            at, start = at + taken, start + taken
    return content


def _count_records(part: FilePart) -> int:
    """Return how many points a file must hold for what is taken of it."""
    return int((part.starts + part.counts).max(initial=0))


def write_index(
    folder: Path,
    arrangement: Arrangement,
    origin: FloatArray,
    box: tuple[FloatArray, FloatArray],
    parts: Sequence[FilePart],
    measured: CloudMeasures | None = None,
    attributes: Mapping[str, Sequence[FilePart]] | None = None,
) -> DiskCloud:
    """Make a cloud of the parts that have been written.

    `origin` (3,) was subtracted from the input's coordinates; `box` has the least and the largest
    ones. OutputError where the disk is full, or the folder cannot be written.
    """
    index = {
        "edge": float(arrangement.edge),
        "corner": arrangement.origin,
        "framed": arrangement.box,
        "origin": origin,
        "box": np.stack(box),
        "parts": [_tell(part) for part in parts],
        "attributes": {
            name: [_tell(part) for part in some] for name, some in (attributes or {}).items()
        },
        "measured": None if measured is None else measured.to_values(),
    }
    with translated(folder):
        write_whole(folder / _INDEX, to_buffers(index, folder.name))
    return _put_together(folder, arrangement, origin, box, parts, measured, attributes or {})


def _tell(part: FilePart) -> tuple[str, IntArray, IntArray, IntArray]:
    return part.file, part.keys, part.counts, part.starts


def open_disk_cloud(folder: Path) -> DiskCloud:
    """Open a cloud whose index has been written; JobError where the folder holds none.

    It is the one that this process has opened before, if nothing has changed.
    """
    try:
        found = (folder / _INDEX).stat()
        return _open(folder, found.st_mtime_ns, found.st_ino)
    except (OSError, DamagedError) as error:
        why = getattr(error, "strerror", None) or error
        raise JobError(
            f"{folder / _INDEX} holds no arranged points: {why}", "run the job again"
        ) from error


def open_place(place: Place) -> ArrangedCloud:
    """Return the cloud that lies in some place; JobError where a folder holds none."""
    return open_disk_cloud(Path(place)) if isinstance(place, str) else place


@lru_cache(maxsize=2)
def _open(folder: Path, *_version: int) -> DiskCloud:
    with open(folder / _INDEX, "rb", opener=open_at_once) as file:
        index = from_bytes(memoryview(file.read()), folder.name)
    parts = [FilePart(*part) for part in index["parts"]]
    told = index["measured"]
    measured = None if told is None else CloudMeasures.of_values(told)
    arrangement = Arrangement(index["corner"], index["edge"], index["framed"])
    attributes = {
        name: [FilePart(*part) for part in some] for name, some in index["attributes"].items()
    }
    return _put_together(
        folder, arrangement, index["origin"], index["box"], parts, measured, attributes
    )


def _put_together(
    folder: Path,
    arrangement: Arrangement,
    origin: FloatArray,
    box: tuple[FloatArray, FloatArray] | FloatArray,
    parts: Sequence[FilePart],
    measured: CloudMeasures | None,
    attributes: Mapping[str, Sequence[FilePart]],
) -> DiskCloud:
    """Return the cloud of some parts."""
    keys = np.concatenate([part.keys for part in parts])
    merged = merge_counts(keys, np.concatenate([part.counts for part in parts]))
    return DiskCloud(
        folder, arrangement, origin, box[0], box[1], *merged, list(parts), measured, attributes
    )
