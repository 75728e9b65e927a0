"""What the tasks of a reconstruction declare of their results (see `hpccomponent.protocol`).

What sizes anything in the master is held against what a task was assigned: counts against the
points in its blocks, boxes and keys against where these lie. Here is what several kinds of tasks
need; the `patterns` of each subject have those of its tasks.
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.lattice import keys_lie_within, pack_places, shift_within
from hpcapp.geometry.points import FloatArray, IntArray
from hpccomponent.protocol.columns import Bounds, Column
from hpccomponent.protocol.declared import Declared, Fixed, Flag, Where, Whole

SMALL_BYTES = 1 << 16
"""Of results whose size does not depend on the points."""

WRITTEN = Flag()

LENGTH = "length units of the input"

UNIT = 1.001
"""Of a vector of unit length, at most."""

Corners = Annotated[FloatArray, Column(2, 3, low=-np.inf, finite=False, unit=LENGTH)]
"""Of a box around points; inside out around none."""

CORNERS = Bounds().of(Corners)

CellKeys = Annotated[IntArray, Column("c", rises=True)]
"""Of c cells of a lattice."""

CellCounts = Annotated[IntArray, Column("c", low=1)]
"""Points in each of c cells."""

ComponentBoxes = Annotated[FloatArray, Column("c", 6, low=-np.inf, finite=False, unit=LENGTH)]
"""Lowest and highest coordinates of each of c components; infinite without vertices."""

Box = tuple[FloatArray, FloatArray] | FloatArray
"""Its two corners."""

_OFF_UNIT = 1e-3  # how far off 1 the square of a unit length may be


def keys_within(first: IntArray, last: IntArray) -> Bounds:
    """Return the bounds of the keys of places from the lowest to the highest in a box."""
    low, high = (int(pack_places(corner)) for corner in (first, last))
    return Bounds(
        low,
        high,
        agrees=lambda keys: keys_lie_within(keys, first, last),
        rule="all keys are of places in reach",
    )


def cells_in(box: Box, origin: FloatArray, size: float, halo: int = 1) -> Bounds:
    """Return the bounds of the keys of cells in a box, and `halo` further: 1 is for rounding.

    `origin` is the corner of cell (0, 0, 0), and `size` the edge of a cell.
    """
    first, last = (np.floor((corner - origin) / size) for corner in box)
    return keys_within(shift_within(first, -halo), shift_within(last, halo))


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
    return bool((np.abs(squares - 1.0) <= _OFF_UNIT).all())


def sampled_boxes(most: int, cells: Bounds) -> Declared:
    """Return the pattern of points in a sample of boxes, and of the boxes' keys."""
    return Where(
        Fixed(Whole(0, most), cells.of(CellKeys)),
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
