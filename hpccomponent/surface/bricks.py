"""Which bricks the surface passes through: seeded at the points, grown across sign changes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.blending import NODES
from hpccomponent.surface.field import BRICK, Grid
from hpccomponent.surface.lattice import cells_of, pack_places, step_keys, unique_keys, unpack_keys
from hpccomponent.surface.points import FloatArray, IntArray

__all__ = ["grow_bricks", "seed_bricks"]

Float32Array = NDArray[np.float32]
Evaluate = Callable[[IntArray], Float32Array]


def seed_bricks(grid: Grid, positions: FloatArray) -> IntArray:
    """Return the bricks that hold a point.

    Parameters
    ----------
    grid : Grid
    positions : ndarray of float64, shape (n, 3)
        In length units of the input, inside the grid.

    Returns
    -------
    ndarray of int64, shape (b,)
        Sorted, unique keys.
    """
    places = np.floor(cells_of(positions, grid.origin, BRICK * grid.step)).astype(np.int64)
    return unique_keys(pack_places(places))


def grow_bricks(
    evaluate: Evaluate,
    seeds: IntArray,
    bricks: tuple[int, int, int],
    advance: Callable[[int, int], None] | None = None,
) -> tuple[IntArray, Float32Array]:
    """Evaluate the seeds, and every brick behind a face with a sign change, until none is left.

    Parameters
    ----------
    evaluate : callable
        From places of bricks, shape (b, 3), to their node values, shape (b, 9, 9, 9).
    seeds : ndarray of int64, shape (b,)
        Keys of bricks.
    bricks : tuple of int
        Bricks along x, y and z.
    advance : callable, optional
        Told (bricks done, bricks known) after each round.

    Returns
    -------
    places : ndarray of int64, shape (b, 3)
        Sorted.
    values : ndarray of float32, shape (b, 9, 9, 9)

    Notes
    -----
    No edge that the surface crosses lies on a brick that is missing here, so the surface is
    closed; the cost grows with its area.
    """
    known, keys, parts = seeds, [], []
    new = seeds
    while len(new):
        values = evaluate(unpack_keys(new))
        keys.append(new)
        parts.append(values)
        if advance is not None:
            advance(len(known) - len(new), len(known))
        new = np.setdiff1d(_reached(new, values, bricks), known)
        known = np.union1d(known, new)
    joined = np.concatenate(keys)
    order = np.argsort(joined)
    return unpack_keys(joined[order]), np.concatenate(parts)[order]


def _reached(keys: IntArray, values: Float32Array, bricks: tuple[int, int, int]) -> IntArray:
    """Return the bricks behind the faces on which the sign changes."""
    inside = values < 0.0
    places = unpack_keys(keys)
    reached = []
    for axis in range(3):
        for step, layer, last in ((-1, 0, 0), (1, NODES - 1, bricks[axis] - 1)):
            face = np.take(inside, layer, axis=axis + 1).reshape(len(keys), -1)
            crossed = face.any(axis=1) & ~face.all(axis=1) & (places[:, axis] != last)
            reached.append(step_keys(keys[crossed], step * np.eye(3, dtype=np.int64)[axis]))
    return unique_keys(np.concatenate(reached))
