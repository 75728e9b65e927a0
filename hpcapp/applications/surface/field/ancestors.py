"""What the finest cells of a tile lay on coarser levels, without the levels between."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpcapp import kernels
from hpcapp.geometry.lattice import step_keys
from hpcapp.geometry.points import IntArray

Marks = NDArray[np.uint32]


_STEPS: IntArray = np.array(list(np.ndindex(4, 4, 4))) - 1
"""The corners around a cell, from its own lowest one."""


def _boxes() -> NDArray[np.uint64]:
    """Return, for each way to lie in an ancestor, which of these a cell lays, a bit each."""
    ways = np.array([[shape % 3, shape // 3 % 3, shape // 9] for shape in range(27)])[:, None]
    # (27, 1, 3): the corners of one cell, and one more on the side that the way names.
    low, high = np.where(ways == 0, -1, 0), np.where(ways == 2, 2, 1)
    is_laid = (np.clip(_STEPS, low, high) == _STEPS).all(axis=2)
    boxes: NDArray[np.uint64] = is_laid @ (np.uint64(1) << np.arange(64, dtype=np.uint64))
    return boxes


_BOXES = _boxes()


def corners_at(ancestors: IntArray, marks: Marks) -> IntArray:
    """Return the corners of a level that carry quadrics because of some of the finest cells.

    `ancestors` (a,) are sorted keys of cells of the level, which is not the finest, with their
    `marks` (a,); the corners are sorted keys (v,): the ancestors of the corners of these cells and
    of their neighbours.

    Cell i lays corners i - 1 to i + 2; their ancestors are those from floor((i - 1) / 2^depth) to
    ceil((i + 2) / 2^depth), along each axis by itself: one more below its own ancestor's where it
    lies first in this, one more above where it lies last.
    """
    boxes = np.zeros(len(ancestors), np.uint64)  # of each, the corners around it that are laid
    for shape in range(27):
        is_laid = marks >> np.uint32(shape) & np.uint32(1)
        boxes |= is_laid * _BOXES[shape]
    laid = [
        step_keys(ancestors[(boxes >> np.uint64(bit) & np.uint64(1)).astype(np.bool_)], step)
        for bit, step in enumerate(_STEPS)
    ]
    while len(laid) > 1:  # sorted sets, of which those that are side by side have most in common
        laid = [kernels.unite_keys(*pair) for pair in zip(laid[::2], laid[1::2], strict=True)]
    return laid[0]
