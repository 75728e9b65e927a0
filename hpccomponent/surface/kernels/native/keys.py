"""Sorted sets of cells, corners and bricks, by their keys."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.kernels.native.arrays import integers, native
from hpccomponent.surface.types.points import BoolArray, ByteArray, FloatArray, IntArray

__all__ = [
    "find_keys",
    "look_near",
    "mark_ancestors",
    "mark_near",
    "parent_keys",
    "spread_keys",
    "unite_keys",
]


def spread_keys(keys: IntArray, low: int, high: int) -> IntArray:
    """Return the places within a box around each place."""
    result: IntArray = native.spread_keys(integers(keys), low, high)
    return result


def parent_keys(vertices: IntArray) -> IntArray:
    """Return every parent of some corners."""
    result: IntArray = native.parent_keys(integers(vertices))
    return result


def unite_keys(first: IntArray, second: IntArray) -> IntArray:
    """Return the union of two sorted sets of keys."""
    result: IntArray = native.unite_keys(integers(first), integers(second))
    return result


def find_keys(keys: IntArray, wanted: IntArray, threads: int = 1) -> IntArray:
    """Return where each of some keys (v,) stands among sorted keys."""
    result: IntArray = native.find_keys(integers(keys), integers(wanted), threads)
    return result


def mark_ancestors(cells: IntArray, depth: int, ancestors: IntArray) -> NDArray[np.uint32]:
    """Tell which cells of a level are ancestors of some of the finest."""
    result: NDArray[np.uint32] = native.mark_ancestors(integers(cells), depth, integers(ancestors))
    return result


def mark_near(keys: IntArray, cells: IntArray, low: IntArray, high: IntArray) -> BoolArray:
    """Tell which of some keys lie in boxes around some cells."""
    result: BoolArray = native.mark_near(integers(keys), integers(cells), low, high)
    return result


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
    """Look up the middles of cells among bricks."""
    result: BoolArray = native.look_near(
        integers(cells), origin, cell_size, pairs, corner, edge, margin, beyond
    )
    return result
