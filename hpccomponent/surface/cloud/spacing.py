"""How far apart the points of a cloud lie, by counting occupied boxes."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from hpccomponent.errors import InputError
from hpccomponent.surface.types.lattice import cells_of, pack_places, unique_keys
from hpccomponent.surface.types.points import FloatArray, IntArray, bounding_box

__all__ = [
    "Count",
    "bound_points",
    "count_boxes",
    "estimate_spacing",
    "guess_boxes",
    "is_sampled",
    "sample_box_keys",
    "sample_boxes",
    "search_spacing",
]

Count = Callable[[float, int, bool], tuple[int, int]]
"""Given the edge of boxes, how many of them make one sampled, and whether points at one place count
as one, returns the points in the sample and the boxes that hold some."""

_FEW, _MANY = 3.0, 20.0
_SAMPLED_POINTS = 200_000
_ROUNDS = 40
_STALLED = 0.8  # half the edge should leave a quarter of the points


def estimate_spacing(positions: FloatArray) -> float:
    """Estimate the typical distance between neighbouring points of a surface.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
        In length units of the input.

    Returns
    -------
    float
        H / sqrt(points per occupied box of edge H), in length units of the input.

    Raises
    ------
    InputError
        All points are the same.

    Notes
    -----
    The box edge H is the first, by halving or doubling from a guess, with 3 to 20 points per
    occupied box. Large clouds are sampled by whole boxes, which leaves the counts unbiased.
    Where smaller boxes do not hold fewer points, repeated points are counted once.
    """
    from hpccomponent.surface import kernels  # which knows this module

    low, high = bounding_box(positions)
    edge, occupancy, is_stalled = _search_edge(
        lambda edge, one_in: kernels.count_boxes(positions, low, edge, one_in),
        len(positions),
        float((high - low).max()),
    )
    if is_stalled:
        distinct = np.unique(positions, axis=0)
        if len(distinct) < len(positions):
            return estimate_spacing(distinct)
    return edge / sqrt(occupancy)


def search_spacing(count: Count, points: int, low: FloatArray, high: FloatArray) -> float:
    """Estimate the spacing of a cloud that somebody else counts; see `estimate_spacing`.

    Parameters
    ----------
    count : callable
        See `Count`. It is called for each size of boxes, three times or so.
    points : int
    low, high : ndarray of float64, shape (3,)
        Corners of the box around all points.

    Returns
    -------
    float
        What `estimate_spacing` finds of all of them, to the last bit.

    Raises
    ------
    InputError
        All points are the same.
    """
    longest = float((high - low).max())

    def search(points: int, is_distinct: bool) -> float:
        edge, occupancy, is_stalled = _search_edge(
            lambda edge, one_in: count(edge, one_in, is_distinct), points, longest
        )
        if is_stalled and not is_distinct:
            distinct, _ = count(longest, 1, True)
            if distinct < points:
                return search(distinct, True)
        return edge / sqrt(occupancy)

    return search(points, False)


def guess_boxes(points: int, longest: float) -> tuple[float, int]:
    """Return the edge of boxes to begin with, and how many boxes make one sampled.

    Parameters
    ----------
    points : int
    longest : float
        Longest side of the box around them, in length units of the input.
    """
    return longest * min(0.5, 3.0 / sqrt(points)), points // _SAMPLED_POINTS + 1


def sample_box_keys(
    positions: FloatArray, low: FloatArray, edge: float, one_in: int
) -> tuple[int, IntArray]:
    """Count points in a sample of boxes, and name the boxes: see `count_boxes`.

    Counts of several groups of points add up, and their boxes unite, to those of all.

    Returns
    -------
    points : int
    keys : ndarray of int64, shape (b,)
        Sorted keys of the sampled boxes that hold points.
    """
    from hpccomponent.surface import kernels

    if not len(positions):
        return 0, np.zeros(0, np.int64)
    chosen = positions[kernels.sample_boxes(positions, low, edge, one_in)]
    places = np.floor(cells_of(chosen, low, edge)).astype(np.int64)
    return len(chosen), unique_keys(pack_places(places))


def _search_edge(
    count: Callable[[float, int], tuple[int, int]], points: int, longest: float
) -> tuple[float, float, bool]:
    """Search the edge of boxes that hold a few points each.

    `count` is given an edge and how many boxes make one sampled, and returns points and boxes.

    Returns
    -------
    edge : float
        In length units of the input.
    occupancy : float
        Points in an occupied box.
    is_stalled : bool
        Whether smaller boxes did not hold fewer points.
    """
    if longest <= 0.0:
        raise InputError(f"all {points} points lie at one place", "scan something with an extent")
    edge, one_in = guess_boxes(points, longest)

    def measure(edge: float) -> float:
        held, boxes = count(edge, one_in)
        return held / max(1, boxes)

    occupancy = measure(edge)
    for _ in range(_ROUNDS):
        if _FEW <= occupancy <= _MANY or (occupancy < _FEW and edge >= longest):
            break
        edge *= 2.0 if occupancy < _FEW else 0.5
        before, occupancy = occupancy, measure(edge)
        if before > _MANY and occupancy > _STALLED * before:
            return edge, occupancy, True
    return edge, occupancy, False


def count_boxes(
    positions: FloatArray, low: FloatArray, edge: float, one_in: int
) -> tuple[int, int]:
    """Count points and occupied boxes, over a sample of the boxes, in numpy (see `kernels`).

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
    low : ndarray of float64, shape (3,)
        Corner of a box.
    edge : float
        Of a box, in length units of the input.
    one_in : int
        About one box in so many is in the sample, chosen by a hash.

    Returns
    -------
    points, boxes : int
    """
    keys = pack_places(np.floor(cells_of(positions, low, edge)).astype(np.int64))
    keys = keys[is_sampled(keys, one_in)]
    return len(keys), len(unique_keys(keys))


def bound_points(positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the box around some points, in numpy (see `kernels`).

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
        At least one point; finite.

    Returns
    -------
    low, high : ndarray of float64, shape (3,)
    """
    # Column by column: numpy is slow to reduce along the first axis of narrow arrays.
    columns = positions.T
    low = np.array([column.min() for column in columns])
    return low, np.array([column.max() for column in columns])


def is_sampled(boxes: IntArray, one_in: int) -> NDArray[np.bool_]:
    """Tell which boxes are in the sample of about one in `one_in`, chosen by a hash.

    Parameters
    ----------
    boxes : ndarray of int64, shape (n,)
        Packed places.
    one_in : int

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    if one_in == 1:
        return np.ones(len(boxes), bool)
    mixed = (boxes.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)) >> np.uint64(33)
    chosen: NDArray[np.bool_] = (mixed * np.uint64(one_in)) >> np.uint64(31) == 0
    return chosen


def sample_boxes(positions: FloatArray, low: FloatArray, edge: float, one_in: int) -> IntArray:
    """Return the points in a sample of boxes, in numpy (see `kernels`).

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
    low : ndarray of float64, shape (3,)
    edge : float
    one_in : int
        See `count_boxes`.

    Returns
    -------
    ndarray of int64, shape (m,)
        Their rows, rising.
    """
    places = np.floor(cells_of(positions, low, edge)).astype(np.int64)
    return np.flatnonzero(is_sampled(pack_places(places), one_in))
