"""How much each point counts, by how far it lies from what its surroundings agree upon.

Noise of a Gaussian kind is best averaged. Where residuals have heavier tails, as those of scans
that do not match, or of points that are none, the mean follows the tails: a fit by Student's t
distribution, whose points weigh 1 / (1 + r^2 / (tolerance variance)), follows the many instead.

Who may import it: the pyramid, the estimates and the tests.

References
----------
K. L. Lange, R. J. A. Little, J. M. G. Taylor, Robust statistical modeling using the t distribution,
J. Am. Stat. Assoc. 84 (1989).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpccomponent.cutting import cut_equal
from hpccomponent.surface.build import load_native
from hpccomponent.surface.fitting.cell_points import SortedPoints
from hpccomponent.surface.kernels.parallel import run_batches
from hpccomponent.surface.types.lattice import (
    OCTANTS,
    ancestor_keys,
    find_keys,
    number_keys,
    pack_places,
    step_keys,
    unpack_keys,
)
from hpccomponent.surface.types.points import FloatArray, IntArray

__all__ = ["find_tolerance", "measure_points", "rate_points", "tell_kurtosis", "weigh_points"]

Float32Array = NDArray[np.float32]
Blend = tuple[IntArray, Float32Array, Float32Array]
"""Vertices, quadrics and variances of a level, as `rate_points` takes them."""

_native: Any = load_native()

_LEAST_SLOPE = 0.04  # of a squared gradient, which is about 1
_LEAST_VARIANCE = 1e-12
_CELLS_AT_ONCE = 1 << 14
_BLOCK = 2  # cells of 2^2 along each side share a variance
_LEAST_POINTS = 60  # in such a block
_GAUSSIAN = 4.3  # what scans have that differ by the angle of view, and small ones by chance
_LEAST_TOLERANCE, _TO_TOLERANCE = 2.0, 4.0


def rate_points(
    local: FloatArray,
    offsets: IntArray,
    cells: IntArray,
    depth: int,
    corners: IntArray,
    coefficients: Float32Array,
    variances: Float32Array,
) -> FloatArray:
    """Return how far points lie from the blend of a level's quadrics: squares, in variances.

    Parameters
    ----------
    local : ndarray of float64, shape (n, 3)
        Positions relative to the centre of the point's cell, in these cells; sorted by cell.
    offsets : ndarray of int64, shape (c + 1,)
        Cell i holds the points offsets[i] to offsets[i + 1].
    cells : ndarray of int64, shape (c,)
        Sorted keys.
    depth : int
        So many levels further up is the level that is blended.
    corners : ndarray of int64, shape (v,)
        Sorted keys of its vertices.
    coefficients : ndarray of float32, shape (v, 10)
    variances : ndarray of float32, shape (v,)
        In cells of that level squared.

    Returns
    -------
    ndarray of float64, shape (n,)
        0 where a corner is missing.
    """
    places = unpack_keys(cells)
    above, within = pack_places(places >> depth), places & ((1 << depth) - 1)
    owners = np.repeat(np.arange(len(cells)), np.diff(offsets))
    t = (within[owners] + local + 0.5) / (1 << depth)
    smooth = t * t * (3.0 - 2.0 * t)
    value, variance = np.zeros((2, len(local)))
    slope = np.zeros((len(local), 3))
    known = np.ones(len(local), np.bool_)
    for octant in OCTANTS:
        rows = find_keys(corners, step_keys(above, octant))[owners]
        known &= rows < len(corners)
        rows = np.where(rows < len(corners), rows, 0)
        share = np.where(octant == 1, smooth, 1.0 - smooth).prod(axis=1)
        x, y, z = (t - octant).T
        c = coefficients[rows].T.astype(np.float64)
        along_x = c[1] + 2.0 * c[4] * x + c[7] * y + c[9] * z
        along_y = c[2] + 2.0 * c[5] * y + c[7] * x + c[8] * z
        along_z = c[3] + 2.0 * c[6] * z + c[8] * y + c[9] * x
        # 2 f = 2 c0 + linear part + u . grad f
        linear = c[1] * x + c[2] * y + c[3] * z
        value += share * (c[0] + 0.5 * (linear + along_x * x + along_y * y + along_z * z))
        slope += share[:, None] * np.stack([along_x, along_y, along_z], axis=1)
        variance += share * variances[rows]
    steep = np.maximum((slope * slope).sum(axis=1), _LEAST_SLOPE)
    squares: FloatArray = value * value / (steep * np.maximum(variance, _LEAST_VARIANCE))
    return np.where(known, squares, 0.0)


def measure_points(
    cells: IntArray, points: SortedPoints, part: slice, depth: int, blend: Blend
) -> FloatArray:
    """Return `rate_points` of a run of cells, by the build that was chosen (see `kernels`)."""
    local, _, offsets = points.place(part)
    given = local, offsets, cells[part], depth, *blend
    squares: FloatArray = rate_points(*given) if _native is None else _native.rate_points(*given, 1)
    return squares


def weigh_points(
    cells: IntArray, points: SortedPoints, blend: Blend, tolerance: float, threads: int = 1
) -> SortedPoints:
    """Weigh the points of the finest level by the quadrics of the level above it.

    Parameters
    ----------
    cells : ndarray of int64, shape (c,)
        Sorted keys of the finest cells.
    points : SortedPoints
        In these.
    blend : tuple
        See `Blend`; of the level above.
    tolerance : float
        In variances: a point that lies so far off counts half.
    threads : int
        The result does not depend on it.

    Returns
    -------
    SortedPoints
    """
    weights = np.empty(len(points.held))

    def weigh(part: slice) -> None:
        squares = measure_points(cells, points, part, 1, blend)
        own = slice(int(points.offsets[part.start]), int(points.offsets[part.stop]))
        weights[own] = 1.0 / (1.0 + squares / tolerance)

    parts = max(threads, -(-len(cells) // _CELLS_AT_ONCE))
    run_batches(weigh, cut_equal(len(cells), parts), threads)
    return replace(points, weights=weights)


def tell_kurtosis(squares: FloatArray, cells: IntArray, offsets: IntArray) -> float:
    """Return the kurtosis of residuals whose variance differs from place to place.

    Parameters
    ----------
    squares : ndarray of float64, shape (n,)
        Squared residuals, sorted by cell.
    cells : ndarray of int64, shape (c,)
        Sorted keys.
    offsets : ndarray of int64, shape (c + 1,)
        Cell i holds the points offsets[i] to offsets[i + 1].

    Returns
    -------
    float
        3 of Gaussian ones, and where there are too few points to tell.
    """
    blocks = number_keys(ancestor_keys(cells, _BLOCK))[1]
    owners = np.repeat(blocks, np.diff(offsets))
    counts = np.bincount(owners)
    second = np.bincount(owners, squares)
    fourth = np.bincount(owners, squares * squares)
    rich = (counts >= _LEAST_POINTS) & (second > 0.0)
    if not rich.any():
        return 3.0
    sums = fourth[rich] * (counts[rich] / second[rich]) ** 2
    return float(sums.sum() / counts[rich].sum())


def find_tolerance(kurtosis: float) -> float:
    """Return how far off a point may lie until it counts half, in variances.

    Parameters
    ----------
    kurtosis : float
        Of the residuals.

    Notes
    -----
    Student's t distribution with d degrees of freedom has a kurtosis of 3 + 6 / (d - 4), and d - 2
    times its variance is where a point counts half. What scanners leave anyway stands for the 3,
    and 4 for the 6, so that few points decide where tails are moderate.
    """
    if kurtosis <= _GAUSSIAN:
        return np.inf
    return _LEAST_TOLERANCE + _TO_TOLERANCE / (kurtosis - _GAUSSIAN)
