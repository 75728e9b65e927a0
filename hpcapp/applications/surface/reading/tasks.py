"""The points in a range of a file: surveyed, bounded, and arranged in a folder (tasks).

::

    range ── survey_range ──> counts, boxes, a sample ──> master: frame, reach, arrangement
    range ── arrange_range ──> points.N in the folder ──> its blocks
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from hpcapp.applications.surface.cloud.arrangement import Arrangement, PackedPoints, pack_points
from hpcapp.applications.surface.cloud.folder.parts import write_part
from hpcapp.applications.surface.reading.patterns import (
    RangeSurvey,
    arranged_range,
    bounded_range,
    range_bytes,
    surveyed_range,
)
from hpcapp.applications.surface.types.result_patterns import (
    SMALL_BYTES,
    CellCounts,
    CellKeys,
    Corners,
)
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.point_records import PointRecords
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.geometry.regions.region import Region
from hpcapp.geometry.validity import Dropped, Reach, are_usable, select_usable
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.records import record
from hpccomponent.runtime.tasks import declare

_AT_ONCE = 1 << 16  # points: what is made of them stays in the cache
_NOWHERE = np.zeros((0, 3))


@record("surface.file_range")
@dataclass(frozen=True, slots=True, eq=False)
class FileRange:
    """A range of a file that the worker sees; points beyond the region are left out."""

    records: PointRecords
    start: int
    stop: int
    region: Region | None = None

    def __len__(self) -> int:
        return self.stop - self.start

    @property
    def path(self) -> str:
        """The file."""
        return self.records.path

    def pieces(self) -> Iterator[PointCloud]:
        """Yield the points in their order, some at a time."""
        for start in range(self.start, self.stop, _AT_ONCE):
            part = self.records.read(start, min(start + _AT_ONCE, self.stop), ("normals",))
            yield part if self.region is None else part.take(self.region.find(part.positions))

    def counts_all(self, points: int) -> bool:
        """Tell whether so many points may be all that it gives."""
        return points == len(self) if self.region is None else points <= len(self)


@record("surface.sent_range")
@dataclass(frozen=True, slots=True, eq=False)
class SentRange:
    """A range of a file, read already: positions and normals (n, 3); the path is for messages."""

    path: str
    positions: FloatArray
    normals: FloatArray | None

    def __len__(self) -> int:
        return len(self.positions)

    def pieces(self) -> Iterator[PointCloud]:
        """Yield the points in their order, some at a time."""
        for start in range(0, len(self.positions), _AT_ONCE):
            rows = slice(start, start + _AT_ONCE)
            yield PointCloud(
                self.positions[rows], None if self.normals is None else self.normals[rows]
            )

    def counts_all(self, points: int) -> bool:
        """Tell whether so many points may be all that it gives."""
        return points == len(self)


FilePoints = FileRange | SentRange


@declare(result=surveyed_range, limit=range_bytes)
def survey_range(points: FilePoints, before: int, step: int) -> RangeSurvey:
    """Look through the points of a range (a task), with `before` usable points in front of it.

    Every so many-th usable point of the file, by `step`, is in the sample. Raises InputError where
    the file cannot be read any more.
    """
    dropped = Dropped()
    frame = box = _bound(_NOWHERE)
    usable, samples = 0, [_NOWHERE]
    for cloud in points.pieces():
        near = around = _bound(cloud.positions)
        if not are_usable(cloud):
            finite = np.isfinite(cloud.positions).all(axis=1)
            around = _bound(cloud.positions[finite])
            cloud, left_out = select_usable(cloud)
            dropped += left_out
            near = _bound(cloud.positions)
        frame, box = unite_boxes([frame, around]), unite_boxes([box, near])
        samples.append(cloud.positions[-(before + usable) % step :: step].copy())
        usable += len(cloud)
    kinds = usable, dropped.non_finite_points, dropped.bad_normals
    return RangeSurvey(*kinds, frame, box, np.concatenate(samples))


@declare(result=bounded_range, limit=SMALL_BYTES)
def bound_range(points: FilePoints, origin: FloatArray, reach: Reach) -> tuple[int, Corners]:
    """Bound the usable points of a range within reach (a task); `origin` is of the local frame."""
    count, box = 0, _bound(_NOWHERE)
    for near in _take_near(points, origin, reach):
        count += len(near)
        box = unite_boxes([box, _bound(near.positions)])
    return count, box


@declare(result=arranged_range, limit=range_bytes)
def arrange_range(
    points: FilePoints,
    origin: FloatArray,
    reach: Reach | None,
    arrangement: Arrangement,
    target: tuple[str, int],
) -> tuple[CellKeys, CellCounts]:
    """Write the usable points of a range into a folder, arranged (a task).

    `origin` is that of the local frame; points beyond the reach are left out. `target` is the
    folder, and the number of the part (see `disk_parts.write_part`). Returns the blocks of the
    part, and the points in each. Raises InputError where the file cannot be read any more,
    OutputError where the disk is full or the folder cannot be written.
    """
    pieces: list[PackedPoints] = []
    for near in _take_near(points, origin, reach):
        if len(near):
            normals = np.zeros_like(near.positions) if near.normals is None else near.normals
            pieces.append(pack_points(arrangement, near.positions, normals))
    return write_part(Path(target[0]), target[1], pieces)


def _take_near(points: FilePoints, origin: FloatArray, reach: Reach | None) -> Iterator[PointCloud]:
    """Yield the usable points within reach, in their frame, some at a time."""
    for cloud in points.pieces():
        usable, _ = select_usable(cloud)
        positions = usable.positions - origin if origin.any() else usable.positions
        local = PointCloud(positions, usable.normals)
        if reach is None or not len(local) or reach.holds(*bound_points(positions)):
            yield local
        else:
            yield local.take(reach.find_near(positions))


def _bound(positions: FloatArray) -> FloatArray:
    """Return a box around points; around none it is one that any other makes larger."""
    if not len(positions):
        return np.array([[np.inf] * 3, [-np.inf] * 3])
    return np.stack(bound_points(positions))


def unite_boxes(boxes: Sequence[FloatArray]) -> FloatArray:
    """Return the box around one box, of shape (2, 3), or more."""
    columns = np.stack(boxes)
    return np.stack([columns[:, 0].min(axis=0), columns[:, 1].max(axis=0)])
