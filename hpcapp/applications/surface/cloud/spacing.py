"""How far apart the points of a cloud lie, by counting occupied boxes."""

from __future__ import annotations

from collections.abc import Callable
from math import sqrt

import numpy as np

from hpcapp import kernels
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.lattice import (
    are_sampled,
    cells_of,
    lay_lattice,
    pack_places,
    shuffle_keys,
    unique_keys,
)
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.kernels.parallel import run_batches
from hpccomponent.cutting import cut_equal
from hpccomponent.errors import InputError

Count = Callable[[float, int, bool], tuple[int, int]]
"""Given the edge of boxes, how many of them make one sampled, and whether points at one place count
as one, returns the points in the sample and the boxes that hold some."""

_ROWS_AT_ONCE = 1 << 16
_FEW, _MANY = 3.0, 20.0
_SAMPLED_POINTS = 200_000
_ROUNDS = 40
_STALLED = 0.8  # half the edge should leave a quarter of the points


def estimate_spacing(positions: FloatArray) -> float:
    """Estimate the typical distance between neighbouring points (n, 3) of a surface.

    It is H / sqrt(points per occupied box of edge H); InputError where all points are the same.

    Notes
    -----
    The box edge H is the first, by halving or doubling from a guess, with 3 to 20 points per
    occupied box. Large clouds are sampled by whole boxes, which leaves the counts unbiased.
    Where smaller boxes do not hold fewer points, repeated points are counted once.
    """
    low, high = bound_points(positions)

    def count(edge: float, one_in: int, is_distinct: bool) -> tuple[int, int]:
        counted = np.unique(positions, axis=0) if is_distinct else positions
        return kernels.count_boxes(counted, lay_lattice(low, edge), edge, one_in)

    return search_spacing(count, len(positions), low, high)


def search_spacing(count: Count, points: int, low: FloatArray, high: FloatArray) -> float:
    """Return what `estimate_spacing` does, to the last bit, of a cloud that somebody else counts.

    `count` is called for each size of boxes, three times or so; `low` and `high` are the corners of
    the box around all points. InputError where all points are the same.
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


def sample_box_keys(
    positions: FloatArray, low: FloatArray, edge: float, one_in: int
) -> tuple[int, IntArray]:
    """Count points in a sample of boxes, about one of `one_in`, and name the boxes.

    `low` is a corner of a box. The keys (b,) of boxes that hold points are sorted. Counts of
    several groups of points add up, and their boxes unite, to those of all. See `count_boxes`.
    """
    if not len(positions):
        return 0, np.zeros(0, np.int64)
    chosen = positions[kernels.sample_boxes(positions, low, edge, one_in)]
    places = np.floor(cells_of(chosen, low, edge)).astype(np.int64)
    return len(chosen), unique_keys(pack_places(places))


def sample_positions(
    positions: FloatArray, low: FloatArray, edge: float, one_in: int
) -> FloatArray:
    """Return the points in a sample of boxes, about one of `one_in`, in their order.

    Unlike those of `kernels.sample_boxes` the boxes make no pattern, whichever the points make.
    """

    def mark(rows: slice) -> BoolArray:
        places = np.floor(cells_of(positions[rows], low, edge)).astype(np.int64)
        return are_sampled(shuffle_keys(pack_places(places)), one_in)

    blocks = cut_equal(len(positions), max(1, len(positions) // _ROWS_AT_ONCE))
    chosen: FloatArray = positions[np.concatenate(run_batches(mark, blocks, 1))]
    return chosen


def _search_edge(
    count: Callable[[float, int], tuple[int, int]], points: int, longest: float
) -> tuple[float, float, bool]:
    """Search the edge of boxes that hold a few points each; `longest` is the side of the cloud.

    `count` is given an edge and how many boxes make one sampled, and returns points and boxes.
    Returned are the edge, the points in an occupied box, and whether smaller boxes did not hold
    fewer.
    """
    if longest <= 0.0:
        raise InputError(f"all {points} points lie at one place", "scan something with an extent")
    # A guess: boxes of nine points, if these covered a square of the longest side.
    edge, one_in = longest * min(0.5, 3.0 / sqrt(points)), points // _SAMPLED_POINTS + 1

    def measure(edge: float) -> float:
        held, boxes = count(edge, one_in)
        return held / max(1, boxes)

    occupancy = measure(edge)
    for _ in range(_ROUNDS):
        if _FEW <= occupancy <= _MANY or (occupancy < _FEW and edge >= longest):
            break
        edge *= 2.0 if occupancy < _FEW else 0.5
        before, occupancy = occupancy, measure(edge)
        # Boxes of half the edge hold about as many: points lie at the same places.
        if before > _MANY and occupancy > _STALLED * before:
            return edge, occupancy, True
    return edge, occupancy, False
