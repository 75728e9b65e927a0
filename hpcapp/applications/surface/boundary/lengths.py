"""Lengths that a user gives: in units of the input, in spacings of the points, or none."""

from __future__ import annotations

from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError
from hpccomponent.ranges import is_number


@dataclass(frozen=True, slots=True)
class Length:
    """A length in units of the input, or in spacings of the points."""

    value: float
    in_spacings: bool


def parse_length(name: str, text: str) -> Length | None:
    """Return what an option says: ``auto`` (None), ``0.05``, or ``3s`` for three spacings.

    Raises UsageError where it is none of these, negative, or beyond `is_number`.

    Examples
    --------
    >>> parse_length("trim", "3s")
    Length(value=3.0, in_spacings=True)
    >>> parse_length("trim", "0.02")
    Length(value=0.02, in_spacings=False)
    """
    return None if text == "auto" else _read_length(name, text, "auto, ")


def require_length(name: str, text: str) -> Length:
    """Return what an option says that must say something: as `parse_length`, but not ``auto``.

    Raises UsageError where it does not, or says zero.
    """
    length = _read_length(name, text)
    if not length.value:
        raise UsageError(f"{name_option(name)} is {text!r}", "give a length greater than zero")
    return length


def _read_length(name: str, text: str, words: str = "") -> Length:
    in_spacings = text.endswith("s")
    try:
        value = float(text[:-1] if in_spacings else text)
    except ValueError:
        value = -1.0
    if not (is_number(value) and value >= 0.0):
        raise UsageError(
            f"{name_option(name)} is {text!r}",
            f"give {words}a length in the units of the input, as 0.05, or in spacings, as 3s",
        )
    return Length(value, in_spacings)
