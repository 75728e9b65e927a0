"""How cells and blocks with their points are cut into about equal parts."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from hpcapp.geometry.lattice import unique_keys, unpack_keys
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray


def cut_even(counts: IntArray, pieces: int) -> list[slice]:
    """Cut a cloud into runs of whole blocks with about as many points each.

    Of the blocks there are the counts of points (b,); the runs, slices of their rows, are fewer
    than `pieces` where blocks are few or uneven.

    Examples
    --------
    >>> cut_even(np.array([3, 4, 9, 1, 1]), 3)
    [slice(0, 2, None), slice(2, 3, None), slice(3, 5, None)]
    """
    ends = np.cumsum(counts)
    wanted = ends[-1] * np.arange(1, pieces) / pieces
    # A block belongs to the piece in which its middle point lies.
    inner = np.searchsorted(ends - 0.5 * counts, wanted)
    bounds = unique_keys(np.concatenate([[0], inner, [len(counts)]])).tolist()
    return [slice(a, b) for a, b in pairwise(bounds)]


def cut_regions(keys: IntArray, counts: IntArray, pieces: int) -> list[IntArray]:
    """Cut a cloud into regions of about as many points, as compact as blocks allow.

    Each has sorted keys of the cloud's b blocks; there are `pieces` of them, or fewer.
    """
    region_of = cut_tiles(keys, counts, pieces)
    return [keys[region_of == region] for region in range(int(region_of.max()) + 1)]


def cut_tiles(cells: IntArray, work: IntArray | FloatArray, count: int) -> IntArray:
    """Cut cells (c,) into compact tiles of equal work, by halving across the longest side.

    Work is in any unit. Returns the tile of each cell (c,): numbers from 0 on, none left out. The
    halos of runs along a Morton curve hold a half more (`docs/explanation/tiles.md`).
    """
    places = unpack_keys(cells)
    tiles = np.zeros(len(cells), np.int64)
    pending = [(np.arange(len(cells)), 0, min(count, len(cells)))]
    while pending:
        rows, first, parts = pending.pop()
        tiles[rows] = first
        if parts == 1:
            continue
        near = places[rows]
        axis = int(np.argmax(near.max(axis=0) - near.min(axis=0)))
        rows = rows[np.argsort(near[:, axis], kind="stable")]
        own, lower = work[rows], parts // 2
        # (r,): the work up to the middle of each cell; the lower half gets its parts' share.
        middles = np.cumsum(own) - 0.5 * own
        cut = int(np.searchsorted(middles, own.sum() * (lower / parts)))
        cut = min(max(cut, lower), len(rows) - (parts - lower))  # a cell for each tile
        pending += [(rows[:cut], first, lower), (rows[cut:], first + lower, parts - lower)]
    return tiles


def find_near_blocks(keys: IntArray, blocks: IntArray, steps: int) -> IntArray:
    """Return those of a cloud's blocks that lie so many steps from some of them, or fewer."""
    places, wanted = unpack_keys(keys), unpack_keys(blocks)
    low = places.min(axis=0)
    sides = places.max(axis=0) - low + 1  # some 64 at most: see `choose_arrangement`
    near = np.zeros(sides, np.int64)
    # (x, y, z): 1 at the wanted blocks, and then, axis by axis, at all within reach of one.
    near[tuple((wanted - low).T)] = 1
    for axis, side in enumerate(sides):
        summed = np.insert(np.cumsum(near, axis=axis), 0, 0, axis=axis)
        at = np.arange(side)
        # How many there are in a window of 2 steps + 1, as a difference of running sums.
        above = summed.take(np.minimum(at + steps + 1, side), axis=axis)
        near = np.sign(above - summed.take(np.maximum(at - steps, 0), axis=axis))
    is_near: BoolArray = near[tuple((places - low).T)] > 0
    return keys[is_near]
