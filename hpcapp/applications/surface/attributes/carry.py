"""Colours and other numbers of points, carried to places near them.

A place takes the weighted mean of the `NEIGHBOURS` points nearest to it, and of labels that of the
nearest one. The weights fall smoothly to zero at the distance of the next point: which of several
points at one distance is taken, when there is no room for all, changes nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hpcapp.geometry.points import FloatArray, IntArray, PointCloud
from hpccomponent.dataclass import dataclass

NEIGHBOURS = 8
"""So many points share in the value of a place."""

_ROWS_AT_ONCE = 1 << 14  # what is made of them stays in the cache


@dataclass(frozen=True, slots=True, eq=False)
class Carried:
    """What places have taken from the points near them.

    The `points` are the places, with colours and attributes as the points have them; `nearest` (n,)
    is the distance of the nearest point, in length units of the input, `farthest` (n,) that up to
    which points were looked at: farther ones change nothing. It is infinite where all were.
    """

    points: PointCloud
    nearest: FloatArray
    farthest: FloatArray


class AttributeField:
    """The colours and attributes of a cloud, as functions of the place.

    It has at least one point, and may have neither colours nor attributes. Of several clouds that
    hold the same points in the same order, and others farther away, each gives the same bits. Of
    `labels` no mean is taken.
    """

    def __init__(self, points: PointCloud, labels: Collection[str], threads: int = 1) -> None:
        self._points = points
        self._labels = frozenset(labels)
        self._threads = threads
        # Unbalanced trees are made in a third of the time, and searched as fast.
        self._tree = cKDTree(points.positions, compact_nodes=False, balanced_tree=False)

    def evaluate(self, places: FloatArray) -> Carried:
        """Return what places (n, 3), in the frame of the points, take from the points near them."""
        points, count = self._points, len(places)
        colours = None if points.colours is None else np.empty((count, 3), points.colours.dtype)
        attributes = {
            name: np.empty(count, column.dtype) for name, column in points.attributes.items()
        }
        nearest, farthest = np.empty(count), np.empty(count)
        for rows, near, squares in self._find_near(places):
            weights = _weigh(squares)
            if colours is not None and points.colours is not None:
                for axis, column in enumerate(points.colours.T):
                    colours[rows, axis] = _average(column, near, weights)
            for name, column in points.attributes.items():
                is_label = name in self._labels
                attributes[name][rows] = (
                    column[near[:, 0]] if is_label else _average(column, near, weights)
                )
            nearest[rows] = np.sqrt(squares[:, 0])
            farthest[rows] = np.sqrt(squares[:, -1])
        if len(points) <= NEIGHBOURS:
            farthest[:] = np.inf
        carried = PointCloud(places, None, colours, attributes, points.origin)
        return Carried(carried, nearest, farthest)

    def _find_near(self, places: FloatArray) -> Iterator[tuple[slice, IntArray, FloatArray]]:
        """Yield, for some places at a time, the points nearest to each, and squared distances."""
        most = min(NEIGHBOURS + 1, len(self._points))
        for start in range(0, len(places), _ROWS_AT_ONCE):
            rows = slice(start, min(start + _ROWS_AT_ONCE, len(places)))
            _, near = self._tree.query(places[rows], np.arange(1, most + 1), workers=self._threads)
            # Column by column, so that every machine rounds alike.
            away = [
                self._points.positions[:, axis][near] - places[rows, axis, None]
                for axis in range(3)
            ]
            squares = away[0] * away[0] + away[1] * away[1] + away[2] * away[2]
            order = np.lexsort((near, squares), axis=1)
            near = np.take_along_axis(near, order, axis=1)
            yield rows, near, np.take_along_axis(squares, order, axis=1)


def _weigh(squares: FloatArray) -> FloatArray:
    """Return weights by squared distances, which rise along each row; of the last it is zero.

    Where all points are equally far, all weigh the same.
    """
    last = squares[:, -1:]
    weights = 1.0 - np.divide(squares, last, out=np.ones_like(squares), where=last > 0.0)
    weights *= weights
    weights[weights[:, 0] == 0.0] = 1.0
    return weights


def _average(column: NDArray[Any], near: IntArray, weights: FloatArray) -> NDArray[Any]:
    """Return the means of some numbers of each row; NaN and infinity do not count."""
    # Neighbour by neighbour: the sums must not depend on how rows are reduced.
    total, weight = np.zeros(len(near)), np.zeros(len(near))
    for neighbour, rows in enumerate(near.T):
        values = column[rows].astype(np.float64)
        known = np.isfinite(values)
        if not known.all():
            values[~known] = 0.0
        total += weights[:, neighbour] * values
        weight += weights[:, neighbour] * known
    mean = np.divide(total, weight, out=np.full(len(near), np.nan), where=weight > 0.0)
    if column.dtype.kind in "iu":
        np.rint(mean, out=mean)
    found: NDArray[Any] = mean.astype(column.dtype)
    return found
