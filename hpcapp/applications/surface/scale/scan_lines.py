"""Where points lie along scan lines: much closer along a line than the lines are apart.

::

    counts of cells ── find_gaps ──> GapBoxes ── count_narrow ──> keep_lines ── find_spare ──>
    the boxes in which more points lie than the gap asks for, and those where they lie along lines,
    of whose points one stays

Where points cover a surface, boxes of half the edge are four times as many; along lines they are
twice as many, and where each holds one point as many as before. So the *gap*, which a surface must
bridge, is where the growth falls below 2^1.5 as boxes are halved, and the *step* along a line is
what the density leaves for it. In boxes of half a gap the points of lines lie along them; those of
a dense part of a scan do not.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np

from hpcapp.applications.surface.scale.local_scale import (
    LEAST,
    ScaleCounts,
    double_cells,
    merge_scale_counts,
)
from hpcapp.applications.surface.types.result_patterns import CellCounts, CellKeys
from hpcapp.geometry.lattice import (
    BITS,
    ancestor_keys,
    cells_of,
    find_first,
    find_keys,
    number_keys,
    pack_places,
    unique_keys,
)
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.columns import Column
from hpccomponent.protocol.records import record

_GROWTH = 1.5  # powers of two: half way between a line and a surface
_ACROSS = 2.0**0.5  # gaps: edge of the boxes at that growth, of lines all one gap apart
_BOX = 0.5  # gaps: edge of the boxes of which one point is kept
_ASPECT = 4.0  # gaps by steps: lines less dense than that have fewer than two points in such a box
_COVERED = 3  # halvings of a cell: it speaks where its points cover a surface in such boxes
_WHOLE = 2  # doublings of a finest cell that make a block: no box is larger

_FEWEST = 3  # points that tell whether a box's points lie along a line
# Minors of their covariance by its trace squared (see `measure_spread`). From 0.15 to 0.2 the share
# of narrow points stays below 0.26 on even sheets, above 0.68 along noisy lines.
_NARROW = 0.18
SHARE = 0.35
"""Of the points around, in boxes where they lie along a line: see ``benchmarks/decisions.py``."""
_AROUND = 1024  # points that are asked together


@record("surface.gap_boxes")
@dataclass(frozen=True, slots=True, eq=False)
class GapBoxes:
    """Where points may lie along lines, and of which boxes there one is enough; c cells.

    A box of any size has a corner at `origin` (3,); the finest are of `edge`, in length units of
    the input. The finest cells of the local scale, of sorted `keys` (c,), are halved `depth` times
    for these, which are doubled `doublings` (c,) times there. `gaps` and `steps` (c,) are from line
    to line, and from point to point along them.
    """

    origin: FloatArray
    edge: float
    depth: int
    keys: IntArray
    doublings: IntArray
    gaps: FloatArray
    steps: FloatArray

    def take(self, chosen: BoolArray) -> GapBoxes:
        """Return some of the cells, which a mask of shape (c,) names."""
        return replace(
            self,
            keys=self.keys[chosen],
            doublings=self.doublings[chosen],
            gaps=self.gaps[chosen],
            steps=self.steps[chosen],
        )


def find_gaps(
    origin: FloatArray,
    cell_edge: float,
    depth: int,
    counted: Sequence[ScaleCounts],
) -> GapBoxes:
    """Find the finest cells whose points are dense beside the gaps among them.

    For each of them the smallest cell around it speaks whose points cover a surface; a lone line
    does so in no cell. Arguments are those of `count_scale` and `make_scale`.
    """
    finest, counts = merge_scale_counts(counted)
    keys, row_of = finest, np.arange(len(finest))
    gaps, steps = np.zeros((2, len(finest)))
    for level in range(BITS):
        pending = np.flatnonzero(gaps == 0.0)
        edges = cell_edge * 2.0 ** (level - np.arange(counts.shape[1] - 1))
        if len(edges) > _COVERED + 2:  # from the cell itself to boxes finer than those it covers
            found = _measure_gaps(counts, edges)
            gaps[pending], steps[pending] = (some[row_of[pending]] for some in found)
        if len(keys) <= 1:
            break
        keys, parent = number_keys(ancestor_keys(keys))
        # (c,): the cell of twice the edge in which each finest cell lies.
        counts, row_of = double_cells(counts, parent, len(keys)), parent[row_of]
    lines = np.flatnonzero(gaps > _ASPECT * steps)
    gaps, steps, edge = gaps[lines], steps[lines], cell_edge * 2.0**-depth
    doublings = np.rint(np.log2(_BOX * gaps / edge)).astype(np.int64).clip(0, depth + _WHOLE)
    return GapBoxes(origin, edge, depth, finest[lines], doublings, gaps, steps)


def _measure_gaps(counts: IntArray, edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the gap in each cell, beyond which boxes grow like those of a surface, and the step.

    Both are 0 where they do not do so in boxes of a quarter and of an eighth of the cell. Both
    must: noise makes a line as thick as a surface, but over one halving alone.
    """
    gaps, steps = np.zeros((2, len(counts)))
    # (c, d): of the boxes of each edge, into how many of half the edge they part, as powers of two
    growth = np.diff(np.log2(counts[:, 1:]), axis=1)
    # (c,): cells with enough points, which part as a surface does over both halvings.
    covers = counts[:, 0] >= LEAST
    covers &= (growth[:, _COVERED - 1 : _COVERED + 1] > _GROWTH).all(axis=1)
    is_less = growth[covers, _COVERED + 1 :] <= _GROWTH
    bending = np.flatnonzero(covers)[is_less.any(axis=1)]
    # (t,): the first boxes that part less than a surface's. The edge at which they would just do so
    # lies between theirs and the one before: interpolated in powers of two.
    finer = _COVERED + 1 + is_less.argmax(axis=1)[is_less.any(axis=1)]
    below, above = growth[bending, finer], growth[bending, finer - 1]
    gaps[covers] = edges[-1]  # or less: denser than is counted
    gaps[bending] = edges[finer] * 2.0 ** ((_GROWTH - below) / (above - below)) / _ACROSS
    # n points in b boxes that a surface fills: each has H^2 b / n of it, a gap wide
    held = counts[covers, 0] / counts[covers, 1 + _COVERED]
    steps[covers] = edges[_COVERED] ** 2 / (held * gaps[covers])
    return gaps, steps


@record("surface.line_counts")
@dataclass(frozen=True, slots=True, eq=False)
class LineCounts:
    """Points in c cells, and those along lines."""

    keys: CellKeys
    points: CellCounts
    narrow: Annotated[IntArray, Column("c", low=0)]
    """Those that lie along a line in their box."""


def count_narrow(positions: FloatArray, boxes: GapBoxes) -> LineCounts:
    """Count points (n, 3) of whole blocks in cells of `boxes`, and those on a line in their box."""
    points, narrow = np.zeros((2, len(boxes.keys)), np.int64)
    for rows, cells, box, _ in _sort_boxes(positions, boxes):
        points += np.bincount(cells, minlength=len(points))
        narrow += np.bincount(cells[_are_narrow(positions[rows], box)[box]], minlength=len(points))
    held = np.flatnonzero(points)
    return LineCounts(boxes.keys[held], points[held], narrow[held])


def keep_lines(boxes: GapBoxes, counted: Sequence[LineCounts], share: float = SHARE) -> GapBoxes:
    """Keep the cells where more than a share of the points around lie along lines.

    `counted` is what `count_narrow` has counted in all regions.
    """
    counts = np.zeros((2, len(boxes.keys) + 1), np.int64)  # of cells, and of keys that are none
    for found in counted:
        counts[:, find_keys(boxes.keys, found.keys)] += found.points, found.narrow
    points, narrow = counts[:, :-1]
    keys, row_of = boxes.keys, np.arange(len(points))
    is_line, pending = np.zeros(len(points), np.bool_), np.ones(len(points), np.bool_)
    for _ in range(BITS):
        # A finest cell is judged by the smallest cell around it that has points enough.
        is_judged = pending & ((points >= _AROUND) | (len(keys) <= 1))[row_of]
        is_line[is_judged] = (narrow > share * points)[row_of[is_judged]]
        pending &= ~is_judged
        if not pending.any():
            break
        keys, parent = number_keys(ancestor_keys(keys))
        points, narrow = (np.bincount(parent, row, len(keys)) for row in (points, narrow))
        row_of = parent[row_of]
    return boxes.take(is_line)


def find_spare(positions: FloatArray, boxes: GapBoxes) -> BoolArray:
    """Tell which points (n, 3) of whole blocks can be spared: all along lines but one of each box.

    Returns (n,), False for the point nearest to the mean of its box, and for all in no box.
    """
    is_spare = np.zeros(len(positions), np.bool_)
    for rows, _, box, count in _sort_boxes(positions, boxes):
        arms = _center(positions[rows], box)
        squares = arms[0] * arms[0] + arms[1] * arms[1] + arms[2] * arms[2]
        # (b,): the least squared distance from the mean of each box; of ties the first stays.
        nearest = np.full(count, np.inf)
        np.minimum.at(nearest, box, squares)
        candidates = np.flatnonzero(squares == nearest[box])
        is_spare[rows] = True
        is_spare[rows[candidates[find_first(box[candidates])[1]]]] = False
    return is_spare


def _sort_boxes(
    positions: FloatArray, boxes: GapBoxes
) -> Iterator[tuple[IntArray, IntArray, IntArray, int]]:
    """Yield the points in boxes of each size: rows, their cells and boxes, and how many boxes."""
    places = np.floor(cells_of(positions, boxes.origin, boxes.edge)).astype(np.int64)
    keys = pack_places(places)
    cells = find_keys(boxes.keys, ancestor_keys(keys, boxes.depth))
    doublings = np.append(boxes.doublings, -1)[cells]
    for doubling in unique_keys(doublings[doublings >= 0]).tolist():
        rows = np.flatnonzero(doublings == doubling)
        names, box = number_keys(ancestor_keys(keys[rows], doubling))
        yield rows, cells[rows], box, len(names)


def _center(positions: FloatArray, box: IntArray) -> list[FloatArray]:
    """Return the coordinates of points from the means of their boxes."""
    held = np.bincount(box)
    return [column - (np.bincount(box, column) / held)[box] for column in positions.T]


def measure_spread(positions: FloatArray, box: IntArray) -> tuple[FloatArray, FloatArray]:
    """Tell in what ways the points (n, 3) of boxes are spread; `box` (n,) numbers these from 0 on.

    Returns the sum of the minors of each box's covariance, and its trace squared, (b,) each: of the
    former by the latter 0 is left on a line, 1/4 all over a plane.
    """
    x, y, z = _center(positions, box)
    xx, yy, zz, xy, xz, yz = (
        np.bincount(box, product) for product in (x * x, y * y, z * z, x * y, x * z, y * z)
    )
    minors = xx * yy - xy * xy + xx * zz - xz * xz + yy * zz - yz * yz
    return minors, np.square(xx + yy + zz)


def _are_narrow(positions: FloatArray, box: IntArray) -> BoolArray:
    """Tell in which boxes the points lie along a line."""
    minors, squares = measure_spread(positions, box)
    are_narrow: BoolArray = minors <= _NARROW * squares
    return are_narrow & (np.bincount(box) >= _FEWEST)
