"""Moments of points, what is fitted to them, and how well it fits."""

from __future__ import annotations

from hpccomponent.surface.kernels.native.arrays import floats, integers, native, singles
from hpccomponent.surface.types.points import ByteArray, Float32Array, FloatArray, IntArray

__all__ = [
    "accumulate_moments",
    "corner_moments",
    "evaluate_residuals",
    "fit_corners",
    "fit_features",
    "inherit_level",
    "merge_cells",
    "rate_points",
]


def accumulate_moments(
    local_positions: FloatArray,
    normals: FloatArray,
    offsets: IntArray,
    weights: FloatArray | None = None,
    threads: int = 1,
) -> FloatArray:
    """Sum the moments of the points of each cell (a task)."""
    kernel = native.accumulate_moments if weights is None else native.accumulate_weighted
    weighed = () if weights is None else (floats(weights),)
    points = floats(local_positions), floats(normals), *weighed, integers(offsets)
    result: FloatArray = kernel(*points, threads)
    return result


def merge_cells(cells: IntArray, moments: FloatArray) -> tuple[IntArray, FloatArray]:
    """Sum the moments of each eight children."""
    result: tuple[IntArray, FloatArray] = native.merge_cells(integers(cells), floats(moments))
    return result


def inherit_level(
    vertices: IntArray,
    parents: IntArray,
    coefficients: Float32Array,
    values: Float32Array,
    threads: int = 1,
) -> tuple[Float32Array, Float32Array]:
    """Return the means of the parents' quadrics and values."""
    keys = (integers(vertices), integers(parents))
    of_parents = (singles(coefficients), singles(values))
    result: tuple[Float32Array, Float32Array] = native.inherit_level(*keys, *of_parents, threads)
    return result


def corner_moments(
    touched: IntArray, cells: IntArray, moments: FloatArray, threads: int = 1
) -> FloatArray:
    """Sum the moments of the eight cells around each corner."""
    result: FloatArray = native.corner_moments(
        integers(touched), integers(cells), floats(moments), threads
    )
    return result


def fit_corners(
    touched: IntArray,
    cells: IntArray,
    moments: FloatArray,
    prior: Float32Array,
    noise: Float32Array,
    lam: float,
    least_mu: float,
    most_mu: float,
    threads: int = 1,
) -> tuple[Float32Array, Float32Array, Float32Array, Float32Array]:
    """Fit a quadric to the points around each corner (a task)."""
    weights = (lam, least_mu, most_mu)
    keys = (integers(touched), integers(cells))
    values = (floats(moments), singles(prior), singles(noise))
    result: tuple[Float32Array, Float32Array, Float32Array, Float32Array] = native.fit_corners(
        *keys, *values, *weights, threads
    )
    return result


def fit_features(
    vertices: IntArray,
    cells: IntArray,
    offsets: IntArray,
    local_positions: FloatArray,
    normals: FloatArray,
    noise: float,
    threads: int = 1,
) -> tuple[Float32Array, ByteArray]:
    """Fit joined quadrics around vertices (a task)."""
    keys = (integers(vertices), integers(cells), integers(offsets))
    points = (floats(local_positions), floats(normals))
    result: tuple[Float32Array, ByteArray] = native.fit_features(*keys, *points, noise, threads)
    return result


def evaluate_residuals(moments: FloatArray, coefficients: FloatArray | Float32Array) -> FloatArray:
    """Return the sum of f^2 at each vertex."""
    result: FloatArray = native.evaluate_residuals(floats(moments), floats(coefficients))
    return result


def rate_points(
    local: FloatArray,
    offsets: IntArray,
    cells: IntArray,
    depth: int,
    corners: IntArray,
    coefficients: Float32Array,
    variances: Float32Array,
) -> FloatArray:
    """Return how far points lie from the blend of a level's quadrics."""
    result: FloatArray = native.rate_points(
        local, offsets, cells, depth, corners, coefficients, variances, 1
    )
    return result
