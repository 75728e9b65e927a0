"""What joined quadrics differ by from the one quadric of their vertex (see `features`)."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.lattice import find_keys
from hpcapp.geometry.points import ByteArray, FloatArray, IntArray
from hpcapp.kernels.constants import BASIS
from hpcapp.kernels.types.field import Features


def blend_features(
    features: Features,
    channels: FloatArray,
    rows: IntArray,
    keys: IntArray,
    lower: IntArray,
    local: FloatArray,
) -> FloatArray:
    """Blend what joined quadrics differ by from the one quadric of their vertex.

    `keys` (b, k, k, k) are those of the vertices around each brick, other arrays as for
    `blend_quadrics`. Return what is to be added to the weighted sums of the quadrics, (b, n, n, n).
    """
    sums = np.zeros((len(rows), *[local.shape[2]] * 3))
    # (b, k, k, k): where the vertices stand among the features; then one after the other.
    at = find_keys(features.keys, keys)
    brick, *layers = np.nonzero((at < len(features.keys)) & (rows < channels.shape[1] - 1))
    smooth = local * local * (3.0 - 2.0 * local)
    for number, place in enumerate(zip(brick, *layers, strict=True)):
        b = brick[number]
        # Three of (n,) each: the vertex's weight at the nodes along an axis, 0 beyond a cell, and
        # where they lie as seen from it, in cells.
        weights, heights = [], []
        for axis in range(3):
            above = place[1 + axis] - lower[axis, b]
            w, t = smooth[axis, b], local[axis, b]
            weights.append(np.where(above == 0, 1.0 - w, np.where(above == 1, w, 0.0)))
            heights.append(np.where(above == 1, t - 1.0, t))
        nodes = np.ix_(*(np.flatnonzero(w) for w in weights))
        share = weights[0][nodes[0]] * weights[1][nodes[1]] * weights[2][nodes[2]]
        x, y, z = (height[node] for height, node in zip(heights, nodes, strict=True))
        basis = np.stack(
            np.broadcast_arrays(1.0, x, y, z, x * x, y * y, z * z, x * y, y * z, z * x)
        )
        row = at[place]
        # (3, nodes): the pieces; their joint takes the place of the vertex's own quadric.
        values = np.tensordot(features.pieces[row].astype(np.float64), basis, 1)
        joined = join_pieces(values[0], values[1], values[2], np.array(features.joints[row]))
        smooth_value = np.tensordot(channels[:BASIS, rows[place]], basis, 1)
        sums[(b, *nodes)] += share * (joined - smooth_value)
    return sums


def join_pieces(
    a: FloatArray, b: FloatArray, c: FloatArray, joints: IntArray | ByteArray
) -> FloatArray:
    """Join three values by max or min (see `types.field.Features`)."""
    inner = np.where(joints & 2, np.minimum(b, c), np.maximum(b, c))
    joined: FloatArray = np.where(joints & 1, np.minimum(a, inner), np.maximum(a, inner))
    return joined
