"""What a tile may grow into, and which vertices of the lattices that takes.

::

    own bricks ── 1 further ──> open ones ── their rim ──> evaluated ── a cell further ──> vertices

A brick that holds points belongs to the first tile that has one of them.
"""

from __future__ import annotations

import numpy as np

from hpcapp import kernels
from hpcapp.geometry.lattice import find_keys, unpack_keys
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.kernels.types.grid import BESIDE, BRICK, FOREIGN, OPEN, OUT, OWN, BrickKinds, Grid


def halo_steps(grid: Grid) -> int:
    """Return how far a point of a tile may be from a node of its bricks or rim, in grid steps."""
    return (2 + grid.rim) * BRICK


def mark_near(
    keys: IntArray, cells: IntArray, low: IntArray | int, high: IntArray | int
) -> BoolArray:
    """Tell which of some keys (k,) lie in boxes around cells (c,), both sorted keys of one lattice.

    A box reaches `low` cells down and `high` cells up, (3,) or the same along each axis.
    """
    sides = (np.ascontiguousarray(np.broadcast_to(side, 3), np.int64) for side in (low, high))
    return kernels.mark_near(keys, cells, *sides)


def plan_whole(grid: Grid, positions: FloatArray) -> BrickKinds:
    """Let the surface of a whole cloud grow wherever it gets: all bricks are `OWN` or `OPEN`."""
    kinds = BrickKinds(np.zeros(3, np.int64), np.full(grid.bricks, OPEN, np.uint8))
    kinds.mark(kernels.seed_bricks(grid, positions), OWN)
    return kinds


def cut_slab(grid: Grid, kinds: BrickKinds, first: int, end: int) -> BrickKinds:
    """Cut a slab out of a tile, with the rim beside it.

    It has the layers of bricks from `first` to before `end` along x. In the copy the tile's own
    bricks beside the slab are `FOREIGN`, open ones `BESIDE`. It ends where no brick of the slab's
    rim is left.
    """
    start = int(kinds.first[0])
    low, high = max(first - grid.rim, start), min(end + grid.rim, start + len(kinds.kinds))
    corner = np.array([low, *kinds.first[1:]])
    cut = kinds.kinds[low - start : high - start].copy()
    if (low, high) == (first, end):
        return BrickKinds(corner, cut)
    # (x,): layers of other slabs. Of these only what the slab's own and open bricks ask for stays.
    is_beside = np.ones(len(cut), np.bool_)
    is_beside[first - low : end - low] = False
    is_rim = _mark_rim(grid, corner, ~is_beside[:, None, None] & ((cut == OPEN) | (cut == OWN)))
    cut[is_beside[:, None, None] & ~is_rim] = OUT
    beside = cut[is_beside]
    beside[beside == OWN] = FOREIGN
    beside[beside == OPEN] = BESIDE
    cut[is_beside] = beside
    # The slab's layers, and those beside it that have something left.
    layers = np.flatnonzero(~is_beside | (cut != OUT).any(axis=(1, 2)))
    used = slice(int(layers[0]), int(layers[-1]) + 1)
    corner[0] += used.start
    return BrickKinds(corner, cut[used])


def plan_tile(grid: Grid, own: IntArray, earlier: IntArray, later: IntArray) -> BrickKinds | None:
    """Tell how far a tile may grow; None where every brick of it belongs to one before it.

    Sorted keys tell the bricks that hold points of the tile, and points around it that belong to
    tiles before and after it.
    """
    own = own[find_keys(earlier, own) == len(earlier)]  # a brick is that of the first tile in it
    if not len(own):
        return None
    places = unpack_keys(own)
    # A box of bricks around the tile's own, which are marked in it; what is next to these may grow,
    # and what is the rim of that may only be evaluated.
    far = 1 + grid.rim
    first = np.maximum(places.min(axis=0) - far, 0)
    end = np.minimum(places.max(axis=0) + far + 1, grid.bricks)
    mask = np.zeros(end - first, np.bool_)
    mask[tuple((places - first).T)] = True
    beside = kernels.mark_rim(mask, None)
    is_rim = _mark_rim(grid, first, beside)
    kinds = BrickKinds(first, np.where(is_rim, np.uint8(BESIDE), np.uint8(OUT)))
    kinds.kinds[beside] = OPEN
    # The last mark counts: bricks with others' points are not open, the tile's own are its own.
    for foreign in (earlier, later):
        kinds.mark(foreign[kinds.at(foreign) != OUT], FOREIGN)
    kinds.kinds[mask] = OWN
    return kinds


def plan_gap(
    grid: Grid,
    box: IntArray,
    exits: IntArray,
    taken: IntArray,
    missing: FloatArray,
    size: float,
    reach: float,
) -> BrickKinds:
    """Tell how far the surface may be followed from bricks without points, as over a hole.

    It stays in a `box` (2, 3) of bricks, from the lowest to before the last. `exits` (e,) are keys
    of the bricks in it to begin with, `taken` of those that are others', as all with points.
    `missing` (c, 3) are low corners of the cells, of edge `size`, whose points are not known here;
    `reach` is how far a point matters, all in length units.
    """
    edge = BRICK * grid.step
    first, end = widen_box(grid, box)
    # (x, y, z) of the box and its rim: bricks of which every point that matters is known here.
    known_all = np.ones(end - first, np.bool_)
    # (c, 3): from which brick to before which the points of each missing cell matter.
    low = np.floor((missing - reach - grid.origin) / edge).astype(np.int64)
    high = np.floor((missing + size + reach - grid.origin) / edge).astype(np.int64) + 1
    is_near = ((low < end) & (high > first)).all(axis=1)
    starts, stops = np.maximum(low[is_near], first) - first, high[is_near] - first
    for start, stop in zip(starts, stops, strict=True):
        known_all[start[0] : stop[0], start[1] : stop[1], start[2] : stop[2]] = False
    # (x, y, z): in the box, where the rim is known as well, the surface may grow.
    is_inside = np.zeros_like(known_all)
    is_inside[tuple(map(slice, box[0] - first, box[1] - first))] = True
    gap = BrickKinds(first, np.full(known_all.shape, OUT, np.uint8))
    gap.kinds[is_inside & ~_mark_rim(grid, first, ~known_all)] = OPEN
    gap.mark(exits, OWN)
    is_rim = _mark_rim(grid, first, gap.kinds != OUT)
    gap.kinds[is_rim & (gap.kinds == OUT)] = BESIDE
    gap.mark(taken[gap.at(taken) != OUT], FOREIGN)
    gap.mark(exits, OWN)
    return gap


def widen_box(grid: Grid, box: IntArray) -> IntArray:
    """Return a box of bricks, (2, 3), with what may be evaluated around it."""
    far = 1 + grid.rim
    return np.stack([np.maximum(box[0] - far, 0), np.minimum(box[1] + far, grid.bricks)])


def near_bricks(
    kinds: BrickKinds,
    grid: Grid,
    cells: IntArray,
    origin: FloatArray,
    cell_size: float,
    reach: float,
) -> BoolArray:
    """Tell which cells have a brick that may be evaluated within reach of their middle, (c,).

    `cells` (c,) are sorted keys, whose corner (0, 0, 0) lies at `origin` (3,); the reach, in length
    units, is along every axis.
    """
    edge = BRICK * grid.step
    corner = grid.origin + edge * kinds.first
    return kernels.look_near(cells, origin, cell_size, kinds.kinds, corner, edge, reach)


def _mark_rim(grid: Grid, first: IntArray, bricks: BoolArray) -> BoolArray:
    """Mark some bricks of a box and their rim, given the lowest brick of the box."""
    strides = grid.strides
    return kernels.mark_rim(
        bricks, None if strides is None else strides.cells_within(first, bricks.shape)
    )
