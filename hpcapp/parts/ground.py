"""The bare ground: by the file's class 2, or by a cloth that is draped over the lowest points.

Both go through the points twice, and keep none: once to find which way it is and what is lowest in
each square, once to choose.
"""

from __future__ import annotations

import logging
from collections.abc import Hashable, Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from hpcapp.geometry.axes import rotate
from hpcapp.geometry.points import BoolArray, FloatArray, PointCloud
from hpcapp.io.batches import batch_points
from hpcapp.io.crs import METRES
from hpcapp.io.points.point_source import CLASSES, NOT_GROUND, PointSource
from hpcapp.parts.cloth import STEP, Cloth, drape
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

log = logging.getLogger("hpcapp")

GROUND = 2
"""The class of LAS."""

_HIGHEST = 0.5
"""Metres above or below the cloth: the authors' threshold."""

_NEIGHBOURS, _COMPANY, _SLOPE = 8, 3, 0.5
"""Of the nearest of the lowest points so many are no farther above or below than `_HIGHEST` and
that rise: else it is a wrong return, and one below the ground would hold up all of the cloth. Of
1 % of wrong returns (``benchmarks/ground.py``) hardly one has company, of the ground all have."""

_ROWS_AT_ONCE = 1 << 18


@dataclass(frozen=True, slots=True, eq=False)
class _Ground:
    """How the ground is told, once the points were gone through: by a cloth, or by classes.

    The rows of its axes (3, 3) make coordinates metres to the east, to the north and up.
    """

    cloth: Cloth | None
    axes: FloatArray

    @property
    def way(self) -> str:
        """How, for people."""
        return "by class 2 of the file" if self.cloth is None else "by cloth simulation"

    def find(self, part: PointCloud) -> BoolArray:
        """Tell which points are the ground."""
        if self.cloth is None:
            by_class: BoolArray = np.equal(part.attributes[CLASSES], GROUND)
            return by_class
        is_ground: BoolArray = np.isfinite(part.positions.sum(axis=1))
        places = rotate(part.positions[is_ground], self.axes)
        heights = self.cloth.evaluate(places[:, :2])
        is_ground[is_ground] = np.abs(places[:, 2] - heights) <= _HIGHEST
        return is_ground


def take_ground(source: PointSource, asked: Hashable = None) -> PointSource:
    """Return the points of a source that are the bare ground.

    How they are told, and how many others are left out, is logged once; another pass over the same
    part of a file, as asked, need not look again. Raise InputError where coordinates are angles;
    with its parts, where there is no ground, or the scan is too large for a cloth (`drape`), and
    MissingLibraryError where the library is missing.
    """
    if source.unit == "degree":
        raise InputError(
            f"{source.path}: the ground is found in lengths, and its coordinates are degrees",
            "project it to a map first",
        )
    known: list[_Ground] = []
    if source.path.is_file():
        status = source.path.stat()
        known = _recall(source.path.resolve(), status.st_size, status.st_mtime_ns, asked)

    def scan(rows: int) -> Iterator[PointCloud]:
        return batch_points(_choose(source, known, max(rows, _ROWS_AT_ONCE)), rows)

    return replace(source, scan=scan, records=None, octree=None)


@lru_cache(maxsize=4)
def _recall(*name: Hashable) -> list[_Ground]:
    """Return what is known of the ground of a part of a file: one, or none yet."""
    del name
    return []


def _choose(source: PointSource, known: list[_Ground], rows: int) -> Iterator[PointCloud]:
    is_first = not known
    if is_first:
        known.append(_survey(source, rows))
    ground, kept, left_out = known[0], 0, 0
    for part in source.scan(rows):
        is_ground = ground.find(part)
        kept, left_out = kept + int(is_ground.sum()), left_out + int((~is_ground).sum())
        yield part.take(is_ground)
    source.findings.drop(NOT_GROUND, left_out)
    if not kept:
        raise InputError(f"{source.path}: no ground in it", "leave --ground out")
    if is_first:
        log.info("ground: %s; %d of %d points left out", ground.way, left_out, kept + left_out)


def _survey(source: PointSource, rows: int) -> _Ground:
    """Find out whether classes tell the ground; if they do not, drape a cloth."""
    metres = METRES.get(source.unit or "m", 1.0)
    scales = np.diag([metres, metres, metres * source.frame.height_scale])
    axes = scales if source.upright is None else metres * source.upright
    lowest = np.empty((0, 3))
    for part in source.scan(rows):
        classes = part.attributes.get(CLASSES)
        if classes is not None and (classes == GROUND).any():
            return _Ground(None, axes)
        finite = part.positions[np.isfinite(part.positions).all(axis=1)]
        lowest = _find_lowest(np.concatenate([lowest, rotate(finite, axes)]))
    if not len(lowest):
        raise InputError(f"{source.path}: no ground in it: no points", "check the file")
    return _Ground(drape(_drop_lone(lowest), str(source.path)), axes)


def _find_lowest(points: FloatArray) -> FloatArray:
    """Return the lowest of each square of the cloth, of finite points of shape (n, 3)."""
    x, y = np.floor(points[:, :2] / STEP).astype(np.int64).T
    order = np.lexsort((points[:, 2], y, x))
    x, y = x[order], y[order]
    is_first = np.ones(len(order), np.bool_)
    is_first[1:] = (x[1:] != x[:-1]) | (y[1:] != y[:-1])
    lowest: FloatArray = points[order[is_first]]
    return lowest


def _drop_lone(points: FloatArray) -> FloatArray:
    """Leave out points without company, of the lowest of each square."""
    if len(points) <= _NEIGHBOURS:
        return points
    distances, rows = cKDTree(points[:, :2]).query(points[:, :2], k=_NEIGHBOURS + 1, workers=-1)
    heights = np.abs(points[rows[:, 1:], 2] - points[:, 2:])
    company = (heights <= _HIGHEST + _SLOPE * distances[:, 1:]).sum(axis=1)
    together: FloatArray = points[company >= _COMPANY]
    return together if len(together) else points
