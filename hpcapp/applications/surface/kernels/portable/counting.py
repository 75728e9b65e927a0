"""Points counted and sampled in boxes and cells."""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface.kernels.portable.connectivity import label_components
from hpcapp.applications.surface.types.lattice import (
    NEIGHBOURS,
    are_sampled,
    cells_of,
    find_keys,
    number_keys,
    pack_places,
    step_keys,
    unique_keys,
)
from hpcapp.applications.surface.types.points import FloatArray, Int32Array, IntArray

__all__ = [
    "bound_points",
    "count_boxes",
    "count_cells",
    "label_cells",
    "sample_boxes",
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


def label_cells(keys: IntArray) -> tuple[int, Int32Array]:
    """Number the pieces of cells that touch, by faces, edges or corners.

    Parameters
    ----------
    keys : ndarray of int64, shape (c,)
        Sorted, unique.

    Returns
    -------
    pieces : int
    label : ndarray of int32, shape (c,)
        The piece of each cell, numbered in the order of their first cells.
    """
    links = [np.zeros((0, 3), np.int64)]
    for step in NEIGHBOURS[len(NEIGHBOURS) // 2 + 1 :]:
        other = find_keys(keys, step_keys(keys, step))
        rows = np.flatnonzero(other < len(keys))
        links.append(np.stack([rows, other[rows], other[rows]], axis=1))  # faces, a corner twice
    return label_components(np.concatenate(links), len(keys))


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


def bound_points(positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the box around some points.

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
