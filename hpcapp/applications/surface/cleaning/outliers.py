"""Points that belong to no surface, found by counting points in cells of growing size.

A point's level is the smallest l whose cells, of edge 2 spacings times 2^l, have 10 points in
its neighbourhood of 27. Nearly all points of a scan have the same level, the base.

- Two levels above the base or more: an outlier, unless ten points as sparse lie around it, on
  a plane and it with them (the sparse end of an uneven scan).
- One level above: an outlier where no cell of the base is within 6 spacings and fewer than
  eight points as sparse lie around it.
- Islands: pieces with less than 0.2 % of the points, in cells of 8 spacings, that lie farther
  from larger pieces than twice their own extent.
"""

from __future__ import annotations

import numpy as np

from hpcapp import kernels
from hpcapp.geometry.lattice import BITS, ancestor_keys, number_keys, pack_places, unpack_keys
from hpcapp.geometry.points import BoolArray, IntArray
from hpccomponent.dataclass import dataclass

EDGE = 2.0  # of the finest cells, in spacings
_LEAST = 10  # points that make a neighbourhood
_COMPANIONS = 8  # points one level above the base that vouch for one another
_GAP = 3  # finest cells between a crowded cell and a point that hangs beside it
_FLAT = 0.02  # share of the least variance: a sparse surface is flat, a fog is not
_PAIRS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))

ISLAND_LEVEL = 2  # cells of 8 spacings: scans are connected, uneven ones too
_ISLAND_SHARE = 0.002  # of the points: larger pieces are objects
_ISLANDS_SHARE = 0.05  # of the points: where so many lie on islands, the cells are too small


@dataclass(frozen=True, slots=True, eq=False)
class CellLevel:
    """The occupied cells of one size: keys, points in each, and where the finest cells lie."""

    keys: IntArray
    counts: IntArray
    row_of: IntArray


def coarsen(keys: IntArray, counts: IntArray, wanted: int | None = None) -> list[CellLevel]:
    """Return the finest occupied cells, by sorted keys and points in each (c,), and their parents.

    There are `wanted` levels, the finest first; by default up to one where a single cell holds all.
    """
    levels = [CellLevel(keys, counts, np.arange(len(keys)))]
    # Cells on both sides of 0 never merge: there are none, unless the cloud's box is not its own.
    most = wanted or BITS
    while len(levels) < most and (wanted or len(levels[-1].keys) > 1):
        below = levels[-1]
        merged, rows = number_keys(ancestor_keys(below.keys))
        levels.append(
            CellLevel(merged, _sum_rows(rows, below.counts, len(merged)), rows[below.row_of])
        )
    return levels


def _sum_rows(rows: IntArray, values: IntArray, length: int) -> IntArray:
    """Sum integers by row; exact below 2^53."""
    return np.bincount(rows, values, length).astype(np.int64)


def rank_cells(levels: list[CellLevel], rank: IntArray) -> IntArray:
    """Return the level of each finest cell, (c,): the first with enough points around it.

    `rank` (c,) is what is known: those of the largest are looked at from that level on. It is the
    number of levels where there are not enough on any.
    """
    rank = rank.copy()
    first = int(rank.max(initial=0))
    poor = np.flatnonzero(rank == first)
    for level in levels[first:]:
        # (r,): cells of this level that hold what has no rank yet. Ten points in one are enough by
        # themselves; around the others all 27 are summed.
        rows = _distinct(level.row_of[poor], len(level.keys))
        rows = rows[level.counts[rows] < _LEAST]
        around = kernels.sum_neighbours(level.keys, level.counts[:, None], rows)[:, 0]
        is_poor = np.zeros(len(level.keys), np.bool_)
        is_poor[rows[around < _LEAST]] = True
        poor = poor[is_poor[level.row_of[poor]]]
        if not len(poor):
            break
        # Not enough on this level: what is left looks at the next one.
        rank[poor] += 1
    return rank


def _distinct(rows: IntArray, length: int) -> IntArray:
    """Return the rows that occur, rising."""
    occurs = np.zeros(length, np.bool_)
    occurs[rows] = True
    return np.flatnonzero(occurs)


def find_base(points_by_rank: IntArray) -> int:
    """Return the rank of most points, the median, by the points of each rank (r,)."""
    summed = np.cumsum(points_by_rank)
    return int(np.searchsorted(summed, 0.5 * summed[-1]))


def find_strays(levels: list[CellLevel], rank: IntArray, base: int, numbers: range) -> BoolArray:
    """Find the finest cells whose points are too few and far from others, (c,); see the module.

    Cells of ranks in `numbers` are judged. The finest cells may be some of all: these, and what
    they are judged by, all of rank above the base and of one below the first of these numbers.
    """
    counts = levels[0].counts
    stray = np.zeros(len(rank), np.bool_)
    for number in numbers:
        cells = np.flatnonzero(rank == number)
        if not len(cells):
            continue
        sparse = np.where(rank >= max(base + 1, number - 1), counts, 0)
        if number == base + 1:
            alone = cells[_count_companions(levels[number], sparse, cells) < _COMPANIONS]
            stray[alone] = ~_touch_crowd(levels[base], np.where(rank > base, counts, 0), alone)
        else:
            stray[cells] = ~_lie_on_surface(levels, number, base, sparse, cells)
    return stray


def _count_companions(level: CellLevel, sparse: IntArray, cells: IntArray) -> IntArray:
    """Count the sparse points around some finest cells."""
    rows = _distinct(level.row_of[cells], len(level.keys))
    # (l,): sparse points in each cell of the level; then in the 27 around it.
    own = _sum_rows(level.row_of, sparse, len(level.keys))
    around = np.zeros(len(level.keys), np.int64)
    around[rows] = kernels.sum_neighbours(level.keys, own[:, None], rows)[:, 0]
    return around[level.row_of[cells]]


def _touch_crowd(level: CellLevel, sparse: IntArray, cells: IntArray) -> BoolArray:
    """Tell which finest cells have a cell of the base within the gap that holds crowded ones."""
    crowded = level.counts > _sum_rows(level.row_of, sparse, len(level.keys))
    holds = np.append(crowded, np.False_)
    # (s, 3): the steps that are shorter than the gap.
    reach = np.arange(1 - _GAP, _GAP)
    steps = np.stack(np.meshgrid(reach, reach, reach, indexing="ij"), axis=-1).reshape(-1, 3)
    places = unpack_keys(level.keys[level.row_of[cells]])
    touched = np.zeros(len(cells), np.bool_)
    for step in steps[(steps**2).sum(axis=1) < _GAP**2]:
        touched |= holds[kernels.find_keys(level.keys, pack_places(places + step))]
    return touched


def _lie_on_surface(
    levels: list[CellLevel], number: int, base: int, sparse: IntArray, cells: IntArray
) -> BoolArray:
    """Tell which finest cells lie with others as sparse on a plane."""
    level = levels[number]
    places = unpack_keys(levels[0].keys[sparse > 0])
    weights = sparse[sparse > 0]
    squares = [weights * places[:, i] * places[:, j] for i, j in _PAIRS]
    # 10 columns: points, places and products of places, in finest cells; they add up over cells.
    sums = [weights, *(weights * column for column in places.T), *squares]
    held = level.row_of[sparse > 0]
    own = np.stack([_sum_rows(held, column, len(level.keys)) for column in sums], axis=1)
    rows = _distinct(level.row_of[cells], len(level.keys))
    around = kernels.sum_neighbours(level.keys, own, rows).astype(np.float64)
    # (r, 4), (r, 3, 3): of what lies around each cell, the mean place and the covariance.
    means = around[:, :4] / around[:, :1]
    spread = np.empty((len(rows), 3, 3))
    for column, (i, j) in enumerate(_PAIRS, start=4):
        spread[:, i, j] = around[:, column] / around[:, 0] - means[:, 1 + i] * means[:, 1 + j]
        spread[:, j, i] = spread[:, i, j]
    variances, axes = np.linalg.eigh(spread)
    row = np.searchsorted(rows, level.row_of[cells])
    offset = unpack_keys(levels[0].keys[cells]) - means[row, 1:]
    # (c,): how far each cell is off the plane of what lies around it.
    height = np.abs((offset * axes[row, :, 0]).sum(axis=1))
    # (r,): a sheet is as thick as a cell of the base, or as its points make it.
    thickness = np.maximum(2.0**base, np.sqrt(np.maximum(variances[:, 0], 0.0)))
    flat = variances[:, 0] <= _FLAT * variances.sum(axis=1)
    together = flat & (around[:, 0] >= _LEAST)
    lies: BoolArray = together[row] & (height <= 2.0 * thickness[row])
    return lies


def find_islands(levels: list[CellLevel]) -> BoolArray:
    """Find the cells on small pieces far from larger ones, (c,) of the first level; see the module.

    Levels are those from `ISLAND_LEVEL` upward, whose cells are the finest here.
    """
    total = int(levels[0].counts.sum())
    for number in range(len(levels)):
        level = levels[number]
        pieces, numbers = kernels.label_cells(level.keys)
        label: IntArray = numbers.astype(np.int64)
        points = _sum_rows(label, level.counts, pieces)
        # (p,): where too many points lie in small pieces, cells are too small for the cloud: larger
        # ones are tried.
        small = points < _ISLAND_SHARE * total
        if points[small].sum() <= _ISLANDS_SHARE * total:
            break
    if not small.any():
        return np.zeros(len(levels[0].keys), np.bool_)
    piece_of = label[level.row_of]
    # (p,): the level whose cells are twice as long as the piece. In none of the 27 around an island
    # lies a large one.
    reach = number + np.ceil(np.log2(2 * _measure_extents(level.keys, label, pieces)))
    island = small & (reach < len(levels))
    for height in np.unique(reach[island]).astype(int):
        near = _meet_others(levels[height], small[piece_of], (island & (reach == height))[piece_of])
        island[piece_of[near]] = False
    found: BoolArray = island[piece_of]
    return found


def _measure_extents(keys: IntArray, label: IntArray, pieces: int) -> IntArray:
    """Return the longest side of each piece, in cells."""
    places = unpack_keys(keys)
    low, high = np.full((pieces, 3), 1 << 40), np.full((pieces, 3), -1 << 40)
    np.minimum.at(low, label, places)
    np.maximum.at(high, label, places)
    extents: IntArray = (high - low).max(axis=1) + 1
    return extents


def _meet_others(level: CellLevel, small: BoolArray, asked: BoolArray) -> IntArray:
    """Return those of the asked finest cells with cells of large pieces around them."""
    large = _sum_rows(level.row_of, (~small).astype(np.int64), len(level.keys))
    cells = np.flatnonzero(asked)
    rows = _distinct(level.row_of[cells], len(level.keys))
    near = np.zeros(len(level.keys), np.bool_)
    near[rows] = kernels.sum_neighbours(level.keys, large[:, None], rows)[:, 0] > 0
    return cells[near[level.row_of[cells]]]
