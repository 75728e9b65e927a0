"""Numbers that a user gives are within their range: one rule for Python, files and options."""

from __future__ import annotations

from math import inf

from hpccomponent.errors import UsageError

FARTHEST = 2.0**53
"""Of a coordinate: beyond it, a double has no fractions of a unit."""


LEAST = 1.0 / FARTHEST
"""Of a number that is not zero: a smaller length is lost in every coordinate."""

NUMBERS = f"a number from {LEAST:.1e} to {FARTHEST:.0e} in size"


def is_number(value: object) -> bool:
    """Tell whether a float is zero, or from `LEAST` to `FARTHEST` in size; others pass.

    Within them, squares, cubes and counts of cells are numbers, too.

    Examples
    --------
    >>> is_number(float("nan")), is_number((1.0, 1e300)), is_number(1e-300), is_number(10**400)
    (False, False, False, True)
    """
    if isinstance(value, list | tuple):
        return all(map(is_number, value))
    return not isinstance(value, float) or value == 0.0 or LEAST <= abs(value) <= FARTHEST


def is_place(*coordinates: float) -> bool:
    """Tell whether coordinates, none of which may be NaN or beyond `FARTHEST`, are a place.

    Examples
    --------
    >>> is_place(1.5, 0.0, -2.0), is_place(1e300, 0.0, 0.0)
    (True, False)
    """
    return all(abs(number) <= FARTHEST for number in coordinates)


def check_range(
    name: str, value: float, low: float = -inf, high: float = inf, *, is_open: bool = False
) -> None:
    """Raise UsageError where a value is no number (see `is_number`), or beyond its range.

    The range has its ends, but for `low` where `is_open`; the message tells the name.
    """
    if is_number(value) and low <= value <= high and not (is_open and value == low):
        return
    if low == -inf or not is_number(value):
        asked = NUMBERS
    elif high < inf:
        asked = f"a number from {low:g} to {high:g}"
    else:
        asked = f"a number above {low:g}" if is_open else f"{low:g} or more"
    raise UsageError(f"{name} is {value!r}", f"give {asked}")
