"""What a scan holds beside usable points: dropped, counted, and refused where nothing is left."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hpccomponent.errors import InputError
from hpccomponent.surface.points import FloatArray, PointCloud, bounding_box

__all__ = [
    "FEWEST_POINTS",
    "Dropped",
    "drop_unusable",
    "refuse_degenerate",
    "refuse_line",
    "refuse_too_few",
    "select_usable",
]

Parts = Callable[[], Iterable[FloatArray]]

FEWEST_POINTS = 10
"""A quadric has ten coefficients."""

_SMALLEST, _LARGEST = 1e-60, 1e60
"""Largest coordinate of a cloud: its fourth powers must stay within the range of float64."""

_CHUNK = 1 << 14  # normals at once: what is made of them stays in the cache
_SAMPLE = 100_000  # points that show whether they lie on a line, if they do not

_FLATTEST = 1e-6
"""Second extent over first, below which points count as collinear: ten roundings of float32."""


@dataclass(frozen=True, slots=True)
class Dropped:
    """How many points were dropped, each counted once.

    Parameters
    ----------
    non_finite_points : int
        Points with NaN or infinity in their position.
    bad_normals : int
        Other points whose normal is zero, NaN or infinite.
    """

    non_finite_points: int = 0
    bad_normals: int = 0

    @property
    def total(self) -> int:
        """All of them."""
        return self.non_finite_points + self.bad_normals


def drop_unusable(cloud: PointCloud, source: str = "the point cloud") -> tuple[PointCloud, Dropped]:
    """Drop points without a finite position and a normal; give normals unit length.

    Parameters
    ----------
    cloud : PointCloud
        As it was read.
    source : str, optional
        The file it came from, for messages.

    Returns
    -------
    usable : PointCloud
        In the order of `cloud`; its colours and origin are kept.
    dropped : Dropped
        What is missing in it.

    Raises
    ------
    InputError
        There are no normals, fewer than `FEWEST_POINTS` points are left, or all of them lie in
        one place or on one line.
    """
    if not len(cloud):
        raise InputError(f"{source} holds no points", "check that the right file was exported")
    usable, dropped = select_usable(cloud, source)
    refuse_too_few(len(usable), dropped, source)
    low, high = bounding_box(usable.positions)
    some = usable.positions[:: -(-len(usable) // _SAMPLE)]  # in most clouds they tell enough
    refuse_degenerate(low, high, len(usable), source)
    refuse_line(lambda: [some], lambda: [usable.positions], len(usable), source)
    return usable, dropped


def select_usable(cloud: PointCloud, source: str) -> tuple[PointCloud, Dropped]:
    """Drop points as `drop_unusable` does, from a part of a cloud; whatever is left will do.

    Parameters
    ----------
    cloud : PointCloud
        As it was read.
    source : str
        The file it came from, for messages.

    Returns
    -------
    usable : PointCloud
        Its normals have unit length.
    dropped : Dropped

    Raises
    ------
    InputError
        There are no normals.
    """
    if cloud.normals is None:
        raise InputError(
            f"{source} has no normals (nx, ny, nz)",
            "estimate them first, e.g. in CloudCompare or MeshLab",
        )
    # Column by column here and below: reductions along rows of three are several times slower.
    finite = np.logical_and.reduce([np.isfinite(column) for column in cloud.positions.T])
    units, directed = _normalized(cloud.normals)
    dropped = Dropped(int((~finite).sum()), int((finite & ~directed).sum()))
    usable = PointCloud(cloud.positions, units, cloud.colors, cloud.origin)
    return usable.take(finite & directed) if dropped.total else usable, dropped


def _normalized(normals: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return vectors of unit length, and which of them had a length at all."""
    units, directed = np.empty_like(normals), np.empty(len(normals), np.bool_)
    for start in range(0, len(normals), _CHUNK):
        rows = slice(start, start + _CHUNK)
        units[rows], directed[rows] = _normalize_rows(normals[rows])
    return units, directed


def _normalize_rows(normals: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    largest = np.maximum.reduce([np.abs(column) for column in normals.T])[:, None]
    directed = np.isfinite(largest) & (largest > 0)
    # By the largest component first: squares of very long or short vectors leave the range.
    where = True if directed.all() else directed  # a mask takes longer than what it masks
    scaled = np.divide(normals, largest, out=np.zeros_like(normals), where=where)
    lengths = np.sqrt(np.einsum("ij,ij->i", scaled, scaled))[:, None]
    units = np.divide(scaled, lengths, out=scaled, where=where)
    return units, directed[:, 0]


def refuse_too_few(points: int, dropped: Dropped, source: str) -> None:
    """Refuse a cloud of fewer than `FEWEST_POINTS` usable points."""
    if points >= FEWEST_POINTS:
        return
    without = (
        f" after dropping {dropped.non_finite_points} with NaN or infinite coordinates and "
        f"{dropped.bad_normals} with a zero or NaN normal"
    )
    raise InputError(
        f"{source} has {points or 'no'} usable points{without if dropped.total else ''}",
        f"a surface needs at least {FEWEST_POINTS}: check how the file was exported",
    )


def refuse_degenerate(low: FloatArray, high: FloatArray, points: int, source: str) -> None:
    """Refuse a cloud by the box around it: coordinates out of range, or one place."""
    largest = float(np.abs([low, high]).max())
    if largest > _LARGEST or 0 < largest < _SMALLEST:
        raise InputError(
            f"{source}: the largest coordinate is {largest:g}",
            "scale the points: products of such numbers leave the range of float64",
        )
    if (low == high).all():
        raise InputError(
            f"{source}: all {points} points lie in one place",
            "check how the file was exported",
        )


def refuse_line(some: Parts, every: Parts, points: int, source: str) -> None:
    """Refuse a cloud whose points lie on one line.

    Parameters
    ----------
    some, every : callable
        Return iterables of positions: those of a few points, which tell enough of most clouds,
        and all of them, which are asked for where they do not.
    points : int
    source : str
        For messages.
    """
    if _is_line(some) and _is_line(every):
        raise InputError(
            f"{source}: all {points} points lie on one line",
            "a surface cannot be fitted to a line: check how the file was exported",
        )


def _is_line(parts: Parts) -> bool:
    """Tell whether all points lie on one line; their squares must not leave the range."""
    boxes = [np.stack(bounding_box(part)) for part in parts() if len(part)]
    low, high = np.min(boxes, axis=0)[0], np.max(boxes, axis=0)[1]
    scale = float(np.max(high / 2 - low / 2)) or 1.0
    count, total, squares = 0, np.zeros(3), np.zeros((3, 3))
    for part in parts():
        arms = (part - low) / scale
        count += len(arms)
        total += arms.sum(axis=0)
    for part in parts():
        centred = (part - low) / scale - total / count
        squares += np.einsum("ij,ik->jk", centred, centred)
    least, most = np.linalg.eigvalsh(squares)[1:]
    return bool(least <= _FLATTEST**2 * most)
