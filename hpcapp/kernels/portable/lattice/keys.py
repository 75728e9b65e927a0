"""Sets of cells, corners and bricks by their keys: where they stand, and which lie near others."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry import lattice
from hpcapp.geometry.lattice import (
    NEIGHBOURS,
    OCTANTS,
    corner_parents,
    pack_places,
    spread_keys,
    step_keys,
    unique_keys,
    unite_keys,
    unpack_keys,
)
from hpcapp.geometry.points import BoolArray, ByteArray, FloatArray, Int32Array, IntArray
from hpcapp.kernels.portable.mesh.topology import label_components
from hpcapp.kernels.types.grid import OUT

__all__ = [
    "find_keys",
    "label_cells",
    "look_near",
    "mark_ancestors",
    "mark_near",
    "parent_keys",
    "spread_keys",
    "unite_keys",
]


def find_keys(keys: IntArray, wanted: IntArray, threads: int = 1) -> IntArray:
    """Return the rows of keys (...) among sorted, unique keys (k,): k where one is missing."""
    del threads  # numpy runs on one
    return lattice.find_keys(keys, wanted)


def mark_ancestors(cells: IntArray, depth: int, ancestors: IntArray) -> NDArray[np.uint32]:
    """Tell which cells of a level are ancestors of some of the finest, and where in them these lie.

    `cells` (c,) are sorted keys of finest cells, `ancestors` (a,) those of cells of level `depth`.
    In (a,), bit x + 3 y + 9 z is set where one of the cells lies, along each axis, first (0),
    between (1) or last (2) among the finest in the ancestor; 0 for what is the ancestor of none.
    """
    places = unpack_keys(cells)
    # (c, 3): where each lies in its ancestor along each axis: first 0, between 1, last 2.
    within, last = places & ((1 << depth) - 1), (1 << depth) - 1
    ways = np.where(within == 0, 0, np.where(within == last, 2, 1))
    bits = np.uint32(1) << (ways @ np.array([1, 3, 9])).astype(np.uint32)
    rows = lattice.find_keys(ancestors, pack_places(places >> depth))
    marks = np.zeros(len(ancestors) + 1, np.uint32)
    np.bitwise_or.at(marks, rows, bits)
    return marks[:-1]


def mark_near(keys: IntArray, cells: IntArray, low: IntArray, high: IntArray) -> BoolArray:
    """Tell which keys (k,) lie in boxes around cells (c,), both sorted keys of one lattice.

    A box reaches `low` and `high` (3,) cells down and up along each axis.
    """
    for axis, unit in enumerate(np.eye(3, dtype=np.int64)):
        steps = [step_keys(cells, unit * step) for step in range(-low[axis], high[axis] + 1)]
        cells = unique_keys(np.concatenate(steps))
    near: BoolArray = lattice.find_keys(cells, keys) < len(cells)
    return near


def look_near(
    cells: IntArray,
    origin: FloatArray,
    cell_size: float,
    kinds: ByteArray,
    corner: FloatArray,
    edge: float,
    reach: float,
) -> BoolArray:
    """Tell which cells (c,) have a brick that may be evaluated in reach, see `halo.near_bricks`.

    `kinds` (x, y, z), such as `OUT`, are those of the bricks in a box, of which the lowest begins
    at `corner` (3,), and `edge` is a brick's. The reach is from a cell's middle along every axis.
    """
    places = origin + cell_size * (unpack_keys(cells) + 0.5)  # (c, 3): the middles
    # (x + 1, y + 1, z + 1): how many such bricks lie below each corner of the bricks
    below = np.pad((kinds != OUT).astype(np.int32), ((1, 0),) * 3)
    for axis in range(3):
        np.cumsum(below, axis=axis, out=below)
    # (c, 3): from which brick to before which one a cell reaches
    first, end = (
        np.clip(np.floor((places - corner) / edge + side * (reach / edge)) + more, 0, kinds.shape)
        for side, more in ((-1, 0), (1, 1))
    )
    counts = np.zeros(len(cells), np.int64)
    for ends in np.ndindex(2, 2, 2):
        x, y, z = np.where(ends, end, first).astype(np.int64).T
        # Inclusion and exclusion over the corners: those with one upper end or three add.
        counts += (1 if sum(ends) % 2 else -1) * below[x, y, z]
    return counts > 0


def parent_keys(vertices: IntArray) -> IntArray:
    """Return all parents of corners (v,): sorted, unique keys of the next coarser level, (p,)."""
    places = unpack_keys(vertices)
    parents = [unique_keys(corner_parents(places, octant)[0]) for octant in OCTANTS]
    return unique_keys(np.concatenate(parents))


def label_cells(keys: IntArray) -> tuple[int, Int32Array]:
    """Number the pieces of cells that touch, by faces, edges or corners.

    Given sorted, unique keys (c,), return how many pieces there are, and the piece of each cell,
    (c,), numbered in the order of their first cells.
    """
    links = [np.zeros((0, 3), np.int64)]
    for step in NEIGHBOURS[len(NEIGHBOURS) // 2 + 1 :]:
        other = lattice.find_keys(keys, step_keys(keys, step))
        rows = np.flatnonzero(other < len(keys))
        links.append(np.stack([rows, other[rows], other[rows]], axis=1))  # faces, a corner twice
    return label_components(np.concatenate(links), len(keys))
