"""JSON that somebody else wrote: one decoder, with types, for all of it.

A head, a bucket, a host, a report or a journal may say anything. Here it becomes a value of the
type that its reader names, or a `ValueError` of one line; what is to be one of some words, a name
without a slash or a number in a range is said by the type, with `msgspec.Meta`.
"""

from __future__ import annotations

import json
from typing import NoReturn, TypeVar

import msgspec

T = TypeVar("T")
_PATTERN = "Expected `str` matching regex '"  # which says nothing to a user


def decode(text: str | bytes, kind: type[T]) -> T:
    """Return what JSON, in UTF-8, says, as a value of a type that `msgspec.convert` takes.

    Keys that the type does not name are left out. Raise ValueError, of one line, where it is no
    JSON, nests too deeply, or says something else.

    Examples
    --------
    >>> decode('{"job": 1}', dict[str, int])
    {'job': 1}
    >>> decode('{"job": NaN}', dict[str, float])
    Traceback (most recent call last):
    ValueError: it is no JSON: NaN is no number of it
    """
    try:
        # Not msgspec's own: names that are not UTF-8 travel as halves of characters.
        parsed = json.loads(text, parse_constant=_refuse)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except ValueError as error:
        raise ValueError(f"it is no JSON: {error}") from None
    return convert(parsed, kind)


def decode_large(content: bytes, kind: type[T]) -> T:
    """Return the same as `decode`; what the type does not name takes neither memory nor time.

    Names that are not UTF-8 are only read where the type does not name them. A `msgspec.Raw` in the
    type stays as it is, for another call.

    Examples
    --------
    >>> parts = decode_large(b'{"job": 1, "points": [[0, 0], [1, 1]]}', dict[str, msgspec.Raw])
    >>> decode_large(parts["job"], int)
    1
    """
    try:
        return msgspec.json.decode(content, type=kind)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        raise ValueError(_reword(str(error))) from None


def convert(value: object, kind: type[T]) -> T:
    """Return a JSON value as one of a type; ValueError, of one line, where it is something else.

    Examples
    --------
    >>> convert([1, "2"], list[int])
    Traceback (most recent call last):
    ValueError: Expected `int`, got `str` - at `$[1]`
    """
    try:
        return msgspec.convert(value, kind)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None
    except msgspec.ValidationError as error:
        raise ValueError(_reword(str(error))) from None


def _reword(problem: str) -> str:
    before, mark, after = problem.partition(_PATTERN)
    if not mark:
        return problem
    return before + "a text that does not fit" + after.rpartition("'")[2]


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is no number of it")
