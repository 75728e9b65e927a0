"""Quadrics fitted to points and their normals at once, each with its parent as prior.

At a vertex of the lattice, in cells from it, f(u) = c . phi(u) with the basis
phi = [1, x, y, z, xx, yy, zz, xy, yz, zx]; f is about a signed distance in cells, positive
outside. The fit needs no eigenvector and no decision on the sign: one 10x10 Cholesky.
"""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface.kernels.constants import BASIS, COLUMNS, MONOMIALS
from hpcapp.applications.surface.kernels.portable.quadrics.moments import EXPONENTS, shift_moments
from hpcapp.geometry.lattice import OCTANTS, find_keys, step_keys
from hpcapp.geometry.points import Float32Array, FloatArray, IntArray

__all__ = ["corner_moments", "evaluate_residuals", "fit_corners"]

_RIDGE = 1e-9
_LEAST_SLOPE = 0.05  # of the mean square of a prior's gradient, which is about 1
_LEAST_EXCESS = 1e-12
_LEAST_POINTS = 24.0  # for a variance: with fewer, it says more of the fit than of the noise
# What a fit gains over a prior that is right, in variances over all points: its 10 coefficients by
# chance, a half of the standard deviation sqrt(20) on top.
_CHANCE_GAIN = 12.236
_TOLD_POINTS = 60.0  # that the noise counts like which is told from further up
_OWN_WEIGHT = 3.0  # of a prior whose error is known by a fit: this many times the variances' ratio
_CHUNK_ROWS = 1 << 11
_CHUNK_VERTICES = 1 << 14
_COLUMN_OF = {exponent: column for column, exponent in enumerate(EXPONENTS)}

Terms = tuple[tuple[float, int], ...]


def _value_column(i: int, j: int) -> int:
    """Return the moment that is the sum of phi_i phi_j."""
    a, b, c = (p + q for p, q in zip(EXPONENTS[i], EXPONENTS[j], strict=True))
    return _COLUMN_OF[a, b, c]


def _gradient_terms(i: int, j: int) -> Terms:
    """Return the (factor, moment) whose sum is the sum of grad phi_i . grad phi_j."""
    terms = []
    for axis in range(3):
        factor = EXPONENTS[i][axis] * EXPONENTS[j][axis]
        if factor:
            a, b, c = (
                p + q - 2 * (axis == other)
                for other, (p, q) in enumerate(zip(EXPONENTS[i], EXPONENTS[j], strict=True))
            )
            terms.append((float(factor), _COLUMN_OF[a, b, c]))
    return tuple(terms)


def _mean_product(i: int, j: int) -> float:
    """Return the mean of phi_i phi_j over [-1, 1]^3."""
    mean = 1.0
    for p, q in zip(EXPONENTS[i], EXPONENTS[j], strict=True):
        mean *= 0.0 if (p + q) % 2 else 1.0 / (p + q + 1)
    return mean


_PAIRS = tuple((i, j) for j in range(BASIS) for i in range(j, BASIS))
_VALUE = np.array([[_value_column(i, j) for j in range(BASIS)] for i in range(BASIS)])
_GRADIENT = {pair: _gradient_terms(*pair) for pair in _PAIRS}
_GRAM = np.array([[_mean_product(i, j) for j in range(BASIS)] for i in range(BASIS)])


def fit_vertices(
    moments: FloatArray, prior: FloatArray, lam: FloatArray | float, mu: FloatArray | float
) -> FloatArray:
    """Fit one quadric per vertex to the points around it.

    Parameters
    ----------
    moments : ndarray of float64, shape (v, 44)
        Of the points in the eight cells around each vertex, about it (see `moments`);
        column 0 is their number n, at least 1.
    prior : ndarray of float64, shape (v, 10)
        The parents' quadrics, as `inherit_level` gives them.
    lam : float, or ndarray of float64, shape (v,)
        Weight of the normals against the positions, dimensionless.
    mu : float, or ndarray of float64, shape (v,)
        Weight of the prior in points, dimensionless.

    Returns
    -------
    ndarray of float64, shape (v, 10)
        Coefficients c that minimise
        [sum f^2 + lam sum |grad f - normal|^2 + mu mean (f - prior)^2] / n + 1e-9 |c|^2.

    Notes
    -----
    Order of operations for each vertex: the lower triangle of A = ((M + lam G) + mu P) (1/n),
    plus 1e-9 on the diagonal; L D L^T by columns, subtracting earlier columns in their order;
    forward and backward substitution likewise. No row depends on another one.
    """
    coefficients = np.empty_like(prior)
    lam, mu = np.broadcast_to(lam, len(prior)), np.broadcast_to(mu, len(prior))
    for start in range(0, len(moments), _CHUNK_ROWS):
        rows = slice(start, start + _CHUNK_ROWS)
        columns = np.ascontiguousarray(moments[rows].T)  # (44, v): vertices are the lanes
        priors = np.ascontiguousarray(prior[rows].T)  # (10, v)
        matrix, right = _normal_equations(columns, priors, lam[rows], mu[rows])
        coefficients[rows] = _solve_cholesky(matrix, right).T
    return coefficients


def _normal_equations(
    columns: FloatArray, prior: FloatArray, lam: FloatArray, mu: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the lower triangles (10, 10, v) and the right sides (10, v)."""
    inverse = 1.0 / columns[0]  # (v,): a mean over the points, whatever their number
    matrix = np.zeros((BASIS, BASIS, columns.shape[1]))
    right = np.zeros((BASIS, columns.shape[1]))
    # The positions ask for f = 0, and add nothing here; the constant has no gradient.
    right[1:] = lam * columns[MONOMIALS:]
    for i, j in _PAIRS:
        entry = columns[_VALUE[i, j]].copy()  # (v,): sum phi_i phi_j
        for factor, column in _GRADIENT[i, j]:
            entry += (lam * factor) * columns[column]  # of the gradients
        entry += mu * _GRAM[i, j]
        matrix[i, j] = entry * inverse
    for i in range(BASIS):
        matrix[i, i] += _RIDGE
        # mu P times the prior; of P most entries are 0 by symmetry.
        for j in np.flatnonzero(_GRAM[i]).tolist():
            right[i] += (mu * _GRAM[i, j]) * prior[j]
    right *= inverse
    return matrix, right


def _solve_cholesky(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve the systems by L D L^T, in place; lower triangles, the last axis the systems."""
    # Column j of L below its diagonal of ones; D stays on the matrix's diagonal.
    for j in range(BASIS):
        column = matrix[j + 1 :, j] / matrix[j, j]
        for k in range(j + 1, BASIS):
            matrix[k:, k] -= column[k - j - 1 :] * matrix[k, j]
        right[j + 1 :] -= column * right[j]
        matrix[j + 1 :, j] = column
    for j in range(BASIS):  # `right` is L^-1 b: divided by D,
        right[j] /= matrix[j, j]
    # and solved for L^T from the last coefficient up.
    for j in range(BASIS - 1, -1, -1):
        right[:j] -= matrix[j, :j] * right[j]
    return right


def evaluate_residuals(moments: FloatArray, coefficients: FloatArray | Float32Array) -> FloatArray:
    """Return the sum of f^2 over the points of each vertex.

    Parameters
    ----------
    moments : ndarray of float64, shape (v, 44)
    coefficients : ndarray of float64 or float32, shape (v, 10)

    Returns
    -------
    ndarray of float64, shape (v,)
        In cells squared, never negative.
    """
    coefficients = coefficients.astype(np.float64, copy=False)
    total = np.zeros(len(moments))
    for i, j in _PAIRS:
        double = 1.0 if i == j else 2.0
        total += double * coefficients[:, i] * coefficients[:, j] * moments[:, _VALUE[i, j]]
    return np.maximum(total, 0.0)


def evaluate_slopes(moments: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Return the sum of |grad f|^2 over the points of each vertex.

    Parameters
    ----------
    moments : ndarray of float64, shape (v, 44)
    coefficients : ndarray of float64, shape (v, 10)

    Returns
    -------
    ndarray of float64, shape (v,)
        Dimensionless.
    """
    total = np.zeros(len(moments))
    for i, j in _PAIRS:
        product = (1.0 if i == j else 2.0) * coefficients[:, i] * coefficients[:, j]
        for factor, column in _GRADIENT[i, j]:
            total += factor * product * moments[:, column]
    return total


def _mean_squares(moments: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Return the mean squared distances of the points from the quadrics' surfaces."""
    slopes = np.maximum(evaluate_slopes(moments, coefficients), _LEAST_SLOPE * moments[:, 0])
    return evaluate_residuals(moments, coefficients) / slopes


def residual_variances(moments: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Tell the noise of the points from what a fit leaves over.

    Parameters
    ----------
    moments : ndarray of float64, shape (v, 44)
    coefficients : ndarray of float64, shape (v, 10)
        Fitted to these points.

    Returns
    -------
    ndarray of float64, shape (v,)
        sum f^2 / (mean |grad f|^2) / (n - 10), in cells squared; NaN where n < 24.
    """
    counts = moments[:, 0]
    rich = counts >= _LEAST_POINTS
    unbiased = counts / np.where(rich, counts - BASIS, 1.0)
    return np.where(rich, _mean_squares(moments, coefficients) * unbiased, np.nan)


def evaluate_misfits(moments: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Tell how far the gradients of quadrics are off the normals of their points.

    Parameters
    ----------
    moments : ndarray of float64, shape (v, 44)
    coefficients : ndarray of float64, shape (v, 10)

    Returns
    -------
    ndarray of float64, shape (v,)
        Mean |grad f - normal|^2: 0 where they agree, about 1 where the points lie on two sheets
        whose normals oppose each other. Never negative.
    """
    along = np.zeros(len(moments))
    for i in range(1, BASIS):
        along += coefficients[:, i] * moments[:, MONOMIALS + i - 1]
    slopes = evaluate_slopes(moments, coefficients)
    return np.maximum((slopes - 2.0 * along) / moments[:, 0] + 1.0, 0.0)


def weigh_priors(
    moments: FloatArray,
    prior: FloatArray,
    noise: FloatArray,
    lam: FloatArray | float,
    least: float,
    most: float,
) -> FloatArray:
    """Weigh each prior by how well it explains the points: empirical Bayes.

    Parameters
    ----------
    moments : ndarray of float64, shape (v, 44)
    prior : ndarray of float64, shape (v, 10)
    noise : ndarray of float64, shape (v,)
        Variance of the positions along the normals, in cells squared, told from further up.
    lam : float, or ndarray of float64, shape (v,)
        Weight of the normals, see `fit_vertices`.
    least, most : float
        Between which the weight lies, in points.

    Returns
    -------
    ndarray of float64, shape (v,)
        mu of `fit_vertices`.

    Notes
    -----
    Where points are many, a fit of their own is the judge: both are measured at the same points,
    whose noise cancels, and what it gains beyond chance is the prior's error. Its residuals tell
    the noise, too. Where points are few, their mean squared distance from the prior's surface,
    sum f^2 / sum |grad f|^2, is the noise plus the prior's own variance.

    Where no more than chance is left for that, the prior is kept: it averages over many more
    points. Where it misses them, the points win. The weight goes by the ratio of the variances: a
    prior counts like so many points.
    """
    counts, lam = moments[:, 0], np.broadcast_to(lam, len(moments))
    # (v,): how far the points lie from the prior, of which the noise and its chance are no error.
    missed = _mean_squares(moments, prior)
    scale = noise.copy()
    excess = missed - noise * (1.0 + np.sqrt(2.0 / counts))
    rich = np.flatnonzero(counts >= _LEAST_POINTS)
    if len(rich):
        many = counts[rich]
        # (r, 10): what the points alone would have, and the noise by what that leaves over, held
        # to what is known from further up as by so many points more.
        fitted = fit_vertices(moments[rich], prior[rich], lam[rich], least)
        missed_by_fit = _mean_squares(moments[rich], fitted)
        own_noise = (missed_by_fit * many + _TOLD_POINTS * noise[rich]) / (
            many - BASIS + _TOLD_POINTS
        )
        excess[rich] = missed[rich] - missed_by_fit - own_noise * (_CHANCE_GAIN / many)
        scale[rich] = _OWN_WEIGHT * own_noise
    weights: FloatArray = np.clip(scale / np.maximum(excess, _LEAST_EXCESS), least, most)
    return weights


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
