"""How far around some bricks the surface must be known: so many cells, whatever their size."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from hpcapp.geometry.points import BoolArray, ByteArray
from hpcapp.kernels.types.grid import BRICK

__all__ = ["mark_rim"]

Array = TypeVar("Array", BoolArray, ByteArray)


def mark_rim(bricks: BoolArray, cells: ByteArray | None) -> BoolArray:
    """Mark some bricks and their rim: those between which and these lie less than eight cells.

    `cells` says how many cells a way through each brick of the box (x, y, z) crosses, 1 or more;
    None where it is eight everywhere: then the rim is the 26 neighbours. What a vertex gets depends
    on faces seven cells away, which have their vertices in one more.
    """
    near = _widen(bricks)
    if cells is None:
        return near
    # How many cells lie between each brick and the given ones; eight are too many.
    depth = np.where(near, 0, BRICK).astype(np.uint8)
    while True:
        beyond = np.minimum(depth + cells, BRICK)
        beyond[bricks] = 0
        nearer = np.minimum(depth, BRICK - _widen(BRICK - beyond))
        if np.array_equal(nearer, depth):
            marked: BoolArray = depth < BRICK
            return marked
        depth = nearer


def _widen(values: Array) -> Array:
    """Return the largest value among each brick and its 26 neighbours, axis by axis."""
    for axis in range(3):
        grown = values.copy()
        ahead, behind = [slice(None)] * 3, [slice(None)] * 3
        ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
        for to, of in ((ahead, behind), (behind, ahead)):
            part = grown[tuple(to)]
            np.maximum(part, values[tuple(of)], out=part)
        values = grown
    return values
