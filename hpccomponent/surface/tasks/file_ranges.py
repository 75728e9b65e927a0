"""The points in a range of a file: surveyed, bounded, and arranged in a folder (tasks).

::

    range ── survey_range ──> counts, boxes, a sample ──> master: frame, reach, arrangement
    range ── arrange_range ──> points.N in the folder ──> its blocks, boxes that hold points
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hpccomponent.runtime.tasks import declare
from hpccomponent.surface import kernels
from hpccomponent.surface.cloud.arrangement import (
    Arrangement,
    PackedPoints,
    pack_snapped,
    snap_points,
)
from hpccomponent.surface.cloud.disk import write_part
from hpccomponent.surface.cloud.point_records import PointRecords
from hpccomponent.surface.cloud.spacing import sample_box_keys
from hpccomponent.surface.cloud.validity import Dropped, Reach, are_usable, select_usable
from hpccomponent.surface.kernels import bound_points
from hpccomponent.surface.tasks.result_patterns import (
    SMALL_BYTES,
    arranged_range,
    bounded_range,
    range_bytes,
    surveyed_range,
)
from hpccomponent.surface.types.lattice import unique_keys
from hpccomponent.surface.types.points import FloatArray, IntArray, PointCloud

__all__ = ["BoxCounts", "FilePoints", "arrange_range", "bound_range", "survey_range", "unite_boxes"]

_AT_ONCE = 1 << 16  # points: what is made of them stays in the cache
_NOWHERE = np.zeros((0, 3))

FilePoints = tuple[Any, ...]
"""``("there", records, start, stop)`` with the values of a `PointRecords`, in a file that the
worker sees; or ``("sent", path, positions, normals)`` with points that were read from it."""

BoxCounts = list[tuple[int, IntArray]]
"""For each size of boxes the points in a sample of them, and their keys: `sample_box_keys`."""


@declare(result=surveyed_range, limit=range_bytes)
def survey_range(points: FilePoints, before: int, step: int) -> tuple[Any, ...]:
    """Look through the points of a range (a task).

    Parameters
    ----------
    points : tuple
        `FilePoints`.
    before : int
        Usable points in front of the range.
    step : int
        Every so many-th usable point of the file is in the sample.

    Returns
    -------
    usable, non_finite, bad_normals : int
        Points of each kind.
    frame, box : ndarray of float64, shape (2, 3)
        Around the points with finite positions, and around the usable ones.
    sample : ndarray of float64, shape (s, 3)

    Raises
    ------
    InputError
        The file has no normals, or cannot be read any more.
    """
    path, dropped = _path_of(points), Dropped()
    frame = box = _bound(_NOWHERE)
    usable, samples = 0, [_NOWHERE]
    for cloud in _read_pieces(points):
        near = around = _bound(cloud.positions)
        if not are_usable(cloud):
            finite = np.isfinite(cloud.positions).all(axis=1)
            around = _bound(cloud.positions[finite])
            cloud, left_out = select_usable(cloud, path)
            dropped += left_out
            near = _bound(cloud.positions)
        frame, box = unite_boxes([frame, around]), unite_boxes([box, near])
        samples.append(cloud.positions[-(before + usable) % step :: step].copy())
        usable += len(cloud)
    sample = np.concatenate(samples)
    return usable, dropped.non_finite_points, dropped.bad_normals, frame, box, sample


@declare(result=bounded_range, limit=SMALL_BYTES)
def bound_range(
    points: FilePoints, origin: FloatArray, reach: tuple[FloatArray, float]
) -> tuple[int, FloatArray]:
    """Bound the usable points of a range that are within reach (a task).

    Parameters
    ----------
    points : tuple
        `FilePoints`.
    origin : ndarray of float64, shape (3,)
        Of the local frame.
    reach : tuple
        Of a `Reach`.

    Returns
    -------
    count : int
    box : ndarray of float64, shape (2, 3)
    """
    count, box = 0, _bound(_NOWHERE)
    for near in _take_near(points, origin, reach):
        count += len(near)
        box = unite_boxes([box, _bound(near.positions)])
    return count, box


@declare(result=arranged_range, limit=range_bytes)
def arrange_range(
    points: FilePoints,
    origin: FloatArray,
    reach: tuple[FloatArray, float] | None,
    arrangement: tuple[FloatArray, float],
    target: tuple[str, int],
    boxes: tuple[FloatArray, tuple[float, ...], int],
) -> tuple[IntArray, IntArray, BoxCounts]:
    """Write the usable points of a range into a folder, arranged (a task).

    Parameters
    ----------
    points : tuple
        `FilePoints`.
    origin : ndarray of float64, shape (3,)
        Of the local frame.
    reach : tuple or None
        Of a `Reach`; points beyond it are left out.
    arrangement : tuple
        Of an `Arrangement`.
    target : tuple of (str, int)
        The folder, and the number of the part: see `disk_cloud.write_part`.
    boxes : tuple
        The least coordinates of the arranged cloud, the edges of boxes to be counted, and how
        many boxes make one sampled.

    Returns
    -------
    keys, counts : ndarray of int64, shape (b,)
        The blocks of the part, and the points in each.
    counted : BoxCounts

    Raises
    ------
    InputError
        The file cannot be read any more.
    OutputError
        The disk is full, or the folder cannot be written.
    """
    low, edges, one_in = boxes
    blocks = Arrangement(*arrangement)
    pieces: list[PackedPoints] = []
    counted: list[BoxCounts] = [[(0, np.zeros(0, np.int64))] * len(edges)]
    for near in _take_near(points, origin, reach):
        if len(near):
            assert near.normals is not None  # noqa: S101 - usable points have some
            snapped = snap_points(blocks, near.positions)
            pieces.append(pack_snapped(blocks, snapped, near.normals))
            counted.append([sample_box_keys(snapped, low, edge, one_in) for edge in edges])
    keys, counts = write_part(Path(target[0]), target[1], pieces)
    return keys, counts, [_add_counts(of_edge) for of_edge in zip(*counted, strict=True)]


def _add_counts(counted: tuple[tuple[int, IntArray], ...]) -> tuple[int, IntArray]:
    """Return what was counted of several groups of points as one."""
    points, keys = zip(*counted, strict=True)
    return sum(points), unique_keys(np.concatenate(keys))


def _read_pieces(points: FilePoints) -> Iterator[PointCloud]:
    """Yield the points of a range in their order, some at a time."""
    if points[0] == "sent":
        positions, normals = points[2:]
        for start in range(0, len(positions), _AT_ONCE):
            rows = slice(start, start + _AT_ONCE)
            yield PointCloud(positions[rows], None if normals is None else normals[rows])
        return
    _, values, first, stop = points
    records = PointRecords(*values)
    for start in range(first, stop, _AT_ONCE):
        yield records.read(start, min(start + _AT_ONCE, stop))


def _path_of(points: FilePoints) -> str:
    return str(points[1] if points[0] == "sent" else points[1][0])


def _take_near(
    points: FilePoints, origin: FloatArray, reach: tuple[FloatArray, float] | None
) -> Iterator[PointCloud]:
    """Yield the usable points within reach, in their frame, some at a time."""
    path = _path_of(points)
    for cloud in _read_pieces(points):
        usable, _ = select_usable(cloud, path)
        positions = usable.positions - origin if origin.any() else usable.positions
        local = PointCloud(positions, usable.normals)
        if reach is None or not len(local) or Reach(*reach).holds(*bound_points(positions)):
            yield local
        else:
            yield local.take(Reach(*reach).find_near(positions))


def _bound(positions: FloatArray) -> FloatArray:
    """Return a box around points; around none it is one that any other makes larger."""
    if not len(positions):
        return np.array([[np.inf] * 3, [-np.inf] * 3])
    return np.stack(kernels.bound_points(positions))


def unite_boxes(boxes: Sequence[FloatArray]) -> FloatArray:
    """Return the box (2, 3) around some boxes."""
    columns = np.stack(boxes)
    return np.stack([columns[:, 0].min(axis=0), columns[:, 1].max(axis=0)])
