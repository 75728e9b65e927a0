"""How much each point counts, by how far it lies from what its surroundings agree upon.

Noise of a Gaussian kind is best averaged. Where residuals have heavier tails, as those of scans
that do not match, or of points that are none, the mean follows the tails: a fit by Student's t
distribution, whose points weigh 1 / (1 + r^2 / (tolerance variance)), follows the many instead.

References
----------
K. L. Lange, R. J. A. Little, J. M. G. Taylor, Robust statistical modeling using the t distribution,
J. Am. Stat. Assoc. 84 (1989).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.field.cell_points import SortedPoints
from hpcapp.geometry.lattice import ancestor_keys, number_keys
from hpcapp.geometry.points import Float32Array, FloatArray, IntArray
from hpcapp.kernels.parallel import run_batches
from hpccomponent.cutting import cut_equal

Blend = tuple[IntArray, Float32Array, Float32Array]
"""Vertices, quadrics and variances of a level, as `rate_points` takes them."""


_CELLS_AT_ONCE = 1 << 14
_BLOCK = 2  # cells of 2^2 along each side share a variance
_LEAST_POINTS = 60  # in such a block
_GAUSSIAN = 4.3  # what scans have that differ by the angle of view, and small ones by chance
_LEAST_TOLERANCE, _TO_TOLERANCE = 2.0, 4.0


def measure_points(
    cells: IntArray, points: SortedPoints, part: slice, depth: int, blend: Blend
) -> FloatArray:
    """Return how far points in a run of cells lie from a blend: squared, in variances, (n,).

    `cells` (c,) are sorted keys of the finest cells; `depth` levels further up is the one that is
    blended (see `rate_points`).
    """
    local, _, offsets = points.place(part)
    given = local, offsets, cells[part], depth, *blend
    return kernels.rate_points(*given)


def weigh_points(
    cells: IntArray, points: SortedPoints, blend: Blend, tolerance: float, threads: int = 1
) -> SortedPoints:
    """Weigh the points of the finest cells, sorted keys (c,), by the quadrics of the level above.

    A point that lies `tolerance` off, in variances, counts half.
    """
    weights = np.empty(len(points.held))

    def weigh(part: slice) -> None:
        squares = measure_points(cells, points, part, 1, blend)
        rows = slice(int(points.offsets[part.start]), int(points.offsets[part.stop]))
        weights[rows] = 1.0 / (1.0 + squares / tolerance)

    parts = max(threads, -(-len(cells) // _CELLS_AT_ONCE))
    run_batches(weigh, cut_equal(len(cells), parts), threads)
    return replace(points, weights=weights)


def tell_kurtosis(squares: FloatArray, cells: IntArray, offsets: IntArray) -> float:
    """Return the kurtosis of residuals whose variance differs from place to place.

    `squares` (n,) are squared residuals: cell i of the sorted keys (c,) has those from offsets[i]
    to offsets[i + 1]. It is 3 of Gaussian ones, and where there are too few points to tell.
    """
    # (n,): the block of each point; then, of each block, how many, sum r^2 and sum r^4.
    blocks = number_keys(ancestor_keys(cells, _BLOCK))[1]
    owners = np.repeat(blocks, np.diff(offsets))
    counts = np.bincount(owners)
    second = np.bincount(owners, squares)
    fourth = np.bincount(owners, squares * squares)
    rich = (counts >= _LEAST_POINTS) & (second > 0.0)
    if not rich.any():
        return 3.0
    # n r^4 / (r^2)^2 of each block, times its n: the mean over all points.
    sums = fourth[rich] * (counts[rich] / second[rich]) ** 2
    return float(sums.sum() / counts[rich].sum())


def find_tolerance(kurtosis: float) -> float:
    """Return how far off a point may lie until it counts half, by the kurtosis of the residuals.

    It is in variances, and infinite where all points count alike.

    Student's t distribution with d degrees of freedom has a kurtosis of 3 + 6 / (d - 4), and d - 2
    times its variance is where a point counts half. What scanners leave anyway stands for the 3,
    and 4 for the 6, so that few points decide where tails are moderate.
    """
    if kurtosis <= _GAUSSIAN:
        return np.inf
    return _LEAST_TOLERANCE + _TO_TOLERANCE / (kurtosis - _GAUSSIAN)
