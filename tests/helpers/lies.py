"""Wrong answers that look like right ones: functions from a task's value to another of its form."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["LIES"]

Change = Callable[[NDArray[Any]], NDArray[Any]]
FAR = 10**9


def _change(value: Any, change: Change) -> Any:
    """Return a value with all its numbers and arrays of numbers changed."""
    match value:
        case np.ndarray():
            return np.ascontiguousarray(change(value))
        case bool() | str() | bytes() | None:
            return value
        case int() | float():
            return change(np.asarray(value)).item()
        case tuple():
            return tuple(_change(item, change) for item in value)
        case list():
            return [_change(item, change) for item in value]
        case dict():
            return {key: _change(item, change) for key, item in value.items()}
    if not is_dataclass(value):
        return value
    changed = object.__new__(type(value))
    for one in fields(value):
        object.__setattr__(changed, one.name, _change(getattr(value, one.name), change))
    return changed


def _add(number: int) -> Change:
    return lambda array: (array + number).astype(array.dtype) if array.dtype.kind in "iu" else array


def _scale(array: NDArray[Any]) -> NDArray[Any]:
    return (array * 1.001).astype(array.dtype) if array.dtype.kind == "f" else array


def _reverse(array: NDArray[Any]) -> NDArray[Any]:
    return array[::-1] if array.ndim else array


def _by(change: Change) -> Callable[[Any], Any]:
    return lambda value: _change(value, change)


LIES: Mapping[str, Callable[[Any], Any]] = {
    "zero": _by(np.zeros_like),
    "plus one": _by(_add(1)),
    "times 1.001": _by(_scale),
    "permuted": _by(_reverse),
    "shifted": _by(_add(FAR)),
}
