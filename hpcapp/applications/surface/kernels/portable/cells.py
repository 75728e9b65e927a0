"""From points to cells with moments, and from cells to quadrics at their corners.

One level of the pyramid at a time, all its rows at once.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface.kernels.constants import BASIS, COLUMNS
from hpcapp.applications.surface.kernels.portable.hermite import (
    evaluate_misfits,
    fit_vertices,
    inherit_quadrics,
    residual_variances,
    weigh_priors,
)
from hpcapp.applications.surface.kernels.portable.moments import scale_moments, shift_moments
from hpcapp.applications.surface.types.lattice import (
    OCTANTS,
    cells_of,
    corner_parents,
    find_keys,
    pack_places,
    step_keys,
    unique_keys,
    unpack_keys,
)
from hpcapp.applications.surface.types.points import Float32Array, FloatArray, IntArray

__all__ = [
    "corner_moments",
    "fit_corners",
    "gather_points",
    "inherit_level",
    "merge_cells",
    "parent_keys",
    "sort_points",
]


_CHUNK_VERTICES = 1 << 14


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


def merge_cells(cells: IntArray, moments: FloatArray) -> tuple[IntArray, FloatArray]:
    """Sum the moments of each eight children about the centre of their parent.

    Parameters
    ----------
    cells : ndarray of int64, shape (c,)
        Sorted keys.
    moments : ndarray of float64, shape (c, 44)

    Returns
    -------
    parents : ndarray of int64, shape (p,)
        Sorted keys of the next coarser level.
    moments : ndarray of float64, shape (p, 44)
        In units of the parents.
    """
    places = unpack_keys(cells)
    keys = pack_places(places >> 1)
    parents = unique_keys(keys)
    owners = find_keys(parents, keys)  # (c,): the row of each cell's parent
    which = (places & 1) @ np.array([1, 2, 4])  # (c,): which octant of it, x fastest
    merged = np.zeros((len(parents), COLUMNS))
    for child, octant in enumerate(OCTANTS):
        chosen = which == child
        # A parent has one child of each octant at most: no row is named twice.
        merged[owners[chosen]] += shift_moments(moments[chosen], octant - 0.5)
    return parents, scale_moments(merged)


def parent_keys(vertices: IntArray) -> IntArray:
    """Return every parent of some corners.

    Parameters
    ----------
    vertices : ndarray of int64, shape (v,)

    Returns
    -------
    ndarray of int64, shape (p,)
        Sorted, unique keys of the next coarser level.
    """
    places = unpack_keys(vertices)
    parents = [unique_keys(corner_parents(places, octant)[0]) for octant in OCTANTS]
    return unique_keys(np.concatenate(parents))


def corner_moments(
    touched: IntArray, cells: IntArray, moments: FloatArray, threads: int = 1
) -> FloatArray:
    """Sum the moments of the eight cells around each corner, about it.

    Parameters
    ----------
    touched : ndarray of int64, shape (t,)
        Sorted keys of corners.
    cells : ndarray of int64, shape (c,)
        Sorted keys of cells, at least one; those that touch none of the corners do not count.
    moments : ndarray of float64, shape (c, 44)

    Returns
    -------
    ndarray of float64, shape (t, 44)
    """
    del threads  # numpy runs on one
    total = np.zeros((len(touched), COLUMNS))
    for octant in OCTANTS:
        # (t,): the cell of which each corner is that octant's; it lies half a cell away.
        rows = find_keys(cells, step_keys(touched, -octant))
        present = rows < len(cells)
        total[present] += shift_moments(moments[rows[present]], 0.5 - octant)
    return total


def fit_corners(
    touched: IntArray,
    cells: IntArray,
    moments: FloatArray,
    prior: Float32Array,
    noise: Float32Array,
    lam: Float32Array,
    least_mu: float,
    most_mu: float,
    threads: int = 1,
) -> tuple[Float32Array, Float32Array, Float32Array, Float32Array]:
    """Fit one quadric to the points in the eight cells around each corner.

    Parameters
    ----------
    touched : ndarray of int64, shape (t,)
        Sorted keys of corners; each has a point around it.
    cells : ndarray of int64, shape (c,)
    moments : ndarray of float64, shape (c, 44)
    prior : ndarray of float32, shape (t, 10)
    noise : ndarray of float32, shape (t,)
        Variance of the positions around each corner, in cells squared.
    lam : ndarray of float32, shape (t,)
        Weights of the normals, see `hermite.fit_vertices`.
    least_mu, most_mu : float
        Between which the weights of the priors lie, see `hermite.weigh_priors`.

    Returns
    -------
    coefficients : ndarray of float32, shape (t, 10)
        Rounded once, here, by the only one who computes them.
    counts : ndarray of float32, shape (t,)
        Points around each corner.
    variances : ndarray of float32, shape (t,)
        What the fits leave over, NaN where points are few: see `hermite.residual_variances`.
    misfits : ndarray of float32, shape (t,)
        How far the gradients are off the points' normals: see `hermite.evaluate_misfits`.
    """
    del threads  # numpy runs on one
    coefficients = np.empty((len(touched), BASIS), np.float32)
    counts, variances, misfits = np.empty((3, len(touched)), np.float32)
    for start in range(0, len(touched), _CHUNK_VERTICES):
        rows = slice(start, start + _CHUNK_VERTICES)
        around = corner_moments(touched[rows], cells, moments)  # (t, 44), about the corners
        priors = prior[rows].astype(np.float64)
        slopes = lam[rows].astype(np.float64)
        given = priors, noise[rows].astype(np.float64), slopes
        mu = weigh_priors(around, *given, least_mu, most_mu)
        fitted = fit_vertices(around, priors, slopes, mu)
        coefficients[rows] = fitted
        counts[rows] = around[:, 0]
        variances[rows] = residual_variances(around, fitted)
        misfits[rows] = evaluate_misfits(around, fitted)
    return coefficients, counts, variances, misfits


def inherit_level(
    vertices: IntArray,
    parents: IntArray,
    coefficients: Float32Array,
    values: Float32Array,
    threads: int = 1,
) -> tuple[Float32Array, Float32Array]:
    """Return the means of the parents' quadrics, about their children, and of other values.

    Parameters
    ----------
    vertices : ndarray of int64, shape (v,)
        Sorted keys of corners.
    parents : ndarray of int64, shape (p,)
        Sorted keys of corners of the next coarser level, all parents among them.
    coefficients : ndarray of float32, shape (p, 10)
    values : ndarray of float32, shape (p, k)
        Whatever else is to be averaged.

    Returns
    -------
    coefficients : ndarray of float32, shape (v, 10)
    values : ndarray of float32, shape (v, k)
    """
    del threads  # numpy runs on one
    # A corner on an odd place has two parents along an axis; on an even one the same twice: eight
    # of weight 1/8 whatever the place.
    means = np.zeros((len(vertices), BASIS))
    inherited = np.zeros((len(vertices), values.shape[1]))
    places = unpack_keys(vertices)
    for octant in OCTANTS:
        keys, steps = corner_parents(places, octant)
        rows = find_keys(parents, keys)
        means += 0.125 * inherit_quadrics(coefficients[rows].astype(np.float64), steps)
        inherited += 0.125 * values[rows]
    return means.astype(np.float32), inherited.astype(np.float32)
