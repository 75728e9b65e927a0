"""What of a cloud can be used: points with a finite position, near enough, and a normal if any."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.points import BoolArray, FloatArray, PointCloud
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.records import record

_TINY = 1e-200  # square of a length: far from where squares are lost
_CHUNK = 1 << 14  # normals at once: what is made of them stays in the cache


def are_finite(rows: NDArray[Any]) -> BoolArray:
    """Tell which rows of numbers, of shape (n, k), hold neither NaN nor infinity."""
    # Column by column: numpy is slow to reduce narrow rows.
    finite: BoolArray = np.logical_and.reduce([np.isfinite(column) for column in rows.T])
    return finite


@dataclass(frozen=True, slots=True)
class Dropped:
    """How many points were dropped, each counted once.

    Non-finite points have NaN or infinity in their position; others may have a bad normal: zero,
    NaN or infinite.
    """

    non_finite_points: int = 0
    bad_normals: int = 0

    def __add__(self, other: Dropped) -> Dropped:
        return Dropped(
            self.non_finite_points + other.non_finite_points, self.bad_normals + other.bad_normals
        )

    @property
    def total(self) -> int:
        """All of them."""
        return self.non_finite_points + self.bad_normals


@record("surface.reach")
@dataclass(frozen=True, slots=True, eq=False)
class Reach:
    """How far from the middle (3,) of a cloud points may lie.

    The distance is along each axis; infinite where the core has no extent.
    """

    middle: FloatArray
    distance: float

    def holds(self, low: FloatArray, high: FloatArray) -> bool:
        """Tell whether all of the box between two corners, (3,), lies within."""
        return bool((np.abs(np.stack([low, high]) - self.middle) <= self.distance).all())

    def find_near(self, positions: FloatArray) -> BoolArray:
        """Tell which of the points (n, 3) lie within, (n,)."""
        away: FloatArray = np.abs(positions - self.middle)
        near: BoolArray = np.all(away <= self.distance, axis=1)
        return near


def select_usable(cloud: PointCloud) -> tuple[PointCloud, Dropped]:
    """Drop points without a finite position, or without a normal where others have one.

    The others, perhaps none, keep order, colours and origin; their normals get unit length.
    """
    # Column by column here and below: reductions along rows of three are several times slower.
    finite = np.logical_and.reduce([np.isfinite(column) for column in cloud.positions.T])
    if cloud.normals is None:
        dropped = Dropped(int((~finite).sum()), 0)
        return cloud.take(finite) if dropped.total else cloud, dropped
    units, directed = _normalized(cloud.normals)
    dropped = Dropped(int((~finite).sum()), int((finite & ~directed).sum()))
    usable = replace(cloud, normals=units)
    return usable.take(finite & directed) if dropped.total else usable, dropped


def _normalized(normals: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return vectors of unit length, and which of them had a length at all."""
    units, directed = np.empty_like(normals), np.empty(len(normals), np.bool_)
    for start in range(0, len(normals), _CHUNK):
        rows = slice(start, start + _CHUNK)
        units[rows], directed[rows] = _normalize_rows(normals[rows])
    return units, directed


def _normalize_rows(normals: FloatArray) -> tuple[FloatArray, BoolArray]:
    columns = [np.ascontiguousarray(column) for column in normals.T]
    largest = np.maximum.reduce([np.abs(column) for column in columns])
    directed = np.isfinite(largest) & (largest > 0)
    # By the largest component first: squares of very long or short vectors leave the range.
    if not directed.all():
        largest = np.where(directed, largest, 1.0)
        columns = [np.where(directed, column, 0.0) for column in columns]
    x, y, z = (column / largest for column in columns)
    lengths = np.sqrt(x * x + y * y + z * z)
    lengths[~directed] = 1.0
    return np.stack([x / lengths, y / lengths, z / lengths], axis=1), directed


def are_usable(cloud: PointCloud) -> bool:
    """Tell whether all points are surely usable; where it does not, `select_usable` finds out."""
    if not np.isfinite(cloud.positions.sum()):
        return False
    if cloud.normals is None:
        return True
    squares = np.einsum("ij,ij->i", cloud.normals, cloud.normals)
    return bool(squares.min(initial=1.0) > _TINY and squares.max(initial=1.0) < 1.0 / _TINY)
