"""The local frame: far from zero, float64 arithmetic on coordinates loses what a scan measured.

Used by every reader of this package; writers put the origin back. Heights of
another unit than x and y are scaled as well.
"""

from __future__ import annotations

from dataclasses import replace
from os import PathLike

import numpy as np

from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.points import FloatArray, PointCloud
from hpccomponent.errors import InputError
from hpccomponent.ranges import FARTHEST

FAR_IN_DIAGONALS = 10.0
"""Coordinates beyond so many diagonals of the bounding box count as georeferenced."""

_FLOAT32_TOLERANCE = 1e-6


def to_local(positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Subtract an origin (3,) from positions (n, 3) that lie far from zero, and return both.

    The origin is the centre of the bounding box of the finite ones, in whole units, where the
    largest coordinate exceeds `FAR_IN_DIAGONALS` diagonals, else zeros: then `positions` itself
    comes back.

    Examples
    --------
    >>> to_local(np.array([[5.4e6, 0.0, 0.0], [5.4e6, 1.0, 0.25]]))[1]
    array([5400000.,       0.,       0.])
    """
    origin = choose_origin(*finite_bounds(positions))
    return (positions - origin if origin.any() else positions), origin


def choose_origin(low: FloatArray, high: FloatArray) -> FloatArray:
    """Return what `to_local` subtracts from coordinates in a box around the finite points."""
    with np.errstate(over="ignore"):  # a diagonal that overflows is infinite: not far from zero
        diagonal = np.linalg.norm(high - low)
    if np.abs([low, high]).max() <= FAR_IN_DIAGONALS * diagonal:
        return np.zeros(3)
    origin: FloatArray = np.rint(low / 2 + high / 2) + 0.0  # + 0.0: no negative zero
    return origin


def needs_double(positions: FloatArray, origin: FloatArray) -> bool:
    """Tell whether float32 would round coordinates by more than a millionth of the extent.

    Positions (n, 3) are relative to the origin, which is added on writing.
    """
    if origin.any():
        return True
    low, high = finite_bounds(positions)
    with np.errstate(over="ignore"):
        diagonal = np.linalg.norm(high - low)
    largest = np.abs([low, high]).max()
    single = np.finfo(np.float32)
    rounding = max(largest * single.epsneg, single.smallest_subnormal) if largest else 0.0
    return bool(largest > single.max or rounding > _FLOAT32_TOLERANCE * diagonal)


def finite_bounds(positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the box around the rows that are finite; zeros without any."""
    if not len(positions):
        return np.zeros(3), np.zeros(3)
    # Column by column: four times as fast as a reduction along axis 0.
    low = np.array([column.min() for column in positions.T])
    high = np.array([column.max() for column in positions.T])
    if np.isfinite(low).all() and np.isfinite(high).all():
        return low, high
    finite = positions[np.isfinite(positions).all(axis=1)]
    return bound_points(finite) if len(finite) else (np.zeros(3), np.zeros(3))


def check_coordinates(numbers: FloatArray, path: str | PathLike[str], what: str) -> None:
    """Refuse what moves all points of a file: an origin, an offset, a scanner's place, a matrix.

    Raise InputError where a number is NaN, or beyond `FARTHEST`: all points would fall on few.
    """
    is_number = np.abs(numbers) <= FARTHEST
    if not is_number.all():
        wrong = float(numbers[~is_number].flat[0])
        raise InputError(
            f"{path}: {what} has {wrong:g}", f"numbers up to {FARTHEST:.0e} move points: correct it"
        )


def scale_heights(cloud: PointCloud, factor: float) -> PointCloud:
    """Multiply z by a factor; normals stay across the surface, of unit length where they have any.

    Examples
    --------
    >>> slope = PointCloud(np.array([[1.0, 0.0, 1.0]]), np.array([[-0.8, 0.0, 0.6]]))
    >>> scale_heights(slope, 0.75).normals.round(3).tolist()
    [[-0.707, 0.0, 0.707]]
    """
    if factor == 1.0:
        return cloud
    scales, normals = np.array([1.0, 1.0, factor]), cloud.normals
    if normals is not None:
        normals = normals / scales
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        normals /= np.where(lengths > 0.0, lengths, 1.0)
    origin = cloud.origin * scales
    return replace(cloud, positions=cloud.positions * scales, normals=normals, origin=origin)
