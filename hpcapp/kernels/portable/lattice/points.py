"""Points bounded, and counted, sampled and sorted in boxes and cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.lattice import (
    NEIGHBOURS,
    ancestor_keys,
    are_sampled,
    cells_of,
    find_keys,
    number_keys,
    pack_places,
    step_keys,
    unique_keys,
)
from hpcapp.geometry.points import FloatArray, IntArray

__all__ = [
    "count_boxes",
    "count_cells",
    "count_halved",
    "gather_points",
    "sample_boxes",
    "sort_points",
    "sum_neighbours",
]


def count_cells(
    positions: FloatArray, low: FloatArray, edge: float
) -> tuple[IntArray, IntArray, IntArray]:
    """Count the points (n, 3), one at least, in each occupied cell.

    `low` (3,) is the corner of a cell. Return sorted keys and counts (c,), and the row of each
    point's cell (n,). Raise `InputError` where a point lies too many cells away.
    """
    places = pack_places(np.floor(cells_of(positions, low, edge)).astype(np.int64))
    keys, cell_of = number_keys(places)
    return keys, np.bincount(cell_of, minlength=len(keys)).astype(np.int64), cell_of


def sum_neighbours(keys: IntArray, values: IntArray, wanted: IntArray) -> IntArray:
    """Sum values (c, w) over the 27 cells around those of the rows `wanted` (r,): (r, w).

    The cells' keys (c,) are sorted, one at least.
    """
    padded = np.concatenate([values, np.zeros((1, values.shape[1]), np.int64)])
    sums = np.zeros((len(wanted), values.shape[1]), np.int64)
    for step in NEIGHBOURS:
        sums += padded[find_keys(keys, step_keys(keys[wanted], step))]
    return sums


def count_boxes(
    positions: FloatArray, low: FloatArray, edge: float, one_in: int
) -> tuple[int, int]:
    """Count points (n, 3) and occupied boxes, over a sample of the boxes.

    `low` (3,) is the corner of a box. About one box in `one_in` is in the sample, chosen by a hash.
    """
    keys = pack_places(np.floor(cells_of(positions, low, edge)).astype(np.int64))
    keys = keys[are_sampled(keys, one_in)]
    return len(keys), len(unique_keys(keys))


def sample_boxes(positions: FloatArray, low: FloatArray, edge: float, one_in: int) -> IntArray:
    """Return the rows (m,), rising, of points (n, 3) in a sample of boxes (see `count_boxes`)."""
    places = np.floor(cells_of(positions, low, edge)).astype(np.int64)
    return np.flatnonzero(are_sampled(pack_places(places), one_in))


def count_halved(
    positions: FloatArray, origin: FloatArray, cell_size: float, depth: int
) -> tuple[IntArray, IntArray, IntArray]:
    """Count points in cells, and in each the boxes that hold some as it is halved again and again.

    `origin` (3,) is the corner of a cell; cells are halved `depth` times, 20 at most. Return the
    sorted keys of those that hold points (n, 3), one at least; the points in each, (c,); and the
    boxes that hold some, (c, depth + 1): of the cell's edge, of half of it, of a quarter and so on.
    Raise `InputError` where a point lies too many boxes away.
    """
    boxes, offsets, _ = sort_points(positions, origin, cell_size * 2.0**-depth)
    # (b,): the cell that each of the smallest boxes lies in.
    ancestors = ancestor_keys(boxes, depth)
    keys = unique_keys(ancestors)
    cell = find_keys(keys, ancestors)
    points = np.bincount(cell, np.diff(offsets), len(keys)).astype(np.int64)
    counts = [np.bincount(cell, minlength=len(keys))]
    for left in range(depth - 1, -1, -1):  # boxes of twice the edge, up to the cells themselves
        boxes = unique_keys(ancestor_keys(boxes))
        cell = find_keys(keys, ancestor_keys(boxes, left))
        counts.append(np.bincount(cell, minlength=len(keys)))
    return keys, points, np.stack(counts[::-1], axis=1)


def sort_points(
    positions: FloatArray, origin: FloatArray, cell_size: float
) -> tuple[IntArray, IntArray, NDArray[np.uint32]]:
    """Sort points (n, 3), one at least, by the cell that they lie in.

    Corner (0, 0, 0) of the lattice lies at `origin` (3,). Return the sorted keys (c,) of occupied
    cells, offsets (c + 1,) and rows (n,): cell i holds the points rows[offsets[i]] to
    rows[offsets[i + 1]], in the order that they had. Raise `InputError` where a point lies too many
    cells away.
    """
    keys = pack_places(np.floor(cells_of(positions, origin, cell_size)).astype(np.int64))
    rows = np.argsort(keys, kind="stable")
    cells = unique_keys(keys)
    offsets = np.append(np.searchsorted(keys[rows], cells), len(keys)).astype(np.int64)
    return cells, offsets, rows.astype(np.uint32)


def gather_points(
    positions: FloatArray,
    normals: FloatArray,
    rows: NDArray[np.uint32],
    origin: FloatArray,
    cell_size: float,
) -> tuple[FloatArray, FloatArray]:
    """Return points of the rows (r,) relative to the centres of their cells, and normals, (r, 3).

    Those are in cells; the positions and normals given are (n, 3), and `origin` (3,) is as for
    `sort_points`.
    """
    places = cells_of(positions[rows], origin, cell_size)
    return places - np.floor(places) - 0.5, normals[rows]
