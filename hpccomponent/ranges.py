"""Numbers that a user gives are finite and within their range: one rule for Python and files."""

from __future__ import annotations

from math import inf

from hpccomponent.errors import UsageError

FARTHEST = 2.0**53
"""Of a coordinate: beyond it, a double has no fractions of a unit."""


def is_finite(value: object) -> bool:
    """Tell whether a value is no NaN and no infinity; whatever is no number is neither.

    Examples
    --------
    >>> is_finite(float("nan")), is_finite((1.0, float("inf"))), is_finite(10**400)
    (False, False, True)
    """
    if isinstance(value, list | tuple):
        return all(map(is_finite, value))
    return not isinstance(value, float) or -inf < value < inf


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
    """Refuse a number that is not finite, or beyond its range.

    Parameters
    ----------
    name : str
        For the message.
    low, high : float
        The range, its ends included.
    is_open : bool
        Whether `low` itself is refused, too.

    Raises
    ------
    UsageError
        It is one of these.
    """
    if is_finite(value) and low <= value <= high and not (is_open and value == low):
        return
    if low == -inf:
        asked = "a finite number"
    elif high < inf:
        asked = f"a number from {low:g} to {high:g}"
    else:
        asked = f"a number above {low:g}" if is_open else f"{low:g} or more"
    raise UsageError(f"{name} is {value!r}", f"give {asked}")
