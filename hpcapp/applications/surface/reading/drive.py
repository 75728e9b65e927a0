"""From a file to an arranged cloud on disk: the points are never in memory at once.

::

    file ── ranges ──> survey: counts, boxes, a sample             first pass
      │                   │ frame, reach, arrangement
      └──── ranges ──> usable, local, near ── arranged ──> folder   second pass

A range of a binary PLY is read, and its part of the folder written, by whoever runs its task;
other formats are parsed here, in each pass. A third one bounds the points near the cloud where
there are markers far away. Colours are left behind: a mesh has none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hpcapp.applications.surface.cloud.arrangement import snap_points
from hpcapp.applications.surface.cloud.folder.disk import DiskCloud, write_index
from hpcapp.applications.surface.cloud.folder.parts import FilePart
from hpcapp.applications.surface.cloud.frame import Frame
from hpcapp.applications.surface.cloud.point_workers import PointWorkers
from hpcapp.applications.surface.reading.patterns import RangeSurvey
from hpcapp.applications.surface.reading.reach import EvenSample, even_step, find_reach
from hpcapp.applications.surface.reading.tasks import (
    FileRange,
    SentRange,
    arrange_range,
    bound_range,
    survey_range,
    unite_boxes,
)
from hpcapp.geometry.points import FloatArray
from hpcapp.geometry.validity import Dropped, select_usable
from hpcapp.io.frame import choose_origin
from hpcapp.io.points.point_source import PointSource
from hpcapp.io.points.usable import refuse_degenerate, refuse_line, refuse_too_few
from hpccomponent.cli.terminal import visible_text
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

Task = Callable[..., Any]

_NOWHERE = np.zeros((0, 3))
_LOOKED_AT = 1 << 20  # points at once


@dataclass(frozen=True, slots=True, eq=False)
class Ingested:
    """A cloud that was put into a folder, and what was left out.

    `dropped` are points without a finite position, or without a normal where others have one; `far`
    counts those that were dropped because they lie far away (see `reach.drop_far`).
    """

    cloud: DiskCloud
    dropped: Dropped
    far: int


@dataclass(frozen=True, slots=True, eq=False)
class _Survey:
    """What the first pass finds: a sample, the points' frame, and boxes around them in it."""

    points: int
    dropped: Dropped
    origin: FloatArray
    box: FloatArray
    sample: FloatArray

    def moved(self, frame: Frame) -> _Survey:
        """Return the same in the local frame of another origin, if that is known already."""
        shift = self.origin - (origin := frame.place(self.origin))
        if not shift.any():
            return self
        return replace(self, origin=origin, box=self.box + shift, sample=self.sample + shift)


def ingest_file(
    source: PointSource,
    folder: Path,
    workers: PointWorkers,
    frame: Frame | None = None,
    *,
    drop_far: bool = True,
) -> Ingested:
    """Arrange the usable points of a file in a folder, which exists.

    They are those that `drop_unusable`, `drop_far` and `arrange_cloud` leave of the whole file, bit
    for bit, whatever the workers; unless asked to `drop_far`, those far from all others stay. The
    `frame` chooses their blocks, by default by their box. Some 17 bytes a point are written (see
    `layout`). Raises InputError where the file is damaged or holds no surface, OutputError where
    the disk is full or the folder cannot be written.
    """
    name = str(source.path)
    if not workers.workers_see_input:
        workers = replace(workers, workers_see=False)
    frame = Frame() if frame is None else frame
    survey = _survey_records if source.records else _survey_parts
    found = survey(source, workers).moved(frame)
    refuse_too_few(found.points, found.dropped, name)
    refuse_degenerate(found.box[0], found.box[1], found.points, name)
    refuse_line(
        lambda: [found.sample],
        lambda: _usable_positions(source, workers.points, found.origin),
        found.points,
        name,
    )
    points, box, reach = found.points, found.box, None
    if drop_far and not (near := find_reach(found.sample)).holds(*box):
        reach = near
        bounded = list(_run(source, workers, bound_range, lambda _: (found.origin, reach)))
        points = sum(count for count, _ in bounded)
        box = unite_boxes([part for _, part in bounded])
    blocks = frame.arrange(*box)
    low, high = blocks.bound(*snap_points(blocks, box))  # rounding leaves the least the least
    common = found.origin, reach, blocks
    written = _run(source, workers, arrange_range, lambda i: (*common, (str(folder), i)))
    parts = [FilePart.whole(i, *arranged) for i, arranged in enumerate(written)]
    cloud = write_index(folder, blocks, found.origin, (low, high), parts)
    return Ingested(cloud, found.dropped, found.points - points)


def _survey_records(source: PointSource, workers: PointWorkers) -> _Survey:
    """Survey a file range by range, wherever; most files have no unusable points."""
    assert source.records is not None  # noqa: S101 - or this would not be called
    source.check()
    ranges = workers.cut_rows(source.records.count)
    before, step = [some.start for some in ranges], even_step(source.records.count)
    found = list(_run(source, workers, survey_range, lambda i: (before[i], step)))
    usable = [part.usable for part in found]
    true, true_step = [sum(usable[:i]) for i in range(len(usable))], even_step(sum(usable))
    if true_step != step or any((a - b) % step for a, b in zip(before, true, strict=True)):
        found = list(_run(source, workers, survey_range, lambda i: (true[i], true_step)))
    return _put_together(source, found, [part.sample for part in found])


def _survey_parts(source: PointSource, workers: PointWorkers) -> _Survey:
    """Survey a file that is parsed here."""
    sample, found = EvenSample(), []
    for part in _run(source, workers, survey_range, lambda _: (0, 1)):
        sample.add(part.sample)
        found.append(replace(part, sample=_NOWHERE))
    return _put_together(source, found, [sample.positions])


def _put_together(
    source: PointSource, found: list[RangeSurvey], samples: list[FloatArray]
) -> _Survey:
    usable = sum(part.usable for part in found)
    dropped = Dropped(
        sum(part.non_finite for part in found), sum(part.bad_normals for part in found)
    )
    if not usable + dropped.total:
        for _ in source.chunks(_LOOKED_AT):
            """Where nothing is in the region that is asked for, it says so."""
        raise InputError(f"{source.path} holds no points", "check that the right file was exported")
    sample = np.concatenate(samples)
    box = unite_boxes([part.box for part in found])
    if not usable:
        return _Survey(0, dropped, np.zeros(3), box, sample)
    origin = choose_origin(*unite_boxes([part.frame for part in found]))
    if origin.any():
        box, sample = box - origin, sample - origin
    return _Survey(usable, dropped, origin, box, sample)


def _run(
    source: PointSource, workers: PointWorkers, task: Task, more: Callable[[int], tuple[Any, ...]]
) -> Iterator[Any]:
    """Run a task for each range of a file, given more arguments; in the order of the file."""
    if source.records is not None:
        path = str(source.path.resolve())  # workers need not be where this process is
        records = replace(source.records, path=path)
        ranges = workers.cut_rows(source.records.count)
        there = [FileRange(records, some.start, some.stop, source.region) for some in ranges]
        yield from workers.map(task, [(points, *more(i)) for i, points in enumerate(there)])
        return
    for i, part in enumerate(source.chunks(workers.points)):
        yield task(
            SentRange(visible_text(str(source.path)), part.positions, part.normals), *more(i)
        )


def _usable_positions(source: PointSource, rows: int, origin: FloatArray) -> Iterator[FloatArray]:
    """Yield the positions of all usable points, read here."""
    for part in source.chunks(rows):
        usable, _ = select_usable(part)
        yield usable.positions - origin if origin.any() else usable.positions
