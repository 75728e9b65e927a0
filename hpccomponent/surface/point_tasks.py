"""Tasks that begin with points: their moments are summed on the way, and never stored as a whole.

Who may import it: applications; workers find the tasks by name.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.kernels import accumulate_moments, fit_corners, merge_cells
from hpccomponent.surface.points import FloatArray, IntArray

__all__ = ["fit_points", "merge_points"]

Float32Array = NDArray[np.float32]


def merge_points(
    cells: IntArray, local_positions: FloatArray, normals: FloatArray, offsets: IntArray
) -> tuple[IntArray, FloatArray]:
    """Sum the moments of points over the parents of their cells (a task).

    Parameters
    ----------
    cells : ndarray of int64, shape (c,)
        Sorted keys; all children of their parents that hold points.
    local_positions, normals : ndarray of float64, shape (n, 3)
    offsets : ndarray of int64, shape (c + 1,)
        See `moments.accumulate_moments`.

    Returns
    -------
    parents : ndarray of int64, shape (p,)
        Sorted keys.
    moments : ndarray of float64, shape (p, 44)
        In units of the parents.
    """
    return merge_cells(cells, accumulate_moments(local_positions, normals, offsets))


def fit_points(
    touched: IntArray,
    cells: IntArray,
    local_positions: FloatArray,
    normals: FloatArray,
    offsets: IntArray,
    prior: Float32Array,
    noise: Float32Array,
    lam: float,
    least_mu: float,
    most_mu: float,
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Fit a quadric to the points around each corner (a task).

    Parameters
    ----------
    touched, cells : ndarray of int64, shapes (t,) and (c,)
    local_positions, normals : ndarray of float64, shape (n, 3)
    offsets : ndarray of int64, shape (c + 1,)
        See `moments.accumulate_moments`.
    prior, noise, lam, least_mu, most_mu
        See `cells.fit_corners`.

    Returns
    -------
    coefficients, counts, variances : ndarray of float32, shapes (t, 10), (t,) and (t,)
        See `cells.fit_corners`.
    """
    moments = accumulate_moments(local_positions, normals, offsets)
    return fit_corners(touched, cells, moments, prior, noise, lam, least_mu, most_mu)
