"""Which columns of a cloud hold labels: numbers that must not be averaged."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

MOST_LABELS = 64
"""A column of whole numbers with no more different ones holds labels."""

_NAMES = re.compile(
    r"class|label|segment|instance|cluster|object|material|category|return|flag|channel|time"
    r"|(^|[^a-z])(scan|id|ids|index|ring|row|column|source)($|[^a-z])"
)
_ROWS_AT_ONCE = 1 << 16


class LabelSearch:
    """Finds the columns that hold labels, in a cloud that may come in parts.

    Those are columns that are called so, as classes and times are, and columns of whole numbers
    with few different ones. The parts, and their order, do not matter.

    Examples
    --------
    >>> search = LabelSearch()
    >>> search.add({"kind": np.array([1.0, 2.0, 1.0]), "height": np.array([0.5, 0.25, 1.0])})
    >>> sorted(search.labels)
    ['kind']
    """

    def __init__(self) -> None:
        self._named: set[str] = set()
        self._values: dict[str, NDArray[Any] | None] = {}

    @property
    def labels(self) -> frozenset[str]:
        """Names of the columns that hold labels, as far as the cloud is known."""
        few = (name for name, values in self._values.items() if values is not None)
        return frozenset(self._named.union(few))

    def add(self, attributes: Mapping[str, NDArray[Any]]) -> None:
        """Look through the next points of the cloud: columns (n,) by name; NaN does not count."""
        for name, column in attributes.items():
            if column.dtype.kind == "b" or _NAMES.search(name.lower()):
                self._named.add(name)
                continue
            for start in range(0, len(column), _ROWS_AT_ONCE):
                known = self._values.setdefault(name, column[:0])
                if known is None:
                    break
                self._values[name] = _unite(known, column[start : start + _ROWS_AT_ONCE])


def find_labels(attributes: Mapping[str, NDArray[Any]]) -> frozenset[str]:
    """Return the columns of a cloud that hold labels; see `LabelSearch`."""
    search = LabelSearch()
    search.add(attributes)
    return search.labels


def _unite(known: NDArray[Any], more: NDArray[Any]) -> NDArray[Any] | None:
    """Return the different values of both; None where they are many, or not whole numbers."""
    found = np.unique(more)
    if found.dtype.kind == "f":
        found = found[~np.isnan(found)]
        if not (found == np.rint(found)).all():
            return None
    united = np.union1d(known, found)
    return united if len(united) <= MOST_LABELS else None
