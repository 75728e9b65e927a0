"""Quadrics fitted to points and their normals at once, each with its parent as prior.

At a vertex of the lattice, in cells from it, f(u) = c . phi(u) with the basis
phi = [1, x, y, z, xx, yy, zz, xy, yz, zx]; f is about a signed distance in cells, positive
outside. The fit needs no eigenvector and no decision on the sign: one 10x10 Cholesky.
"""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.lattice import OCTANTS, find_keys, step_keys
from hpcapp.geometry.points import Float32Array, FloatArray, IntArray
from hpcapp.kernels.constants import BASIS, COLUMNS, MONOMIALS
from hpcapp.kernels.portable.quadrics.moments import EXPONENTS, shift_moments

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

    Return coefficients c (v, 10) that minimise
    [sum f^2 + lam sum |grad f - normal|^2 + mu mean (f - prior)^2] / n + 1e-9 |c|^2.

    `moments` (v, 44) are of the points in the eight cells around each vertex, about it (see
    `moments`); column 0 is their number n, at least 1. `prior` (v, 10) are the parents' quadrics,
    as `inherit_level` gives them. `lam` weighs the normals against the positions, dimensionless,
    and `mu` the prior, in points; each is a number, or (v,).

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
    """Return the sum of f^2 over the points of each vertex, (v,), in cells squared.

    Of moments (v, 44) and coefficients (v, 10); never negative.
    """
    coefficients = coefficients.astype(np.float64, copy=False)
    total = np.zeros(len(moments))
    for i, j in _PAIRS:
        double = 1.0 if i == j else 2.0
        total += double * coefficients[:, i] * coefficients[:, j] * moments[:, _VALUE[i, j]]
    return np.maximum(total, 0.0)


def evaluate_slopes(moments: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Return the sum of |grad f|^2 over the points of each vertex, (v,), dimensionless.

    Of moments (v, 44) and coefficients (v, 10).
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
    """Tell the noise of the points from what a fit to them leaves over, (v,), in cells squared.

    sum f^2 / (mean |grad f|^2) / (n - 10), of moments (v, 44) and coefficients (v, 10); NaN where
    n < 24.
    """
    counts = moments[:, 0]
    rich = counts >= _LEAST_POINTS
    unbiased = counts / np.where(rich, counts - BASIS, 1.0)
    return np.where(rich, _mean_squares(moments, coefficients) * unbiased, np.nan)


def evaluate_misfits(moments: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Tell how far the gradients of quadrics (v, 10) are off the normals of their points, (v,).

    Mean |grad f - normal|^2, by moments (v, 44): 0 where they agree, about 1 where the points lie
    on two sheets whose normals oppose each other. Never negative.
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

    Return mu of `fit_vertices` between `least` and `most`, in points, (v,); moments (v, 44), priors
    (v, 10) and `lam` are as there. `noise` (v,) is the variance of the positions along the normals,
    in cells squared, told from further up.

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
    """Sum the moments (c, 44) of the eight cells around each corner, about it: (t, 44).

    `touched` (t,) are sorted keys of corners, and `cells` (c,) of cells, one at least; those that
    touch none of the corners do not count.
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

    `touched` (t,) are sorted keys of corners, each with a point around it; `cells` (c,) have
    moments (c, 44). Around each corner, `noise` (t,) is the variance of the positions, in cells
    squared; `lam` (t,) weighs the normals, and the weights of the priors (t, 10) lie between
    `least_mu` and `most_mu` (see `fit_vertices` and `weigh_priors`).

    Return the coefficients (t, 10), rounded once, here, by the only one who computes them; the
    number of points around each corner; what the fits leave over, NaN where points are few; and how
    far gradients are off normals, all (t,) (see `residual_variances` and `evaluate_misfits`).
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
