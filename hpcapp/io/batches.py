"""Parts of a cloud: joined, cut, and of any sizes into parts of one size."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.points import IntArray, PointCloud

T = TypeVar("T", bound=np.generic)


def batch_points(parts: Iterable[PointCloud], rows: int) -> Iterator[PointCloud]:
    """Cut and join parts, at least one, so that all but the last have so many points.

    Parts have the same attributes and may be empty. One empty part comes without points.
    """
    waiting: list[PointCloud] = []
    points = 0
    has_yielded = False
    for part in parts:
        waiting.append(part)
        points += len(part)
        if points < rows:
            continue
        whole, at = join_points(waiting), 0
        while points - at >= rows:
            yield whole.view(slice(at, at + rows))
            at, has_yielded = at + rows, True
        waiting, points = [whole.view(slice(at, points))], points - at
    if points or not has_yielded:
        yield join_points(waiting)


def cut_points(cloud: PointCloud, rows: int) -> Iterator[PointCloud]:
    """Yield copies of so many points, the last of fewer; one empty part of a cloud of none."""
    for start in range(0, max(len(cloud), 1), rows):
        yield cloud.take(np.arange(start, min(start + rows, len(cloud))))


def join_points(parts: Sequence[PointCloud]) -> PointCloud:
    """Join parts with the same columns and origin, one or more; a single one is not copied."""
    parts = [part for part in parts if len(part)] or parts[:1]
    if len(parts) == 1:
        return parts[0]
    return PointCloud(
        np.concatenate([part.positions for part in parts]),
        join_arrays(part.normals for part in parts),
        join_arrays(part.colours for part in parts),
        {
            name: np.concatenate([part.attributes[name] for part in parts])
            for name in parts[0].attributes
        },
        parts[0].origin,
    )


def find_different(values: NDArray[Any]) -> tuple[IntArray, IntArray]:
    """Return the first row of each value, in their order, and which of these each row has.

    Examples
    --------
    >>> [array.tolist() for array in find_different(np.array([7, 3, 7, 5]))]
    [[0, 1, 3], [0, 1, 0, 2]]
    """
    _, first, which = np.unique(values, axis=0, return_index=True, return_inverse=True)
    rows = np.sort(first)
    return rows, np.searchsorted(rows, first)[which.reshape(-1)]


def join_arrays(arrays: Iterable[NDArray[T] | None]) -> NDArray[T] | None:
    """Join those arrays that are there, end to end; None where none is."""
    present = [array for array in arrays if array is not None]
    return np.concatenate(present) if present else None
