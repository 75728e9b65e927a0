"""Blocks of lines into tables of numbers: fast where they are clean, exact where they are not.

A block is parsed at once; where that fails, in small groups of lines; and where that fails, line
by line, which finds missing numbers, surplus ones, and what is no number.
"""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import field
from pathlib import Path

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpcapp.io.points.point_source import Findings
from hpcapp.io.rows import line_error
from hpcapp.io.text.lines import Block
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

_GROUP = 256  # lines that are parsed anew where one of them is odd
_MARKS = ("#", "//", ";", "%", "!")
_COMMENT = r"(?<![^\s,;])#.*|//.*|^[ \t]*[%!].*"  # the # of 1.#QNAN starts none
_COMMENTS = re.compile(rf"{_COMMENT}|^[ \t]*;.*", re.MULTILINE)
_COMMENTS_BUT_SEMICOLONS = re.compile(_COMMENT, re.MULTILINE)
_QUOTED = re.compile(r'"([^"\n]*)"')
_NUMBER = re.compile(r"[+-]?(?:\d++\.?\d*+|\.\d++)(?:[edED][+-]?\d++)?", re.ASCII)
_NOT_FINITE = re.compile(
    r"[+-]?(?:nan(?:\(\w*\))?|inf|infinity|1\.#(?:qnan|snan|ind|inf)\d*)", re.ASCII | re.IGNORECASE
)
_MISSING = ("", "na", "n/a", "null", "none", "-")


@dataclass(frozen=True, slots=True)
class RowFormat:
    """How a row of numbers is written.

    Parameters
    ----------
    separator : str or None
        ``,`` or ``;``; None for blanks and tabs.
    comma : str
        What a comma stands for: itself, ``.`` where it is a decimal comma, or a blank.
    columns : int
        Fields of a row.
    wanted : tuple of int
        Those that are numbers, and read.
    takes_surplus : bool
        Whether a row may have more fields, which are passed over.
    """

    separator: str | None = None
    comma: str = ","
    columns: int = 3
    wanted: tuple[int, ...] = (0, 1, 2)
    takes_surplus: bool = False

    def clean(self, text: str) -> str:
        """Take comments and quotes from as many lines, and make commas what they stand for."""
        text = self.without_comments(text)
        if '"' in text:
            text = _QUOTED.sub(self._unquote, text)
        return text if self.comma == "," else text.replace(",", self.comma)

    def _unquote(self, quoted: re.Match[str]) -> str:
        """Return what stands between quotes, as one word: no name moves the fields behind it."""
        return re.sub(r"[\s,;]", "_", quoted[1].strip())

    def without_comments(self, text: str) -> str:
        """Take comments from as many lines."""
        if not any(mark in text for mark in _MARKS):
            return text
        comments = _COMMENTS_BUT_SEMICOLONS if self.separator == ";" else _COMMENTS
        return comments.sub("", text)

    def split(self, line: str) -> list[str]:
        """Return the fields of a clean line; none of a blank one."""
        if self.separator is None or not line or line.isspace():
            return line.split()
        return [part.strip() for part in line.split(self.separator)]


@dataclass(slots=True, eq=False)
class RowNotes:
    """What is odd about single rows, to be told when all were read."""

    path: Path
    _firsts: dict[str, str] = field(default_factory=dict)
    _counts: dict[str, int] = field(default_factory=dict)

    def note(self, kind: str, sentence: str) -> None:
        """Count a row; rows of one kind are told together, by the sentence of the first."""
        self._firsts.setdefault(kind, sentence)
        self._counts[kind] = self._counts.get(kind, 0) + 1

    def tell(self, findings: Findings) -> None:
        """Warn once of each kind."""
        for kind, sentence in self._firsts.items():
            more = self._counts[kind] - 1
            findings.warn(f"{sentence} ({more} more such lines)" if more else sentence)


def is_number(word: str) -> bool:
    """Tell whether a field, without blanks around it, is a number, perhaps not finite."""
    return bool(_NUMBER.fullmatch(word) or _NOT_FINITE.fullmatch(word))


def is_missing(word: str) -> bool:
    """Tell whether a field, without blanks around it, is empty, or says that it is."""
    return word.lower() in _MISSING


def parse_block(block: Block, rows: RowFormat, notes: RowNotes) -> FloatArray:
    """Parse lines of numbers, (n, len(rows.wanted)); note missing and surplus ones.

    NaN is where a field is empty or says that it holds no number. Raise InputError, which names the
    first line that does not fit, and why.
    """
    number, text = block
    lines = rows.clean(text).split("\n")
    table = _parse_clean(lines, rows)
    if table is not None:
        return table
    parts = []
    for first in range(0, len(lines), _GROUP):
        group = lines[first : first + _GROUP]
        part = _parse_clean(group, rows)
        parts.append(_parse_odd(group, number + first, rows, notes) if part is None else part)
    return np.concatenate(parts)


def parse_sample(lines: list[str], rows: RowFormat) -> FloatArray:
    """Parse those of some clean lines that are as they should be: shape (n, len(rows.wanted))."""
    parts = []
    for first in range(0, len(lines), _GROUP):
        group = lines[first : first + _GROUP]
        part = _parse_clean(group, rows)
        for line in group if part is None else ():
            with suppress(InputError):
                parts.append(_parse_odd([line], 0, rows, RowNotes(Path())))
        if part is not None:
            parts.append(part)
    return np.concatenate(parts) if parts else np.empty((0, len(rows.wanted)))


def _parse_clean(lines: list[str], rows: RowFormat) -> FloatArray | None:
    """Parse lines of which every one is blank or holds all numbers; None if one does not."""
    if not any(line and not line.isspace() for line in lines):
        return np.empty((0, len(rows.wanted)))  # loadtxt would warn
    chosen = None
    if len(rows.wanted) < rows.columns:
        # loadtxt does not count the fields of rows of which it reads a choice
        if any(len(rows.split(line)) not in (0, rows.columns) for line in lines):
            return None
        chosen = rows.wanted
    try:
        table = np.loadtxt(lines, np.float64, None, rows.separator, usecols=chosen, ndmin=2)
    except ValueError:
        return None
    return table if table.shape[1] == len(rows.wanted) else None


def _parse_odd(lines: list[str], number: int, rows: RowFormat, notes: RowNotes) -> FloatArray:
    table = []
    for at, line in enumerate(lines, number):
        fields = rows.split(line)
        if fields:
            _check_width(fields, (at, line), rows, notes)
            table.append([_parse_field(fields[i], (at, line), notes) for i in rows.wanted])
    return np.array(table, np.float64).reshape(-1, len(rows.wanted))


def _check_width(fields: list[str], line: Block, rows: RowFormat, notes: RowNotes) -> None:
    if len(fields) == rows.columns:
        return
    if len(fields) == rows.columns + 1 and not fields[-1]:
        return  # a separator at the end
    expected = f"{len(fields)} columns where {rows.columns} are expected"
    if len(fields) < rows.columns or not rows.takes_surplus:
        bad = next((word for word in fields if word and not is_number(word)), None)
        if bad is not None:
            raise _no_number(bad, line, notes.path)
        raise line_error(notes.path, line, expected, "correct or remove the line")
    notes.note("surplus", f"line {line[0]} has {expected}: the surplus is passed over")


def _parse_field(word: str, line: Block, notes: RowNotes) -> float:
    if _NUMBER.fullmatch(word):
        return float(word.lower().replace("d", "e"))
    if _NOT_FINITE.fullmatch(word):
        return np.nan if "inf" not in word.lower() else -np.inf if word[0] == "-" else np.inf
    if is_missing(word):
        notes.note("missing", f"line {line[0]} has an empty field, read as NaN")
        return np.nan
    raise _no_number(word, line, notes.path)


def _no_number(word: str, line: Block, path: Path) -> InputError:
    is_decimal = "," in word and is_number(word.replace(",", ".", 1))
    advice = "use a decimal point" if is_decimal else "correct or remove the line"
    return line_error(path, line, f"{word[:40]!r} is not a number", advice)
