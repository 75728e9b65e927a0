"""The implicit function at the nodes of bricks: levels of quadrics, far field behind them.

A brick has 8^3 cells of the evaluation grid and 9^3 nodes, or, where its stride is longer, some of
these; it shares the outer ones with its neighbours. The value of a node is a function of the node's
index alone, in a fixed order of operations, and is rounded to float32: bricks agree on what they
share, and workers on everything.

Because the nodes of a brick are a product of three rows, each axis is collapsed in turn: the work
per node is a tenth of that of eight corners.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from hpcapp.geometry.lattice import find_keys, pack_places
from hpcapp.geometry.points import BoolArray, Float32Array, FloatArray, IntArray
from hpcapp.kernels.portable.field.feature_blend import blend_features
from hpcapp.kernels.portable.field.strides import fill_missing, finest_shifts, line_shifts
from hpcapp.kernels.types.field import Field
from hpcapp.kernels.types.grid import BRICK, NODES, Grid

__all__ = ["evaluate_bricks"]

Pair = tuple[IntArray, IntArray]
Array = TypeVar("Array", FloatArray, IntArray, BoolArray)

_CHUNK_NODES = 1 << 17
_LEAST_REST = 1e-6  # what is left to the levels behind is 0 below this, and they are not asked
_TINY = 1e-30

HULL_REACH = 16.0
"""Steps: deeper inside, the planes of the hull do not matter to the surface."""


def evaluate_bricks(field: Field, grid: Grid, places: IntArray, threads: int = 1) -> Float32Array:
    """Evaluate the implicit function at all nodes of the bricks `places` (b, 3).

    Return (b, 9, 9, 9), in cells of the finest lattice, positive outside, never 0; the outermost
    nodes of the grid are positive, so that every surface closes inside it. Where strides are
    longer, a place without a node has the value of the next node below it.

    Notes
    -----
    Front to back, as transparent layers are composed: F = sum of rest_d t_d f_d + rest far, with
    f_d the quadrics of level d blended, t_d their trust, and rest_d the product of 1 - t over the
    levels in front. So coarse levels fill in where the points are too far apart for fine ones.
    """
    del threads  # numpy runs on one
    values = np.empty((len(places), NODES, NODES, NODES), np.float32)
    channels = [level.channels() for level in field.levels]
    if grid.strides is None:
        _evaluate_every(field, channels, grid, places, values, 1)
        return values
    shifts = line_shifts(grid, places)
    finest = finest_shifts(shifts)
    for shift in np.unique(finest):
        rows, every = np.flatnonzero(finest == shift), 1 << int(shift)
        some = np.empty((len(rows), *[BRICK // every + 1] * 3), np.float32)
        _evaluate_every(field, channels, grid, places[rows], some, every)
        at = np.arange(0, NODES, every)
        values[np.ix_(rows, at, at, at)] = some
    return fill_missing(values, shifts)


def _evaluate_every(
    field: Field,
    channels: list[FloatArray],
    grid: Grid,
    places: IntArray,
    values: Float32Array,
    every: int,
) -> None:
    """Evaluate every so many nodes along each axis into `values`, a chunk of bricks at a time."""
    # Layers of the finest lattice that a brick touches: they say how many bricks fit the cache.
    reach, count = BRICK * grid.step / field.cell_size, values.shape[1]
    layers = min(2 * count, int(reach) + 3)
    chunk = max(1, _CHUNK_NODES // max(count * layers**2, count**3))
    for start in range(0, len(places), chunk):
        rows = slice(start, start + chunk)
        # (3, b, n): of the whole grid.
        nodes = BRICK * places[rows].T[:, :, None] + np.arange(0, NODES, every)
        values[rows] = _evaluate_chunk(field, channels, grid, nodes)


def _evaluate_chunk(
    field: Field, channels: list[FloatArray], grid: Grid, nodes: IntArray
) -> Float32Array:
    """Evaluate the nodes of a few bricks."""
    shape = nodes.shape[1], *[nodes.shape[2]] * 3
    # (b, n, n, n): what the levels so far amount to, and the share left to those behind them.
    total, rest = np.zeros(shape), np.ones(shape)
    for depth, level in enumerate(field.levels):
        scale = 2.0**depth
        lower, local = _locate(nodes, grid, field.origin, field.cell_size * scale)
        layers, lower = needed_layers(lower)
        # (b, k, k, k, 3): the vertices around each brick, and where they stand in the level.
        corners = np.stack(np.broadcast_arrays(*cross_axes(layers)), axis=-1)
        keys = pack_places(corners)
        rows = find_keys(level.keys, keys)
        quadric, presence, trust = blend_quadrics(channels[depth], rows, lower, local)
        if depth < len(field.features):
            given = channels[depth], rows, keys, lower, local
            quadric += blend_features(field.features[depth], *given)
        # Weights add up to `presence` where vertices are missing; in cells of the finest lattice.
        near = scale * quadric / np.where(presence > 0.0, presence, 1.0)
        total += rest * trust * near
        rest *= 1.0 - trust
        rest[rest < _LEAST_REST] = 0.0
    far_lower, far_local = _locate(nodes, grid, field.far.origin, field.far.step)
    total += rest * (interpolate_far(field.far.values, far_lower, far_local) / field.cell_size)
    _cut_at_hull(total, nodes, field, grid)
    return _settle_signs(total.astype(np.float32), nodes, grid)


def _cut_at_hull(total: FloatArray, nodes: IntArray, field: Field, grid: Grid) -> None:
    """Move what lies beyond a plane of the hull outside."""
    x, y, z = cross_axes(grid.origin[:, None, None] + nodes * grid.step)
    least = -HULL_REACH * grid.step / field.cell_size
    for a, b, c, distance in field.far.hull.tolist():
        beyond = (a * x + b * y + c * z - distance) / field.cell_size
        np.maximum(total, beyond, out=total, where=beyond > least)


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

    All of shape (3, b, n). The result depends on the node's index only, never on its brick.
    """
    offset = (grid.origin - origin)[:, None, None]
    coordinates = (nodes * grid.step + offset) / size
    lower = np.floor(coordinates)
    return lower.astype(np.int64), coordinates - lower


def cross_axes(per_axis: Array) -> tuple[Array, Array, Array]:
    """Reshape one row per brick and axis, (3, b, k), so that the three broadcast to a block.

    Return x, y and z of shapes (b, k, 1, 1), (b, 1, k, 1) and (b, 1, 1, k).
    """
    x, y, z = per_axis
    return x[:, :, None, None], y[:, None, :, None], z[:, None, None, :]


def needed_layers(lower: IntArray) -> tuple[IntArray, IntArray]:
    """Return the layers of a lattice that each brick needs, and where each node's lower one is.

    Given the layer below each node, (3, b, n), these are (3, b, k), and rows (3, b, n) of them; the
    upper layer is the next row.
    """
    first = lower[:, :, :1]
    span = int((lower - first).max()) + 2
    most = 2 * lower.shape[2]
    if span <= most:
        return first + np.arange(span), lower - first
    # A lattice much finer than the nodes: separate pairs of layers.
    pairs = np.stack([lower, lower + 1], axis=-1).reshape(*lower.shape[:2], most)
    return pairs, np.broadcast_to(np.arange(0, most, 2), lower.shape)


def blend_quadrics(
    channels: FloatArray, rows: IntArray, lower: IntArray, local: FloatArray
) -> FloatArray:
    """Blend the quadrics of the eight vertices around each node, over whole bricks.

    `channels` (12, v + 1) has the ten coefficients, 1, and the trust of each vertex, and a column
    of zeros for a missing one; `rows` (b, k, k, k) are the columns around each brick. Per axis,
    `lower` (3, b, n) is which of the k layers lies below each node, and `local` (3, b, n) the
    height above it, in cells (0 to 1). Return weighted sums (3, b, n, n, n) of the quadrics, of 1,
    and of the trust.

    Notes
    -----
    Weights are products of smoothsteps w = t^2 (3 - 2 t). One axis after the other: quadrics in
    (x, y, z) become quadrics in (y, z), in z, and numbers, each c0 + u (c1 + u c2) times its
    weight, lower plus upper layer. About 20 operations per node instead of 250.
    """
    weight = local * local * (3.0 - 2.0 * local)  # (3, b, n)
    # Channels: 12 of vertices, (12, v + 1); 8 of (b, n, k, k); 5 of (b, n, n, k); 3 of (b, n^3).
    sums = _collapse_axis(channels, _x_index(rows, lower[0]), local[0], weight[0], 0)
    sums = _collapse_axis(sums, _y_index(lower[1], rows.shape[3]), local[1], weight[1], 1)
    return _collapse_axis(sums, _z_index(lower[2], rows.shape[3]), local[2], weight[2], 2)


def interpolate_far(values: Float32Array, lower: IntArray, local: FloatArray) -> FloatArray:
    """Interpolate the far field (g, g, g) trilinearly over whole bricks, one axis after the other.

    Per axis, `lower` (3, b, n) is the grid layer below each node, and `local` (3, b, n) the height
    above it, in steps (0 to 1). Return (b, n, n, n).
    """
    layers, lower = needed_layers(lower)
    x, y, z = cross_axes(np.clip(layers, 0, len(values) - 1))
    rows = (x * len(values) + y) * len(values) + z
    size = rows.shape[3]
    indices = (_x_index(rows, lower[0]), _y_index(lower[1], size), _z_index(lower[2], size))
    sums: FloatArray | Float32Array = values.reshape(1, -1)
    for axis, (index, height) in enumerate(zip(indices, local, strict=True)):
        sums = _collapse_axis(sums, index, height, height, axis, _keep)
    far: FloatArray = sums[0]
    return far


def _x_index(rows: IntArray, lower: IntArray) -> Pair:
    """Return the columns of the layers below and above each node's x, shape (b, n, k, k)."""
    bricks = np.arange(len(rows))[:, None]
    return rows[bricks, lower], rows[bricks, lower + 1]


def _y_index(lower: IntArray, layers: int) -> Pair:
    """Return where those of y stand in an array (b, n, k, k), shape (b, n, n, k)."""
    rows = np.arange(lower.size).reshape(*lower.shape, 1, 1) * layers
    below = (rows + lower[:, None, :, None]) * layers + np.arange(layers)
    return below, below + layers


def _z_index(lower: IntArray, layers: int) -> Pair:
    """Return where those of z stand in an array (b, n, n, k), shape (b, n, n, n)."""
    bricks, nodes = lower.shape
    rows = np.arange(bricks * nodes**2).reshape(bricks, nodes, nodes, 1) * layers
    below = rows + lower[:, None, None, :]
    return below, below + 1


def _keep(channels: FloatArray, u: FloatArray, axis: int) -> FloatArray:
    """Return values that do not depend on the place, as they are."""
    del u, axis
    return channels


def _restrict(channels: FloatArray, u: FloatArray, axis: int) -> FloatArray:
    """Fix x (axis 0), y or z of quadrics; the last two channels pass through.

    Channels: [1, x, y, z, xx, yy, zz, xy, yz, zx], then [1, y, z, yy, zz, yz], then [1, z, zz].
    """
    c = channels
    if axis == 0:
        parts = [c[0] + u * (c[1] + u * c[4]), c[2] + u * c[7], c[3] + u * c[9], c[5], c[6], c[8]]
    elif axis == 1:
        parts = [c[0] + u * (c[1] + u * c[3]), c[2] + u * c[5], c[4]]
    else:
        parts = [c[0] + u * (c[1] + u * c[2])]
    return np.stack([*parts, c[-2], c[-1]])


def _collapse_axis(
    sums: FloatArray | Float32Array,
    index: Pair,
    local: FloatArray,
    weight: FloatArray,
    axis: int,
    restrict: Callable[[FloatArray, FloatArray, int], FloatArray] = _restrict,
) -> FloatArray:
    """Blend the layers below and above each node along one axis."""
    shape = [len(local), 1, 1, 1]
    shape[1 + axis] = local.shape[1]
    flat, t, w = sums.reshape(len(sums), -1), local.reshape(shape), weight.reshape(shape)
    # The place is seen from the layer below (t) and from the one above (t - 1).
    below = restrict(np.take(flat, index[0], axis=1), t, axis) * (1.0 - w)
    above = restrict(np.take(flat, index[1], axis=1), t - 1.0, axis) * w
    return below + above
