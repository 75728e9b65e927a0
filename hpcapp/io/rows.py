"""Lines of numbers into tables, fast while they are right and exact about the line that is not.

Used by the readers of ascii PLY, OBJ, OFF and ascii STL.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpcapp.io.columns import Numbers
from hpccomponent.errors import InputError

Line = tuple[int, str]
"""The number of a line in its file, counted from 1, and its text."""

_LINES_AT_ONCE = 16384


def numbered(lines: Iterable[str], first: int = 1) -> Iterator[Line]:
    """Number the lines of a file, from `first`, and leave out the blank ones.

    Examples
    --------
    >>> list(numbered(["1 2", "", "3 4"]))
    [(1, '1 2'), (3, '3 4')]
    """
    return (line for line in enumerate(lines, first) if line[1] and not line[1].isspace())


def is_count(word: str) -> bool:
    """Tell whether a word is a whole number that can count lines: 18 digits at most."""
    return word.isascii() and word.isdecimal() and len(word) <= 18


def parse_index(word: str) -> int:
    """Parse an index, perhaps negative; ValueError if it is none, or beyond 64 bits."""
    index = int(word)
    if index.bit_length() > 63:
        raise ValueError(word)
    return index


def line_error(path: Path, line: Line, problem: str, advice: str) -> InputError:
    """Make the error that names a line of a file."""
    return InputError(f"{path}:{line[0]}: {problem}", advice)


def take_lines(lines: Iterator[Line], count: int, path: Path, rows: str) -> Iterator[Line]:
    """Yield the next `count` lines; InputError, that calls them `rows`, without so many."""
    taken = 0
    for line in islice(lines, count):
        yield line
        taken += 1
    if taken < count:
        raise InputError(
            f"{path}: truncated: {count} {rows} are announced, the file ends after {taken}",
            "copy or export the file again",
        )


def parse_table(lines: Iterator[Line], columns: int, path: Path) -> FloatArray:
    """Parse lines of so many numbers between blanks, as (n, columns).

    Raise InputError, which names the first line that does not fit, and why.
    """
    parts = []
    while chunk := list(islice(lines, _LINES_AT_ONCE)):
        part = _parse([text for _, text in chunk])
        if part is None or part.shape != (len(chunk), columns):
            raise _find_fault(chunk, columns, path)
        parts.append(part)
    return np.concatenate(parts) if parts else np.empty((0, columns))


def _parse(texts: list[str]) -> FloatArray | None:
    if not any(map(str.strip, texts)):
        return None  # loadtxt would warn
    try:
        return np.loadtxt(texts, np.float64, comments=None, ndmin=2)
    except ValueError:
        return None


def _find_fault(chunk: list[Line], columns: int, path: Path) -> InputError:
    """Look line by line for what the fast way stumbled over."""
    for line in chunk:
        row = _parse([line[1]])
        if row is not None and row.size == columns:
            continue
        tokens = line[1].split()
        bad = next((token for token in tokens if not _is_number(token)), None)
        if bad is None:
            problem = f"{len(tokens)} columns where {columns} are expected"
            return line_error(path, line, problem, "correct or remove the line")
        advice = "use a decimal point" if "," in bad else "correct or remove the line"
        return line_error(path, line, f"{bad[:40]!r} is not a number", advice)
    return line_error(path, chunk[0], "lines that are not a table of numbers", "check the file")


def _is_number(token: str) -> bool:
    parsed = _parse([token])
    return parsed is not None and parsed.size == 1


def write_rows(template: str, table: Numbers) -> Iterator[bytes]:
    """Format the rows of a table (n, columns), many at once.

    The template is a row with a %-placeholder per column, ending in a newline.
    """
    for start in range(0, len(table), _LINES_AT_ONCE):
        part = table[start : start + _LINES_AT_ONCE]
        yield (template * len(part) % tuple(part.ravel().tolist())).encode("ascii")
