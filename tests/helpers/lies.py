"""Results that are wrong in one way each: functions from what a task returned to what it says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Lie = Callable[[object], object]
Number = int | float

_FAR = 10**9
_MORE_ROWS, _MORE_BYTES = 10**6, 64 << 20  # the smaller of both

Array = NDArray[Any]


def _change(
    value: object, of_array: Callable[[Array], Array], of_number: Callable[[Number], Number]
) -> object:
    """Change the arrays and the numbers in a value; truth values, texts and None stay."""

    def change(item: object) -> object:
        if isinstance(item, np.ndarray):
            return of_array(item)
        if type(item) is int or type(item) is float:
            return of_number(item)
        if isinstance(item, tuple | list):
            return type(item)(map(change, item))
        if isinstance(item, dict):
            return {key: change(entry) for key, entry in item.items()}
        if is_dataclass(item) and not isinstance(item, type):
            make: Callable[..., object] = type(item)
            return make(*(change(getattr(item, one.name)) for one in fields(item)))
        return item

    return change(value)


def _set_zero(value: object) -> object:
    return _change(value, np.zeros_like, lambda number: type(number)(0))


def _add_one(value: object) -> object:
    return _change(
        value,
        lambda array: array + array.dtype.type(1) if array.dtype.kind in "iu" else array,
        lambda number: number + 1 if type(number) is int else number,
    )


def _scale(value: object) -> object:
    return _change(
        value,
        lambda array: array * array.dtype.type(1.001) if array.dtype.kind == "f" else array,
        lambda number: number * 1.001 if type(number) is float else number,
    )


def _turn_round(value: object) -> object:
    return _change(value, lambda array: array[::-1].copy(), lambda number: number)


def _shift(value: object) -> object:
    return _change(
        value,
        lambda array: array + array.dtype.type(_FAR) if array.dtype.kind in "iuf" else array,
        lambda number: number + type(number)(_FAR),
    )


def _blow_up(value: object) -> object:
    first = True

    def lengthen(array: Array) -> Array:
        nonlocal first
        if not first:
            return array
        first = False
        row_bytes = int(np.prod(array.shape[1:], dtype=int)) * array.itemsize
        more = min(_MORE_ROWS, _MORE_BYTES // max(row_bytes, 1))
        rows = np.zeros((more, *array.shape[1:]), array.dtype)
        if len(array):
            rows[:] = array[-1]
        return np.concatenate([array, rows])

    return _change(value, lengthen, lambda number: number)


LIES: dict[str, Lie] = {
    "zero": _set_zero,
    "plus one": _add_one,
    "times 1.001": _scale,
    "permuted": _turn_round,
    "shifted": _shift,
    "giant": _blow_up,
}
"""All numbers zero; every integer one too large; every float 1.001 times as large; the rows of all
arrays the other way round; every number 10^9 too large; the first array longer by 10^6 times its
last row."""
