"""What the readers of files find: columns of numbers, and lists of uneven length."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.points import IntArray
from hpccomponent.dataclass import dataclass

Numbers = NDArray[np.number | np.bool_]
"""Numbers of any type."""


@dataclass(frozen=True, slots=True, eq=False)
class Ragged:
    """Lists of lengths (n,), end to end."""

    lengths: IntArray
    values: Numbers


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """The rows of one element, by the names of its properties.

    Scalars (n,) may be views of the mapped file: strided, and in its byte order.
    """

    scalars: dict[str, Numbers]
    lists: dict[str, Ragged]


def positions_within(lengths: IntArray) -> IntArray:
    """Number the values of each list from 0, list after list.

    Examples
    --------
    >>> positions_within(np.array([2, 0, 3]))
    array([0, 1, 0, 1, 2])
    """
    starts = np.cumsum(lengths) - lengths
    return np.arange(lengths.sum()) - np.repeat(starts, lengths)


def cut_fans(lengths: IntArray) -> tuple[IntArray, IntArray]:
    """Cut polygons of so many corners into triangle fans; those of fewer than three give none.

    Return where the corners of each triangle are in the list of all polygons' corners, (t, 3), and
    which polygon it is from, (t,).

    Examples
    --------
    >>> cut_fans(np.array([3, 4]))[0].tolist()
    [[0, 1, 2], [3, 4, 5], [3, 5, 6]]
    """
    triangles = np.maximum(lengths - 2, 0)
    first = np.repeat(np.cumsum(lengths) - lengths, triangles)
    second = first + positions_within(triangles) + 1
    polygon = np.repeat(np.arange(len(lengths)), triangles)
    return np.stack([first, second, second + 1], axis=1), polygon
