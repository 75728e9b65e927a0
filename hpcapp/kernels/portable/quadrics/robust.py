"""How far points lie from the blend of a level's quadrics."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.lattice import OCTANTS, find_keys, pack_places, step_keys, unpack_keys
from hpcapp.geometry.points import Float32Array, FloatArray, IntArray

__all__ = ["rate_points"]

_LEAST_SLOPE = 0.04  # of a squared gradient, which is about 1


_LEAST_VARIANCE = 1e-12


def rate_points(
    local: FloatArray,
    offsets: IntArray,
    cells: IntArray,
    depth: int,
    corners: IntArray,
    coefficients: Float32Array,
    variances: Float32Array,
) -> FloatArray:
    """Return how far points lie from the blend of a level's quadrics: squares, in variances, (n,).

    0 where a corner is missing. `local` (n, 3) is relative to the centre of the point's cell, in
    these cells: sorted keys (c,), of which cell i holds the points offsets[i] to offsets[i + 1], by
    `offsets` (c + 1,). The level that is blended is `depth` levels further up: its vertices have
    sorted keys (v,), coefficients (v, 10) and variances (v,), in cells of that level squared.
    """
    places = unpack_keys(cells)
    # (c,) and (c, 3): the coarse cell that each fine one lies in, and which of its fine cells.
    above, within = pack_places(places >> depth), places & ((1 << depth) - 1)
    owners = np.repeat(np.arange(len(cells)), np.diff(offsets))
    t = (within[owners] + local + 0.5) / (1 << depth)  # (n, 3): in the coarse cell, 0 to 1
    smooth = t * t * (3.0 - 2.0 * t)
    value, variance = np.zeros((2, len(local)))
    slope = np.zeros((len(local), 3))
    known = np.ones(len(local), np.bool_)
    for octant in OCTANTS:
        rows = find_keys(corners, step_keys(above, octant))[owners]
        known &= rows < len(corners)
        rows = np.where(rows < len(corners), rows, 0)
        # (n,): the weight of this corner, and what its quadric and its slope are at the point.
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
