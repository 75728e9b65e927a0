"""What the readers of files find: columns of numbers, and lists of uneven length."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.types.points import IntArray

__all__ = ["Ragged", "Rows", "positions_within"]


@dataclass(frozen=True, slots=True, eq=False)
class Ragged:
    """Lists of different lengths, end to end.

    Parameters
    ----------
    lengths : ndarray of int64, shape (n,)
        How long each list is.
    values : ndarray, shape (lengths.sum(),)
        The lists' values, list after list.
    """

    lengths: IntArray
    values: NDArray[Any]


@dataclass(frozen=True, slots=True, eq=False)
class Rows:
    """The rows of one element, by the names of its properties.

    Parameters
    ----------
    scalars : dict of str to ndarray, shape (n,)
        May be views of the mapped file: strided, and in its byte order.
    lists : dict of str to Ragged
        The list properties.
    """

    scalars: dict[str, NDArray[Any]]
    lists: dict[str, Ragged]


def positions_within(lengths: IntArray) -> IntArray:
    """Number the values of each list from 0.

    Parameters
    ----------
    lengths : ndarray of int64, shape (n,)
        How long each list is.

    Returns
    -------
    ndarray of int64, shape (lengths.sum(),)
        List after list.

    Examples
    --------
    >>> positions_within(np.array([2, 0, 3]))
    array([0, 1, 0, 1, 2])
    """
    starts = np.cumsum(lengths) - lengths
    return np.arange(lengths.sum()) - np.repeat(starts, lengths)
