"""The implicit function at the nodes of bricks: levels of quadrics, far field behind them.

A brick has 8^3 cells of the evaluation grid and 9^3 nodes; it shares the outer ones with its
neighbours. The value of a node is a function of the node's index alone, in a fixed order of
operations, and is rounded to float32: bricks agree on what they share, and workers on everything.
"""

from __future__ import annotations

import numpy as np

from hpccomponent.surface.kernels.portable.blending import (
    blend_quadrics,
    cross_axes,
    interpolate_far,
    needed_layers,
)
from hpccomponent.surface.kernels.portable.features import blend_features
from hpccomponent.surface.types.field import Field
from hpccomponent.surface.types.grid import BRICK, NODES, Grid
from hpccomponent.surface.types.lattice import find_keys, pack_places
from hpccomponent.surface.types.points import Float32Array, FloatArray, IntArray

__all__ = ["evaluate_bricks"]

_CHUNK_NODES = 1 << 17


_LEAST_REST = 1e-6  # what is left to the levels behind is 0 below this, and they are not asked


_TINY = np.float32(1e-30)


def evaluate_bricks(field: Field, grid: Grid, places: IntArray, threads: int = 1) -> Float32Array:
    """Evaluate the implicit function at all nodes of some bricks.

    Parameters
    ----------
    field : Field
    grid : Grid
    places : ndarray of int64, shape (b, 3)
        Which bricks.

    Returns
    -------
    ndarray of float32, shape (b, 9, 9, 9)
        In cells of the finest lattice, positive outside, never 0; the outermost nodes of
        the grid are positive, so that every surface closes inside it.

    Notes
    -----
    Front to back, as transparent layers are composed: F = sum of rest_d t_d f_d + rest far, with
    f_d the quadrics of level d blended, t_d their trust, and rest_d the product of 1 - t over the
    levels in front. So coarse levels fill in where the points are too far apart for fine ones.
    """
    del threads  # numpy runs on one
    values = np.empty((len(places), NODES, NODES, NODES), np.float32)
    reach = BRICK * grid.step / field.cell_size
    layers = min(2 * NODES, int(reach) + 3)
    chunk = max(1, _CHUNK_NODES // max(NODES * layers**2, NODES**3))
    channels = [level.channels() for level in field.levels]
    for start in range(0, len(places), chunk):
        rows = slice(start, start + chunk)
        values[rows] = _evaluate_chunk(field, channels, grid, places[rows])
    return values


def _evaluate_chunk(
    field: Field, channels: list[FloatArray], grid: Grid, places: IntArray
) -> Float32Array:
    """Evaluate a few bricks."""
    nodes = BRICK * places.T[:, :, None] + np.arange(NODES)
    total, rest = np.zeros((len(places), *[NODES] * 3)), np.ones((len(places), *[NODES] * 3))
    for depth, level in enumerate(field.levels):
        scale = 2.0**depth
        lower, local = _locate(nodes, grid, field.origin, field.cell_size * scale)
        layers, lower = needed_layers(lower)
        corners = np.stack(np.broadcast_arrays(*cross_axes(layers)), axis=-1)
        keys = pack_places(corners)
        rows = find_keys(level.keys, keys)
        quadric, presence, trust = blend_quadrics(channels[depth], rows, lower, local)
        if depth == 0 and field.features is not None:
            given = channels[depth], rows, keys, lower, local
            quadric += blend_features(field.features, *given)
        near = scale * quadric / np.where(presence > 0.0, presence, 1.0)
        total += rest * trust * near
        rest *= 1.0 - trust
        rest[rest < _LEAST_REST] = 0.0
    far_lower, far_local = _locate(nodes, grid, field.far.origin, field.far.step)
    total += rest * (interpolate_far(field.far.values, far_lower, far_local) / field.cell_size)
    return _settle_signs(total.astype(np.float32), nodes, grid)


def _settle_signs(values: Float32Array, nodes: IntArray, grid: Grid) -> Float32Array:
    """Move zeros off the surface, and the outermost nodes outside."""
    values[values == 0.0] = _TINY
    last = BRICK * np.array(grid.bricks)[:, None, None]
    x, y, z = cross_axes((nodes == 0) | (nodes == last))
    return np.where(x | y | z, np.abs(values), values)


def _locate(
    nodes: IntArray, grid: Grid, origin: FloatArray, size: float
) -> tuple[IntArray, FloatArray]:
    """Return the cell of a lattice that each node coordinate lies in, and where in it (0 to 1).

    All of shape (3, b, 9). The result depends on the node's index only, never on its brick.
    """
    offset = (grid.origin - origin)[:, None, None]
    coordinates = (nodes * grid.step + offset) / size
    lower = np.floor(coordinates)
    return lower.astype(np.int64), coordinates - lower
