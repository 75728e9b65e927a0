"""From a file to an arranged cloud on disk: the points are never in memory at once.

::

    file ── parts ──> survey: counts, boxes, a sample            first pass
      │                  │ frame, reach, arrangement
      └─── parts ──> usable, local, near ── arranged ──> folder   second pass

Each pass reads all of the file, and parses it where it is text; a third one bounds the points
near the cloud where there are markers far away. Colours are left behind: a mesh has none.
Who may import it: the job.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hpcapp.applications.surface.cleaning import EvenSample, Reach, find_reach
from hpcapp.io.frame import choose_origin
from hpcapp.io.point_source import PointSource
from hpcapp.io.usable import (
    Dropped,
    refuse_degenerate,
    refuse_line,
    refuse_too_few,
    select_usable,
)
from hpccomponent.errors import InputError
from hpccomponent.surface.arrangement import choose_arrangement
from hpccomponent.surface.disk_cloud import DiskCloud, DiskCloudWriter
from hpccomponent.surface.points import FloatArray, PointCloud, bounding_box

__all__ = ["Ingested", "ingest_file"]

ROWS_AT_ONCE = 1 << 20
"""Some 200 bytes each: 200 MB."""


@dataclass(frozen=True, slots=True, eq=False)
class Ingested:
    """A cloud that was put into a folder, and what was left out.

    Parameters
    ----------
    cloud : DiskCloud
    dropped : Dropped
        Points without a finite position and a normal.
    far : int
        Points that were dropped because they lie far away (see `cleaning.drop_far`).
    """

    cloud: DiskCloud
    dropped: Dropped
    far: int


class _Box:
    """Grows around points."""

    def __init__(self) -> None:
        self.low, self.high = np.full(3, np.inf), np.full(3, -np.inf)

    def add(self, low: FloatArray, high: FloatArray) -> None:
        self.low, self.high = np.minimum(self.low, low), np.maximum(self.high, high)


def ingest_file(
    source: PointSource, folder: Path, *, drop_far: bool = True, rows: int = ROWS_AT_ONCE
) -> Ingested:
    """Arrange the usable points of a file in a folder.

    Parameters
    ----------
    source : PointSource
    folder : Path
        Exists; 24 bytes a point are written.
    drop_far : bool
        Whether to drop points far from all others.
    rows : int
        Points in memory at once; the cloud does not depend on it.

    Returns
    -------
    Ingested
        The points that `drop_unusable`, `drop_far` and `arrange_cloud` leave of the whole file,
        bit for bit.

    Raises
    ------
    InputError
        The file is damaged, or holds no surface: see `drop_unusable`.
    OutputError
        The disk is full, or the folder cannot be written.
    """
    name = str(source.path)
    box, sample, origin, dropped, points = _survey(source, rows)
    refuse_too_few(points, dropped, name)
    refuse_degenerate(box.low, box.high, points, name)
    refuse_line(
        lambda: [sample],
        lambda: (part.positions for part in _usable_parts(source, rows, origin)),
        points,
        name,
    )
    reach = find_reach(sample) if drop_far else None
    if reach is not None and not reach.holds(box.low, box.high):
        box = _Box()
        for part in _usable_parts(source, rows, origin):
            _grow(box, _near(part, reach))
    writer = DiskCloudWriter(folder, choose_arrangement(box.low, box.high), origin)
    for part in _usable_parts(source, rows, origin):
        near = _near(part, reach)
        if near.normals is not None:  # it is not: mypy cannot know
            writer.add(near.positions, near.normals)
    cloud = writer.finish()
    return Ingested(cloud, dropped, points - len(cloud))


def _survey(source: PointSource, rows: int) -> tuple[_Box, FloatArray, FloatArray, Dropped, int]:
    """Bound and sample the usable points, choose their frame, and count what is not usable."""
    box, frame, sample = _Box(), _Box(), EvenSample()
    points = not_finite = bad_normals = total = 0
    for part in source.chunks(rows):
        total += len(part)
        finite = part.positions[np.isfinite(part.positions).all(axis=1)]
        if len(finite):
            frame.add(*bounding_box(finite))
        usable, dropped = select_usable(part, str(source.path))
        _grow(box, usable)
        sample.add(usable.positions)
        points += len(usable)
        not_finite += dropped.non_finite_points
        bad_normals += dropped.bad_normals
    if not total:
        raise InputError(f"{source.path} holds no points", "check that the right file was exported")
    dropped = Dropped(not_finite, bad_normals)
    if not points:
        return box, sample.positions, np.zeros(3), dropped, 0
    origin = choose_origin(frame.low, frame.high)
    if origin.any():
        box.low, box.high = box.low - origin, box.high - origin
    return box, sample.positions - origin, origin, dropped, points


def _usable_parts(source: PointSource, rows: int, origin: FloatArray) -> Iterator[PointCloud]:
    """Yield the usable points in their frame."""
    for part in source.chunks(rows):
        usable, _ = select_usable(part, str(source.path))
        positions = usable.positions - origin if origin.any() else usable.positions
        yield PointCloud(positions, usable.normals, None, origin)


def _near(part: PointCloud, reach: Reach | None) -> PointCloud:
    """Return the points within reach."""
    if reach is None or not len(part) or reach.holds(*bounding_box(part.positions)):
        return part
    return part.take(reach.find_near(part.positions))


def _grow(box: _Box, part: PointCloud) -> None:
    if len(part):
        box.add(*bounding_box(part.positions))
