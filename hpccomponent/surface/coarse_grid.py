"""Samples on a coarse cubic grid in numpy: spreading and interpolating (see `kernels`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.points import FloatArray, IntArray

__all__ = ["sample_grid", "spread_component"]

Float32Array = NDArray[np.float32]


def _corner_weights(places: FloatArray, nodes: int) -> list[tuple[IntArray, FloatArray]]:
    """Return the flat index and the trilinear weight of the eight nodes around each place."""
    lower = np.clip(np.floor(places).astype(np.int64), 0, nodes - 2)
    local = places - lower
    corners = []
    for octant in range(8):
        bits = [octant >> axis & 1 for axis in range(3)]
        factors = [local[:, a] if bit else 1.0 - local[:, a] for a, bit in enumerate(bits)]
        x, y, z = (lower[:, a] + bit for a, bit in enumerate(bits))
        corners.append(((x * nodes + y) * nodes + z, factors[0] * factors[1] * factors[2]))
    return corners


def spread_component(
    places: FloatArray, normals: FloatArray, axis: int, nodes: int
) -> Float32Array:
    """Spread one component of the normals on the eight nodes around each of them.

    Parameters
    ----------
    places : ndarray of float64, shape (n, 3)
        In grid steps from node (0, 0, 0).
    normals : ndarray of float64, shape (n, 3)
    axis : int
        Which component: 0, 1 or 2. One after the other, so that one grid is in memory.
    nodes : int
        Along each side of the grid, g.

    Returns
    -------
    ndarray of float32, shape (g, g, g)
    """
    corners = _corner_weights(places, nodes)
    where = np.concatenate([node for node, _ in corners])
    values = np.concatenate([weights * normals[:, axis] for _, weights in corners])
    grid = np.bincount(where, values, nodes**3)
    return grid.astype(np.float32).reshape(nodes, nodes, nodes)


def sample_grid(values: Float32Array, places: FloatArray) -> FloatArray:
    """Interpolate a grid trilinearly.

    Parameters
    ----------
    values : ndarray of float32, shape (g, g, g)
    places : ndarray of float64, shape (n, 3)
        In grid steps from node (0, 0, 0); beyond the grid its outermost cells are continued.

    Returns
    -------
    ndarray of float64, shape (n,)
    """
    flat = values.reshape(-1)
    total = np.zeros(len(places))
    for nodes, weights in _corner_weights(places, len(values)):
        total += weights * flat[nodes]
    return total
