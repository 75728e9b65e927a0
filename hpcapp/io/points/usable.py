"""What a scan holds beside usable points: dropped, counted, and refused where nothing is left."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.points import BoolArray, FloatArray, PointCloud
from hpcapp.geometry.validity import Dropped, select_usable
from hpcapp.io.frame import check_coordinates, choose_origin
from hpccomponent.errors import InputError, OutputError

log = logging.getLogger("hpcapp")

Parts = Callable[[], Iterable[FloatArray]]

FEWEST_POINTS = 10
"""A quadric has ten coefficients."""

_SMALLEST, _LARGEST = 1e-35, 1e35
"""Largest coordinate of a cloud: fields are computed in float32."""

_MIDDLE = "the middle of the points"

_SAMPLE = 100_000  # points that show whether they lie on a line, if they do not

_FLATTEST = 1e-6
"""Second extent over first, below which points count as collinear: ten roundings of float32."""


def drop_unusable(cloud: PointCloud, source: str = "the point cloud") -> tuple[PointCloud, Dropped]:
    """Drop points without a finite position, or without a normal where others have one.

    The others keep order, colours and origin; their normals get unit length. Raise InputError where
    fewer than `FEWEST_POINTS` are left, or all lie in one place, on one line or too far from zero.
    """
    if not len(cloud):
        raise InputError(f"{source} holds no points", "check that the right file was exported")
    check_coordinates(cloud.origin, source, _MIDDLE)
    usable, dropped = select_usable(cloud)
    refuse_too_few(len(usable), dropped, source)
    low, high = bound_points(usable.positions)
    sample = usable.positions[:: -(-len(usable) // _SAMPLE)]  # in most clouds they tell enough
    refuse_degenerate(low, high, len(usable), source)
    refuse_line(lambda: [sample], lambda: [usable.positions], len(usable), source)
    return usable, dropped


def drop_non_finite(cloud: PointCloud, path: Path) -> PointCloud:
    """Drop points with NaN or infinite coordinates, with a warning, for a format that holds none.

    Raise OutputError where no point is left.
    """
    columns = [np.isfinite(column) for column in cloud.positions.T]
    is_finite: BoolArray = np.logical_and.reduce(columns)
    dropped = len(cloud) - int(np.count_nonzero(is_finite))
    if not dropped:
        return cloud
    if dropped == len(cloud):
        raise OutputError(
            f"{path}: all points have NaN or infinite coordinates",
            "check the input with hpcapp info",
        )
    kind = path.suffix.lower()
    log.warning(
        "warning: %s: dropped %d NaN or infinite points: %s holds none", path, dropped, kind
    )
    return cloud.take(is_finite)


def refuse_too_few(points: int, dropped: Dropped, source: str) -> None:
    """Raise InputError for a cloud of fewer than `FEWEST_POINTS` usable points."""
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
    """Refuse a cloud by the box around it.

    Raise InputError where the largest coordinate is above 1e35, or below 1e-35 and not zero; all
    lie beyond `FARTHEST`, far from zero for their extent; or the box has no extent.
    """
    largest = float(np.abs([low, high]).max())
    if largest > _LARGEST or 0 < largest < _SMALLEST:
        raise InputError(
            f"{source}: the largest coordinate is {largest:g}",
            "scale the points: such numbers leave the range of float32",
        )
    check_coordinates(choose_origin(low, high), source, _MIDDLE)
    if (low == high).all():
        raise InputError(
            f"{source}: all {points} points lie in one place",
            "check how the file was exported",
        )


def refuse_line(sample: Parts, every: Parts, points: int, source: str) -> None:
    """Refuse a cloud whose points lie on one line.

    Few positions, which tell enough of most clouds, are asked for first; then every one. Raise
    InputError where the second extent is less than a millionth of the first.
    """
    if _is_line(sample) and _is_line(every):
        raise InputError(
            f"{source}: all {points} points lie on one line",
            "a surface cannot be fitted to a line: check how the file was exported",
        )


def _is_line(parts: Parts) -> bool:
    """Tell whether all points lie on one line; their squares must not leave the range."""
    boxes = [np.stack(bound_points(part)) for part in parts() if len(part)]
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


def take_finite(cloud: PointCloud, source: str) -> PointCloud:
    """Leave out the points that have no place: for what is looked at and not reconstructed.

    Raise InputError where there is no other.
    """
    finite = np.logical_and.reduce(np.isfinite(cloud.positions), axis=1)
    if not finite.any():
        raise InputError(f"{source}: no point has a finite place", "check how it was exported")
    return cloud if finite.all() else cloud.take(finite)
