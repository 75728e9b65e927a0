"""How the points lie around the vertices of a coarse level: from all around, and how crowded.

Coarse quadrics are for places where the finer level is too sparse, and finer vertices count on
them where the surface goes on: this tells where that is.
"""

from __future__ import annotations

import numpy as np

from hpcapp import kernels
from hpcapp.geometry.lattice import OCTANTS, ancestor_keys, step_keys
from hpcapp.geometry.points import BoolArray, Float32Array, FloatArray, IntArray

_LEAST_CELLS = 4


def sum_squares(children: IntArray, counts: FloatArray, parents: IntArray) -> FloatArray:
    """Sum the squared counts (c,) of the children (c,) of each cell, (p,).

    `parents` (p,) are sorted keys of the next coarser level, all parents among them.
    """
    owners = kernels.find_keys(parents, ancestor_keys(children))
    return np.bincount(owners, counts**2, len(parents)).astype(np.float64)


def crowd_vertices(
    vertices: IntArray, counts: Float32Array, cells: IntArray, squares: FloatArray
) -> FloatArray:
    """Find how many other points a point around each vertex meets in its finer cell, on average.

    Return sum n_child^2 / sum n_child - 1, (v,): infinite where there is no point. `counts` (v,)
    are points in the eight cells around each of the `vertices` (v,), sorted keys; corners of the
    occupied `cells` (c,) of the same level that are not among them are passed over. `squares` (c,)
    are as of `sum_squares`.
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

    Corners of the occupied `cells` (c,) of the same level that are not among the `vertices` (v,),
    which are sorted keys, are passed over. A plane along an axis that passes through one of the
    eight cells around a vertex passes through four. Beyond the end of a scan there are two, or one.
    """
    occupied = np.zeros(len(vertices) + 1, np.int8)  # the last is that of a missing one
    for octant in OCTANTS:
        occupied[kernels.find_keys(vertices, step_keys(cells, octant))] += 1
    return occupied[:-1] >= _LEAST_CELLS
