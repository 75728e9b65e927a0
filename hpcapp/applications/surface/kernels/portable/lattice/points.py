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
    """Count the points in each occupied cell.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
        In length units of the input; at least one.
    low : ndarray of float64, shape (3,)
        Corner of a cell.
    edge : float
        Of a cell, in length units of the input.

    Returns
    -------
    keys : ndarray of int64, shape (c,)
        Sorted.
    counts : ndarray of int64, shape (c,)
    cell_of : ndarray of int64, shape (n,)
        The row of each point's cell.

    Raises
    ------
    InputError
        A point lies too many cells away.
    """
    places = pack_places(np.floor(cells_of(positions, low, edge)).astype(np.int64))
    keys, cell_of = number_keys(places)
    return keys, np.bincount(cell_of, minlength=len(keys)).astype(np.int64), cell_of


def sum_neighbours(keys: IntArray, values: IntArray, wanted: IntArray) -> IntArray:
    """Sum values over the 27 cells around some cells.

    Parameters
    ----------
    keys : ndarray of int64, shape (c,)
        Sorted, at least one.
    values : ndarray of int64, shape (c, w)
    wanted : ndarray of int64, shape (r,)
        Rows of the cells in the middle.

    Returns
    -------
    ndarray of int64, shape (r, w)
    """
    padded = np.concatenate([values, np.zeros((1, values.shape[1]), np.int64)])
    sums = np.zeros((len(wanted), values.shape[1]), np.int64)
    for step in NEIGHBOURS:
        sums += padded[find_keys(keys, step_keys(keys[wanted], step))]
    return sums


def count_boxes(
    positions: FloatArray, low: FloatArray, edge: float, one_in: int
) -> tuple[int, int]:
    """Count points and occupied boxes, over a sample of the boxes.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
    low : ndarray of float64, shape (3,)
        Corner of a box.
    edge : float
        Of a box, in length units of the input.
    one_in : int
        About one box in so many is in the sample, chosen by a hash.
    """
    keys = pack_places(np.floor(cells_of(positions, low, edge)).astype(np.int64))
    keys = keys[are_sampled(keys, one_in)]
    return len(keys), len(unique_keys(keys))


def sample_boxes(positions: FloatArray, low: FloatArray, edge: float, one_in: int) -> IntArray:
    """Return the points in a sample of boxes.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
    low : ndarray of float64, shape (3,)

    Returns
    -------
    ndarray of int64, shape (m,)
        Their rows, rising.
    """
    places = np.floor(cells_of(positions, low, edge)).astype(np.int64)
    return np.flatnonzero(are_sampled(pack_places(places), one_in))


def count_halved(
    positions: FloatArray, origin: FloatArray, cell_size: float, depth: int
) -> tuple[IntArray, IntArray, IntArray]:
    """Count points in cells, and in each the boxes that hold some as it is halved again and again.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
        In length units of the input; at least one.
    origin : ndarray of float64, shape (3,)
        Corner of a cell.
    cell_size : float
        In length units of the input.
    depth : int
        So often cells are halved: 20 times at most.

    Returns
    -------
    cells : ndarray of int64, shape (c,)
        Sorted keys of the occupied cells.
    points : ndarray of int64, shape (c,)
        In each.
    boxes : ndarray of int64, shape (c, depth + 1)
        That hold points: of the cell's edge, of half of it, of a quarter and so on.

    Raises
    ------
    InputError
        A point lies too many boxes away.
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
    """Sort points by the cell that they lie in.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
        In length units of the input; at least one.
    origin : ndarray of float64, shape (3,)
        Where corner (0, 0, 0) of the lattice lies.
    cell_size : float
        In length units of the input.

    Returns
    -------
    cells : ndarray of int64, shape (c,)
        Sorted keys of the occupied cells.
    offsets : ndarray of int64, shape (c + 1,)
        Cell i holds the points rows[offsets[i]] to rows[offsets[i + 1]].
    rows : ndarray of uint32, shape (n,)
        Within a cell the points keep their order.

    Raises
    ------
    InputError
        A point lies too many cells away.
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
    """Return some points, each relative to the centre of the cell that it lies in.

    Parameters
    ----------
    positions, normals : ndarray of float64, shape (n, 3)
    rows : ndarray of uint32, shape (r,)
    origin : ndarray of float64, shape (3,)

    Returns
    -------
    local_positions : ndarray of float64, shape (r, 3)
        In cells.
    normals : ndarray of float64, shape (r, 3)
    """
    places = cells_of(positions[rows], origin, cell_size)
    return places - np.floor(places) - 0.5, normals[rows]
