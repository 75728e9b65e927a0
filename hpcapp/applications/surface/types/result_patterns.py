"""What the tasks of a reconstruction declare of their results (see `hpccomponent.protocol`).

What sizes anything in the master is held against what a task was assigned: counts against the
points in its blocks, boxes and keys against where these lie. Here is what several kinds of tasks
need; the `patterns` of each subject have those of its tasks.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.lattice import keys_lie_within, pack_places, shift_within
from hpcapp.geometry.points import FloatArray, IntArray
from hpccomponent.protocol.declared import Declared, Fixed, Flag, Where, Whole
from hpccomponent.protocol.declared_arrays import Array

SMALL_BYTES = 1 << 16
"""Of results whose size does not depend on the points."""

WRITTEN = Flag()

BOX = Array("<f8", 2, 3, low=-np.inf, finite=False)
"""Inside out around no points."""

Box = tuple[FloatArray, FloatArray] | FloatArray
"""Its two corners."""

_UNIT = 1e-3  # how far off 1 the square of a unit length may be


def keys_within(extent: str, first: IntArray, last: IntArray, rises: bool = True) -> Declared:
    """Return the pattern of the keys of some places in a box.

    Parameters
    ----------
    extent : str
        How many there are.
    first, last : ndarray of int64, shape (3,)
        The lowest place and the highest.
    rises : bool
        Whether they are sorted, and each is there once.
    """
    low, high = (int(pack_places(corner)) for corner in (first, last))
    return Where(
        Array("<i8", extent, low=low, high=high, rises=rises),
        lambda keys: keys_lie_within(keys, first, last),
        "all keys are of places in reach",
    )


def cells_in(
    extent: str, box: Box, origin: FloatArray, size: float, halo: int = 1, rises: bool = True
) -> Declared:
    """Return the pattern of the keys of some cells in a box.

    Parameters
    ----------
    extent : str
        How many there are.
    box : tuple of ndarray of float64, shape (3,)
    origin : ndarray of float64, shape (3,)
        Corner of cell (0, 0, 0).
    size : float
        Edge of a cell.
    halo : int
        So many cells further: 1 is for rounding.
    rises : bool
        Whether they are sorted, and each is there once.
    """
    first, last = (np.floor((corner - origin) / size) for corner in box)
    return keys_within(extent, shift_within(first, -halo), shift_within(last, halo), rises)


def lie_within(rows: NDArray[Any], low: int, end: int) -> bool:
    """Tell whether all entries are `low` or more, and below `end`."""
    return not rows.size or bool(rows.min() >= low and rows.max() < end)


def rise_by_pairs(major: IntArray, minor: NDArray[Any]) -> bool:
    """Tell whether pairs of integers are sorted, and each is there once."""
    rises = np.where(major[1:] == major[:-1], minor[1:] > minor[:-1], major[1:] > major[:-1])
    return bool(rises.all())


def are_units(vectors: NDArray[Any]) -> bool:
    """Tell whether vectors, of shape (n, 3), have unit length, but for rounding."""
    squares = np.einsum("ij,ij->i", vectors, vectors, dtype=np.float64)
    return bool((np.abs(squares - 1.0) <= _UNIT).all())


def sampled_boxes(most: int, cells: Declared) -> Declared:
    """Return the pattern of points in a sample of boxes, and of the boxes' keys."""
    return Where(
        Fixed(Whole(0, most), cells),
        lambda found: min(found[0], 1) <= len(found[1]) <= found[0],
        "each box holds a point",
    )


def is_share(points: int, one_in: int, found: int) -> bool:
    """Tell whether a sample of points may be so large; with 0 its share is not known."""
    return found == points if one_in == 1 else found <= points


def bounds_some(box: FloatArray, points: int) -> bool:
    """Tell whether a box may be that around so many points."""
    if not points:
        return bool((box[0] == np.inf).all() and (box[1] == -np.inf).all())
    return bool(np.isfinite(box).all() and (box[0] <= box[1]).all())


def lie_in(positions: FloatArray, box: Box) -> bool:
    """Tell whether some positions lie in a box, or on it."""
    return bool((positions >= box[0]).all() and (positions <= box[1]).all())
