"""Which cells lie near others, in numpy."""

from __future__ import annotations

import numpy as np

from hpccomponent.surface.types.lattice import find_keys, step_keys, unique_keys, unpack_keys
from hpccomponent.surface.types.points import BoolArray, ByteArray, FloatArray, IntArray

__all__ = ["look_near", "mark_near"]


def mark_near(keys: IntArray, cells: IntArray, low: IntArray, high: IntArray) -> BoolArray:
    """Tell which of some keys lie in boxes around some cells, in numpy.

    Parameters
    ----------
    keys, cells : ndarray of int64, shapes (k,) and (c,)
        Sorted keys of one lattice.
    low, high : ndarray of int64, shape (3,)
        How many cells a box reaches down and up along each axis.

    Returns
    -------
    ndarray of bool, shape (k,)
    """
    for axis, unit in enumerate(np.eye(3, dtype=np.int64)):
        steps = [step_keys(cells, unit * step) for step in range(-low[axis], high[axis] + 1)]
        cells = unique_keys(np.concatenate(steps))
    near: BoolArray = find_keys(cells, keys) < len(cells)
    return near


def look_near(
    cells: IntArray,
    origin: FloatArray,
    cell_size: float,
    pairs: ByteArray,
    corner: FloatArray,
    edge: float,
    margin: float,
    beyond: int,
) -> BoolArray:
    """Look up the middles of cells among bricks, in numpy; see `near_bricks`.

    Parameters
    ----------
    cells, origin, cell_size
        As of `near_bricks`.
    pairs : ndarray of uint8, shape (x, y, z)
        Of each brick, bit a + 2 b + 4 c: whether it, or the next a, b and c ones along x, y and z,
        may be evaluated.
    corner : ndarray of float64, shape (3,)
        Where brick (`beyond`, `beyond`, `beyond`) of these begins, in length units of the input.
    edge, margin : float
        Of a brick, and how near a place must be to one, half an edge at most; likewise.
    beyond : int

    Returns
    -------
    ndarray of bool, shape (c,)
    """
    places = origin + cell_size * (unpack_keys(cells) + 0.5)
    index = np.zeros(len(places), np.int64)
    spans = np.zeros(len(places), np.uint8)
    inside = np.ones(len(places), np.bool_)
    for axis, length in enumerate(pairs.shape):
        column = (places[:, axis] - corner[axis]) / edge
        low = np.floor(column - margin / edge).astype(np.int64)
        spans |= ((np.floor(column + margin / edge) > low).astype(np.uint8)) << np.uint8(axis)
        low += beyond
        inside &= (low >= 0) & (low < length - 1)
        index = index * length + np.clip(low, 0, length - 1)
    found: BoolArray = inside & (pairs.reshape(-1)[index] >> spans & 1).astype(np.bool_)
    return found
