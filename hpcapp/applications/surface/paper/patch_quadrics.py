"""The paper's fit: one quadric for each patch, the smallest eigenvector of D^T D.

A quadric is ten coefficients over the basis ``[1, x, y, z, xx, yy, zz, xy, yz, xz]``, in patch
coordinates ``u = (position - center) / scale``. Its implicit function is negative inside. Who may
import it: workers (through the task `fit_patches`) and the method ``paper``.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.points import FloatArray, IntArray
from hpccomponent.errors import InputError
from hpccomponent.protocol.columns import Bounds, Column
from hpccomponent.protocol.declared import Declared
from hpccomponent.runtime.tasks import declare

#: Exponents of x, y and z in each element of the basis.
EXPONENTS = np.vstack(
    [[(0, 0, 0)], np.eye(3, dtype=int), np.diag([2, 2, 2]), [(1, 1, 0), (0, 1, 1), (1, 0, 1)]]
)
#: What the columns of D are multiplied by: in the symmetric 4 x 4 matrix of a quadric the linear
#: and mixed coefficients stand twice, so a unit norm of that matrix counts their squares double.
COLUMN_WEIGHTS = {
    "consistent": np.sqrt([1.0, 2.0, 2.0, 2.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0]),
    "printed": np.ones(10),
}
#: Fewer points leave every quadric through them undecided, and a plane is fitted instead.
FEWEST_POINTS = 10
#: Points that are summed at once.
CHUNK = 16_384
#: Eigenvalues up to this fraction of the largest are zero but for rounding.
ZERO_EIGENVALUE = 1e-14

_ROUNDING = 1e-6  # of a length that is 1

Quadrics = Annotated[FloatArray, Column("p", 10)]
"""Coefficients of p patches, as of the module."""


def fitted_patches(
    _positions: FloatArray,
    normals: FloatArray,
    offsets: IntArray,
    _centers: FloatArray,
    scales: FloatArray,
    norm: str = "consistent",
) -> Declared:
    """Return the pattern of what `fit_patches` returns: quadrics of unit length."""

    def agrees(coefficients: FloatArray) -> bool:
        lengths = np.linalg.norm(coefficients / COLUMN_WEIGHTS[norm], axis=1)
        filled = np.flatnonzero(np.diff(offsets))
        has_side = normals[offsets[filled]].any(axis=1)  # else normals may leave a plane none
        is_unit = np.abs(lengths - 1.0) <= _ROUNDING
        is_fitted = is_unit[filled] | (~has_side & (lengths[filled] == 0.0))
        return bool(is_fitted.all()) and not coefficients[np.diff(offsets) == 0].any()

    rule = "quadrics have unit length where there are points, else none"
    return Bounds(agrees=agrees, rule=rule).of(Quadrics, {"p": len(scales)})


@declare(
    result=fitted_patches,
    limit=lambda _positions, _normals, _offsets, _centers, scales, *_: 4096 + 80 * len(scales),
)
def fit_patches(
    positions: FloatArray,
    normals: FloatArray,
    offsets: IntArray,
    centers: FloatArray,
    scales: FloatArray,
    norm: str = "consistent",
) -> Quadrics:
    """Fit one quadric to each patch of a batch (a task): coefficients (p, 10) in patch coordinates.

    They are dimensionless; the gradient looks along the normals. InputError where shapes do not fit
    each other, values are NaN or infinite, scales are not positive, or the norm is unknown.

    Parameters
    ----------
    positions, normals : ndarray of float64, shape (n, 3)
        The patches' points, patch after patch; in length units of the input, and unit length.
    offsets : ndarray of int64, shape (p + 1,)
        Patch i holds the points from ``offsets[i]`` to ``offsets[i + 1]``; from 0 to n.
    centers : ndarray of float64, shape (p, 3)
        Origins of the patch coordinates.
    scales : ndarray of float64, shape (p,)
        Units of the patch coordinates, in length units of the input; positive.
    norm : {"consistent", "printed"}
        Which coefficients have unit length; see Notes.

    Notes
    -----
    The paper minimises ``|D c|^2`` under a constraint that is the Frobenius norm of the quadric's
    symmetric 4 x 4 matrix (its linear and mixed entries stand there twice), yet prints D without
    the factors that belong to it. "printed" takes the smallest eigenvector of its D^T D as the
    coefficients. "consistent" puts sqrt(2) on the linear and mixed columns, so that constraint and
    matrix agree and the fit turns with the points.

    D^T D comes from the 35 monomial moments up to degree 4, summed over each patch's points in
    their order: a patch's coefficients do not depend, to the last bit, on the rest of the batch.

    Where several eigenvalues vanish (coplanar or collinear points; many quadrics hold them all),
    that combination of their eigenvectors is chosen whose gradients are nearest to the normals.
    Patches with fewer than ten points get the plane through their centroid across their mean
    normal (their first normal where these cancel out); an empty patch gets zeros.

    References
    ----------
    Hussein, Mousa, A High Performance of 3D Object Reconstruction in a Cloud Environment, 2015,
    doi:10.15680/ijircce.2015.0306090.

    Examples
    --------
    >>> square = np.array([[x, y, 0.5] for x in (0.0, 1.0) for y in (0.0, 1.0)])
    >>> up = np.tile([0.0, 0.0, 1.0], (4, 1))
    >>> c = fit_patches(square, up, np.array([0, 4]), np.zeros((1, 3)), np.ones(1), "printed")
    >>> (c / c[0, 3]).tolist()
    [[-0.5, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]]
    """
    _check(positions, normals, offsets, centers, scales, norm)
    coefficients, weights = np.zeros((len(scales), 10)), COLUMN_WEIGHTS[norm]
    begin = 0
    while begin < len(scales):
        # Whole patches, about as many points as the caches hold, and one patch at least.
        end = int(np.searchsorted(offsets, offsets[begin] + CHUNK, side="right")) - 1
        end = max(end, begin + 1)
        points, rows = slice(offsets[begin], offsets[end]), slice(begin, end)
        owner = np.repeat(np.arange(begin, end), np.diff(offsets[begin : end + 1]))
        local = (positions[points] - centers[owner]) / scales[owner, None]
        own_offsets = offsets[begin : end + 1] - offsets[begin]
        coefficients[rows] = _fit_chunk(local, normals[points], own_offsets, weights)
        begin = end
    return coefficients


def evaluate_quadrics(coefficients: FloatArray, local: FloatArray) -> FloatArray:
    """Return the algebraic values (n,) of quadrics at points (n, 3) in patch coordinates.

    One quadric (10,), or one for each point, (n, 10). Negative inside; not a distance.
    """
    values: FloatArray = (basis(local) * np.atleast_2d(coefficients)).sum(axis=1)
    return values


def gradient_quadrics(coefficients: FloatArray, local: FloatArray) -> FloatArray:
    """Return the gradients (n, 3) of quadrics with respect to the patch coordinates, looking out.

    One quadric (10,), or one for each point, (n, 10); points (n, 3) in patch coordinates.
    """
    c = np.atleast_2d(coefficients)
    x, y, z = local.T
    return np.stack(
        [
            c[:, 1] + 2.0 * c[:, 4] * x + c[:, 7] * y + c[:, 9] * z,
            c[:, 2] + 2.0 * c[:, 5] * y + c[:, 7] * x + c[:, 8] * z,
            c[:, 3] + 2.0 * c[:, 6] * z + c[:, 8] * y + c[:, 9] * x,
        ],
        axis=1,
    )


def basis(local: FloatArray) -> FloatArray:
    """Return the ten monomials (n, 10) of points (n, 3) in patch coordinates."""
    x, y, z = local.T
    columns = [np.ones_like(x), x, y, z, x * x, y * y, z * z, x * y, y * z, x * z]
    return np.stack(columns, axis=1)


def _check(
    positions: FloatArray,
    normals: FloatArray,
    offsets: IntArray,
    centers: FloatArray,
    scales: FloatArray,
    norm: str,
) -> None:
    if norm not in COLUMN_WEIGHTS:
        raise InputError(f"norm is {norm!r}", "choose consistent or printed")
    n, p = len(positions), len(scales)
    shapes = [x.shape for x in (positions, normals, offsets, centers, scales)]
    if shapes != [(n, 3), (n, 3), (p + 1,), (p, 3), (p,)]:
        raise InputError(
            f"a batch of patches has arrays of the shapes {shapes}",
            "give positions (n, 3), normals (n, 3), offsets (p + 1,), centers (p, 3), scales (p,)",
        )
    if offsets[0] != 0 or offsets[-1] != n or (np.diff(offsets) < 0).any():
        raise InputError(
            "the offsets of a batch of patches do not cut its points into runs",
            f"let them rise from 0 to {n}",
        )
    if not all(np.isfinite(x).all() for x in (positions, normals, centers, scales)):
        raise InputError("a batch of patches holds NaN or infinite values", "drop these points")
    if (scales <= 0.0).any():
        raise InputError("a batch of patches has a scale that is not positive", "check its boxes")


def _index_moments() -> tuple[list[tuple[int, int]], NDArray[np.intp]]:
    """Return a pair of basis elements for each moment, and each pair's moment, shape (10, 10)."""
    pairs: dict[tuple[int, ...], tuple[int, int]] = {}
    for i in range(10):
        for j in range(i, 10):
            pairs.setdefault(tuple(EXPONENTS[i] + EXPONENTS[j]), (i, j))
    number = {exponents: k for k, exponents in enumerate(pairs)}
    table = [[number[tuple(a + b)] for b in EXPONENTS] for a in EXPONENTS]
    return list(pairs.values()), np.array(table, dtype=np.intp)


_MOMENT_PAIRS, _MOMENT_TABLE = _index_moments()


def _index_derivatives() -> FloatArray:
    """Return the basis' derivatives along x, y and z in the basis itself, shape (3, 10, 10)."""
    number = {tuple(exponents): k for k, exponents in enumerate(EXPONENTS)}
    derivatives = np.zeros((3, 10, 10))
    for axis, step in enumerate(np.eye(3, dtype=int)):
        for i in np.flatnonzero(EXPONENTS[:, axis]):
            lowered = number[tuple(EXPONENTS[i] - step)]
            derivatives[axis, i, lowered] = EXPONENTS[i, axis]
    return derivatives


_DERIVATIVES = _index_derivatives()


def _moments(local: FloatArray, first: IntArray) -> FloatArray:
    """Sum the 35 monomials of degree <= 4 over each run of points, shape (p, 35)."""
    columns = np.ascontiguousarray(basis(local).T)
    sums = [np.add.reduceat(columns[i] * columns[j], first) for i, j in _MOMENT_PAIRS]
    return np.stack(sums, axis=1)


def _normal_moments(local: FloatArray, normals: FloatArray, first: IntArray) -> FloatArray:
    """Sum grad phi_i . n over each run of points, shape (p, 10)."""
    x, y, z = local.T
    a, b, c = normals.T
    columns = [a, b, c, 2.0 * x * a, 2.0 * y * b, 2.0 * z * c]
    columns += [y * a + x * b, z * b + y * c, z * a + x * c]
    sums = [np.add.reduceat(np.ascontiguousarray(column), first) for column in columns]
    return np.stack([np.zeros(len(first)), *sums], axis=1)


def _fit_chunk(
    local: FloatArray, normals: FloatArray, offsets: IntArray, weights: FloatArray
) -> FloatArray:
    """Fit one quadric to each run of points that are in patch coordinates already."""
    coefficients = np.zeros((len(offsets) - 1, 10))
    filled = np.flatnonzero(np.diff(offsets))
    if not len(filled):
        return coefficients
    # Empty patches own no point: the others' runs lie side by side without them.
    first, counts = offsets[:-1][filled], np.diff(offsets)[filled]
    moments = _moments(local, first) / counts[:, None]
    slopes = _normal_moments(local, normals, first) / counts[:, None]

    many = counts >= FEWEST_POINTS
    few = ~many
    coefficients[filled[many]] = _fit(moments[many], slopes[many], weights)
    coefficients[filled[few]] = _fit_planes(moments[few], slopes[few], normals[first[few]], weights)
    return coefficients


def _fit(moments: FloatArray, slopes: FloatArray, weights: FloatArray) -> FloatArray:
    """Return the oriented smallest eigenvectors of D^T D as coefficients, shape (p, 10)."""
    gram = moments[:, _MOMENT_TABLE] * np.outer(weights, weights)
    values, vectors = np.linalg.eigh(gram)
    fitted = vectors[:, :, 0] * weights
    zeros = (values <= ZERO_EIGENVALUE * values[:, -1:]).sum(axis=1)
    for i in np.flatnonzero(zeros > 1):
        null = vectors[i, :, : zeros[i]] * weights[:, None]
        fitted[i] = _follow_normals(null, moments[i, _MOMENT_TABLE], slopes[i], weights)
    downhill = (fitted * slopes).sum(axis=1) < 0.0
    fitted[downhill] *= -1.0
    return fitted


def _follow_normals(
    null: FloatArray, gram: FloatArray, slopes: FloatArray, weights: FloatArray
) -> FloatArray:
    """Return the vector of the null space whose gradients are nearest to the normals."""
    # Sum of grad phi_i . grad phi_j: from one patch's own moments alone.
    steepness = (_DERIVATIVES @ gram @ _DERIVATIVES.transpose(0, 2, 1)).sum(axis=0)
    a, *_ = np.linalg.lstsq(null.T @ steepness @ null, null.T @ slopes, rcond=1e-10)
    combined: FloatArray = null @ a
    length = float(np.linalg.norm(combined / weights))
    # Normals that lie within a plane of points tell nothing; any of the quadrics will do.
    return combined / length if length > 0.0 else null[:, 0]


def _fit_planes(
    moments: FloatArray, slopes: FloatArray, first_normals: FloatArray, weights: FloatArray
) -> FloatArray:
    """Return planes through the centroids across the mean normals, shape (p, 10)."""
    centroids = moments[:, _MOMENT_TABLE[0, 1:4]]
    mean = slopes[:, 1:4]
    cancelled = np.linalg.norm(mean, axis=1) <= 1e-12
    mean = np.where(cancelled[:, None], first_normals, mean)
    planes = np.zeros((len(moments), 10))
    planes[:, 0] = -(centroids * mean).sum(axis=1)
    planes[:, 1:4] = mean
    length = np.linalg.norm(planes / weights, axis=1, keepdims=True)
    np.divide(planes, length, out=planes, where=length > 0.0)
    return planes
