"""How the points lie around the vertices of a coarse level: from all around, and how crowded.

Coarse quadrics are for places where the finer level is too sparse, and finer vertices count on
them where the surface goes on: this tells where that is.
"""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface import kernels
from hpcapp.geometry.lattice import OCTANTS, ancestor_keys, step_keys
from hpcapp.geometry.points import BoolArray, Float32Array, FloatArray, IntArray

_LEAST_CELLS = 4


def sum_squares(children: IntArray, counts: FloatArray, parents: IntArray) -> FloatArray:
    """Sum the squared counts of the children of each cell.

    Parameters
    ----------
    children : ndarray of int64, shape (c,)
        Keys of cells.
    counts : ndarray of float64, shape (c,)
        Points in each.
    parents : ndarray of int64, shape (p,)
        Sorted keys of the next coarser level, all parents among them.
    """
    owners = kernels.find_keys(parents, ancestor_keys(children))
    return np.bincount(owners, counts**2, len(parents)).astype(np.float64)


def crowd_vertices(
    vertices: IntArray, counts: Float32Array, cells: IntArray, squares: FloatArray
) -> FloatArray:
    """Find how many other points a point around each vertex meets in its finer cell, on average.

    Parameters
    ----------
    vertices : ndarray of int64, shape (v,)
        Sorted keys of corners; those of the cells that are missing are passed over.
    counts : ndarray of float32, shape (v,)
        Points in the eight cells around each.
    cells : ndarray of int64, shape (c,)
        Keys of the occupied cells of the same level.
    squares : ndarray of float64, shape (c,)
        As `sum_squares` gives them.

    Returns
    -------
    ndarray of float64, shape (v,)
        sum n_child^2 / sum n_child - 1; infinite where there is no point.
    """
    total = np.zeros(len(vertices) + 1)  # the last is that of a missing one
    for octant in OCTANTS:
        total[kernels.find_keys(vertices, step_keys(cells, octant))] += squares
    total = total[:-1]
    crowds = np.full(len(vertices), np.inf)
    np.divide(total, counts, out=crowds, where=counts > 0.0)
    return crowds - 1.0


def surrounded_vertices(vertices: IntArray, cells: IntArray) -> BoolArray:
    """Tell around which vertices the surface goes on: four or more of their cells hold points.

    Parameters
    ----------
    vertices : ndarray of int64, shape (v,)
        Sorted keys of corners; those of the cells that are missing are passed over.
    cells : ndarray of int64, shape (c,)
        Keys of the occupied cells of the same level.

    Notes
    -----
    A plane along an axis that passes through one of the eight cells around a vertex passes
    through four. Beyond the end of a scan there are two, or one.
    """
    occupied = np.zeros(len(vertices) + 1, np.int8)  # the last is that of a missing one
    for octant in OCTANTS:
        occupied[kernels.find_keys(vertices, step_keys(cells, octant))] += 1
    return occupied[:-1] >= _LEAST_CELLS
