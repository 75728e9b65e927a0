"""The spacing of a cloud's points, from place to place: a small field over dyadic cells.

::

    region ── count_scale ──> counts of its finest cells ──┐
    region ── count_scale ──> counts of its finest cells ──┴─ merge ── make_scale ──> LocalScale

The finest cells are a quarter of a block of the arrangement, so each lies in one region: what is
counted of regions is what is counted of the whole. A cell of 64 points or more tells a spacing, by
the formula that tells the whole cloud's (see `spacing`); the points of poorer cells are counted in
the next larger cell, and so on. They take its spacing, or their own where that is twice as large:
where a dense scan ends, what is beside it keeps its spacing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.types.result_patterns import CellCounts, CellKeys
from hpcapp.geometry.lattice import (
    BITS,
    NEIGHBOURS,
    ancestor_keys,
    cells_of,
    number_keys,
    pack_places,
    step_keys,
    unique_keys,
)
from hpcapp.geometry.points import FloatArray, IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.columns import Column
from hpccomponent.protocol.records import record

HALVINGS = 2
"""So often a block is halved for the finest cells."""

LEAST = 64
"""Points that tell a spacing."""

_BEST = 5.0  # points in a box, of the 3 to 20 of the whole cloud's
_NARROW = 2.0  # likewise, where the points of a line must not pass for those of a sparse surface
_APART = 2.0  # times as far as all points in a cell: those that no smaller cell speaks for
_FINEST = 0.25  # spacings of the whole cloud: edge of the finest boxes, at most
_MOST = 16.0  # spacings of the whole cloud: beyond that points are strays


@record("surface.scale_counts")
@dataclass(frozen=True, slots=True, eq=False)
class ScaleCounts:
    """What is counted of some points; c finest cells, d halvings."""

    keys: CellKeys
    """Of the occupied cells."""
    points: CellCounts
    """In each."""
    boxes: Annotated[IntArray, Column("c", "d+1", low=1)]
    """How many boxes of the cell's edge, halved so often, hold points."""


@record("surface.local_scale")
@dataclass(frozen=True, slots=True, eq=False)
class LocalScale:
    """The spacing of a cloud's points, from place to place; c cells.

    The whole cloud has the `spacing`, in length units of the input, as all spacings here. A cell of
    any size has a corner at `origin` (3,); the finest are of `edge`, which is doubled `levels` (c,)
    times, rising. Sorted within each level are the keys, the points (c,) that each cell speaks for,
    those in no smaller one, and the spacings (c,).
    """

    spacing: float
    origin: FloatArray
    edge: float
    levels: IntArray
    keys: IntArray
    points: IntArray
    spacings: FloatArray

    @classmethod
    def uniform(cls, spacing: float) -> LocalScale:
        """Return the scale of points of one spacing."""
        none = np.empty(0, np.int64)
        return cls(spacing, np.zeros(3), spacing, none, none, none, np.empty(0))

    @property
    def range(self) -> tuple[float, float]:
        """The least and the largest spacing."""
        if not len(self.spacings):
            return self.spacing, self.spacing
        return float(self.spacings.min()), float(self.spacings.max())

    def quantile(self, share: float) -> float:
        """Return the spacing that so large a share of the points have, or less."""
        if not len(self.spacings):
            return self.spacing
        order = np.argsort(self.spacings, kind="stable")
        summed = np.cumsum(self.points[order])
        return float(self.spacings[order][np.searchsorted(summed, share * summed[-1])])

    def at(self, places: FloatArray) -> FloatArray:
        """Return the spacing of the points around places (n, 3), which may be anywhere, shape (n,).

        It is that of the smallest cell around each, or beside it; else of the whole cloud.
        """
        if not len(self.levels):
            return np.full(len(places), self.spacing)
        # Whole numbers below 2^20: places beyond lie in no cell.
        finest = np.floor(cells_of(places, self.origin, self.edge)).clip(-(2.0**19), 2.0**19)
        keys = pack_places(finest.astype(np.int64))
        # (r,): neighbours often follow each other: each run of places in one cell is asked once.
        runs = np.flatnonzero(np.diff(keys, prepend=-1))
        spacings = np.zeros(len(runs))
        for steps in (np.zeros((1, 3), np.int64), NEIGHBOURS):  # their own cells first
            for level in unique_keys(self.levels):
                pending = np.flatnonzero(spacings == 0.0)
                if not len(pending):
                    break
                run = slice(*np.searchsorted(self.levels, (level, level + 1)).tolist())
                known, told = self.keys[run], np.append(self.spacings[run], 0.0)
                wanted = ancestor_keys(keys[runs[pending]], int(level))
                for step in steps:
                    found = told[kernels.find_keys(known, step_keys(wanted, step))]
                    spacings[pending] = np.maximum(spacings[pending], found)
        spacings[spacings == 0.0] = self.spacing
        return np.repeat(spacings, np.diff(runs, append=len(keys)))


def count_depth(cell_edge: float, spacing: float) -> int:
    """Return how often finest cells are halved for the smallest boxes that are counted.

    These are a quarter of the whole cloud's spacing: where points are denser they hold more.
    """
    return max(0, int(np.ceil(np.log2(cell_edge / (_FINEST * spacing)))))


def count_scale(
    positions: FloatArray, origin: FloatArray, cell_edge: float, depth: int
) -> ScaleCounts:
    """Count points (n, 3), and the boxes that hold some, in each of the finest cells.

    Cells, one of which has its corner at `origin`, are halved `depth` times.
    """
    if not len(positions):
        none = np.empty(0, np.int64)
        return ScaleCounts(none, none, np.empty((0, depth + 1), np.int64))
    return ScaleCounts(*kernels.count_halved(positions, origin, cell_edge, depth))


def make_scale(
    spacing: float, origin: FloatArray, cell_edge: float, counted: Sequence[ScaleCounts]
) -> LocalScale:
    """Put together what was counted of all regions, and tell the spacing of each cell.

    `spacing` is the whole cloud's; `counted` is in any order, and no two have a cell in common.

    Boxes of a surface hold points in proportion to their faces: with n points in b boxes of edge H
    the spacing is H / sqrt(n / b). Of all H that with some five points in a box is taken.
    """
    keys, every = merge_scale_counts(counted)
    # Of each cell its points and boxes: all, and those that no smaller cell speaks for.
    rest, levels, cells, spoken, spacings = every, [], [], [], []
    for level in range(BITS):
        edges = cell_edge * 2.0 ** (level - np.arange(every.shape[1] - 1))
        tells = rest[:, 0] >= LEAST
        found = _tell_spacings(every[tells], edges)
        # Points that no smaller cell speaks for have their own spacing if it is much larger.
        is_apart = _tell_spacings(rest[tells], edges, _NARROW) > _APART * found
        found[is_apart] = _tell_spacings(rest[tells][is_apart], edges)
        levels.append(np.full(len(found), level))
        cells.append(keys[tells])
        spoken.append(rest[tells, 0])
        spacings.append(found)
        if len(keys) <= 1:
            break
        keys, parent = number_keys(ancestor_keys(keys))
        # What a cell has spoken for does not count in larger ones.
        rest = np.where(tells[:, None], 0, rest)
        every, rest = (double_cells(counts, parent, len(keys)) for counts in (every, rest))
    return LocalScale(
        spacing,
        origin,
        cell_edge,
        np.concatenate(levels),
        np.concatenate(cells),
        np.concatenate(spoken),
        np.concatenate(spacings).clip(spacing / _MOST, spacing * _MOST),
    )


def merge_scale_counts(counted: Sequence[ScaleCounts]) -> tuple[IntArray, IntArray]:
    """Put together what was counted of all regions; d halvings.

    Returns keys (c,) of the occupied finest cells, sorted, and counts (c, d + 2): the points of
    each, and its boxes of once, half, a quarter of its edge and so on.
    """
    keys = np.concatenate([some.keys for some in counted])
    order = np.argsort(keys, kind="stable")
    points = np.concatenate([some.points for some in counted])[order]
    boxes = np.concatenate([some.boxes for some in counted])[order]
    return keys[order], np.column_stack([points, boxes])


def double_cells(counts: IntArray, parent: IntArray, parents: int) -> IntArray:
    """Sum the counts of cells to those of their parents, which are boxes themselves."""
    points, *boxes = (np.bincount(parent, column, parents).astype(np.int64) for column in counts.T)
    return np.column_stack([points, np.minimum(points, 1), *boxes])


def _tell_spacings(counts: IntArray, edges: FloatArray, wanted: float = _BEST) -> FloatArray:
    """Return the spacing in each cell, by boxes of these edges that hold about so many points."""
    held = counts[:, :1] / counts[:, 1:]  # (c, d): points in an occupied box
    best = np.abs(np.log(held / wanted)).argmin(axis=1)
    spacings: FloatArray = edges[best] / np.sqrt(held[np.arange(len(best)), best])
    return spacings
