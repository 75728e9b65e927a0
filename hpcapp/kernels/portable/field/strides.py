"""Which nodes exist inside a brick, on its faces and on its edges, where strides differ.

A brick of stride 2^e has the nodes whose places in it are multiples of that. On a face, those of
the finer of its two bricks exist, and on an edge those of the finest of four; a corner always
does. Each brick has all nodes that lie in it, so that neighbours agree on what they share.
"""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.lattice import pack_places
from hpcapp.geometry.points import ByteArray, Float32Array, IntArray
from hpcapp.kernels.types.grid import BRICK, MOST_SHIFT, NODES, Grid

ENDS = np.array([0, *[1] * (BRICK - 1), 2])
"""Whether a node, by its place along an axis, is the first of a brick, an inner or the last one."""


def line_shifts(grid: Grid, places: IntArray) -> ByteArray:
    """Return how far apart the nodes are on the lines through some bricks, as powers of two.

    Of a grid with strides, and places (b, 3), it gives (b, 3, 3, 3): inside the brick (1, 1, 1), on
    its faces, with 0 or 2 for the low or the high end of one axis, and on its edges, with two of
    these. Of corners, which are no lines, as inside.
    """
    assert grid.strides is not None  # noqa: S101 - it is asked only then
    steps = np.stack(np.meshgrid(*[np.arange(-1, 2)] * 3, indexing="ij"), axis=-1)
    around = places[:, None, None, None] + steps  # (b, 3, 3, 3, 3): the brick, and those around it
    is_there = ((around >= 0) & (around < grid.bricks)).all(axis=-1)
    shifts = np.where(is_there, grid.strides.at(pack_places(around)), np.uint8(MOST_SHIFT))
    inside = shifts[:, 1, 1, 1].copy()
    for axis in range(1, 4):
        # Axis by axis the least of two bricks at either end: faces have two, and edges four.
        below, own, above = np.moveaxis(shifts, axis, 0)
        ends = [np.minimum(below, own), own, np.minimum(own, above)]
        shifts = np.stack(ends, axis=axis)
    shifts[:, ::2, ::2, ::2] = inside[:, None, None, None]
    return shifts


def finest_shifts(shifts: ByteArray) -> ByteArray:
    """Return the least that nodes are apart anywhere in each brick, as a power of two."""
    finest: ByteArray = shifts.min(axis=(1, 2, 3), initial=MOST_SHIFT)
    return finest


def fill_missing(values: Float32Array, shifts: ByteArray) -> Float32Array:
    """Give each place without a node the value of the next node below it, along all axes.

    Of values (b, 9, 9, 9), and shifts (b, 3, 3, 3) of `line_shifts`. Nodes below a place on a face
    lie on that face: it has both signs exactly where its nodes do.
    """
    apart = shifts[:, ENDS[:, None, None], ENDS[:, None], ENDS].astype(np.int64)
    x, y, z = (at >> apart << apart for at in np.indices((NODES,) * 3))
    brick = np.arange(len(values))[:, None, None, None]
    filled: Float32Array = values[brick, x, y, z]
    return filled
