"""What the first lines of a text file, and samples of the others, say about its rows."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpcapp.io.points.column_roles import (
    AXES,
    COLOURS,
    MOST_COLUMNS,
    NORMALS,
    find_role,
    name_some,
    spell_letters,
)
from hpcapp.io.points.point_source import Findings
from hpcapp.io.rows import Line, is_count, line_error, numbered
from hpcapp.io.text.leading import are_point_numbers, find_named_order
from hpcapp.io.text.lines import find_encoding, read_blocks, sample_lines
from hpcapp.io.text.tables import RowFormat, is_missing, is_number, parse_sample
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

_COMMENT_MARK = re.compile(r"\s*(?:#+|//+|;+|%+|!+)\s*")
_DECIMAL_COMMA = re.compile(r"[+-]?\d*+,\d+(?:[eE][+-]?\d+)?", re.ASCII)
_COMMA_AND_DIGIT = re.compile(r",\d", re.ASCII)
_LONGEST_COUNT = 24
_MOST_COUNTS = 10_000
_HEAD_ROWS = 1 << 12
_PROBED_ROWS = 1 << 11


@dataclass(frozen=True, slots=True)
class TextLayout:
    """How a text file is made: in which line the rows begin, and what stands before.

    Counts are lines that announce a number of rows (PTS has one for each scan), and these numbers;
    names those of all columns, as the file has them; none where there are too few.
    """

    encoding: str
    first_row: int
    counts: tuple[tuple[int, int], ...]
    names: tuple[str, ...] | None
    rows: RowFormat


@dataclass(slots=True)
class _Head:
    """What stands before the rows."""

    count: tuple[int, int] | None = None
    names: tuple[str, ...] | None = None
    names_line: Line = (0, "")
    commented_names: tuple[str, ...] | None = None

    def leave_out(self, texts: list[str]) -> list[str]:
        """Return the lines but those that have its names, or a count as it has one."""
        if self.names:  # which are the start of what lies elsewhere
            texts = [text for text in texts if text.strip() != self.names_line[1].strip()]
        return [text for text in texts if not is_count(text.strip())] if self.count else texts


def find_layout(path: Path, findings: Findings) -> tuple[TextLayout, FloatArray]:
    """Find out how a text file is made; warn of what is odd, and of columns that are passed over.

    Return sound rows from all over the file, too, (n, len(layout.rows.wanted)). Raise InputError,
    which names the line that is neither numbers nor names, or says which columns are missing.
    """
    encoding = find_encoding(path)
    number, text = next(read_blocks(path, encoding), (1, ""))
    lines = numbered(text.split("\n"), number)
    head, first = _read_head(lines, path, findings)
    elsewhere = sample_lines(path, encoding)
    following = islice(lines, _HEAD_ROWS) if elsewhere else lines
    texts = head.leave_out([first[1], *(text for _, text in following), *elsewhere])
    rows = _find_separator(_thin(texts), first, path)
    texts = [text for text in rows.clean("\n".join(texts)).split("\n") if text.strip()]
    fields = [rows.split(text) for text in _thin(texts)]
    if not fields:
        raise InputError(f"{path}: no points: the file has no line of numbers", "check the file")
    rows = replace(rows, columns=Counter(map(len, fields)).most_common(1)[0][0])
    fields = [row for row in fields if len(row) == rows.columns]
    if rows.columns > MOST_COLUMNS:
        problem = f"{rows.columns} columns, more than {MOST_COLUMNS}"
        raise line_error(path, first, problem, "export fewer of them")
    names = _match_names(head, fields, path, findings)
    rows = replace(
        rows,
        wanted=_find_numbers(fields, names, first, path, findings),
        takes_surplus=names is not None,
    )
    sample = parse_sample(texts, rows)
    is_named = bool(find_named_order(path)) and rows.wanted[0] == 0 and len(rows.wanted) > len(AXES)
    if names is None and (is_named or are_point_numbers(sample)):
        findings.warn(f"column {rows.wanted[0] + 1} counts the points, and is passed over")
        rows, sample = replace(rows, wanted=rows.wanted[1:]), sample[:, 1:]
    counts = _find_counts(path, encoding, head.count) if head.count else ()
    return TextLayout(encoding, first[0], counts, names, rows), sample


def _thin(texts: list[str]) -> list[str]:
    """Return some of the lines, from all over."""
    return texts[:: 1 + len(texts) // _PROBED_ROWS]


def _read_head(lines: Iterator[Line], path: Path, findings: Findings) -> tuple[_Head, Line]:
    """Read up to the first row, and return that too."""
    head = _Head()
    for line in lines:
        text = line[1].strip()
        if mark := _COMMENT_MARK.match(text):
            names = _split_names(text[mark.end() :])
            head.commented_names = names if _has_axes(names) else head.commented_names
        elif is_count(text) and head.count is None:
            head.count = line[0], int(text)
        elif _is_row(text):
            return head, line
        elif not _may_be_names(text) or head.names is not None:
            problem = f"neither numbers nor names of columns: {text[:40]!r}"
            raise line_error(path, line, problem, "put # in front of lines that are no numbers")
        elif head.count is None or _has_axes(_split_names(text)):
            head.names, head.names_line = _split_names(text), line
        else:  # as the .xyz files of chemists have it
            findings.warn(f"line {line[0]} is no row of numbers, and is passed over")
    raise InputError(f"{path}: no points: the file has no line of numbers", "check the file")


def _is_row(text: str) -> bool:
    """Tell whether a line holds numbers, three at least unless it has nothing else."""
    words = [word for word in re.split(r"[\s,;]+", text.replace('"', " ")) if word]
    numbers = sum(map(is_number, words))
    return numbers >= 3 or 0 < numbers == len(words)


def _may_be_names(text: str) -> bool:
    return not any(map(is_number, _split_names(text)))


def _split_names(text: str) -> tuple[str, ...]:
    separator = _find_mark(text, ";\t,")
    names = text.split() if not separator else _split_quoted(text.strip(" "), separator)
    names = [name.strip().strip("\"'").strip() for name in names]
    while names and not names[-1]:
        names.pop()  # a separator at the end
    return spell_letters(names)


def _find_mark(text: str, marks: str) -> str:
    """Return the first of some marks that a text has; nothing where it has none."""
    return next((mark for mark in marks if mark in text), "")


def _split_quoted(text: str, separator: str) -> list[str]:
    """Split where the separator is not within quotes."""
    with suppress(csv.Error):  # a field of more than 128 KiB
        return next(csv.reader([text], delimiter=separator, skipinitialspace=True), [])
    return []


def _has_axes(names: Iterable[str]) -> bool:
    return set(AXES) <= set(map(find_role, names))


def _find_separator(texts: list[str], first: Line, path: Path) -> RowFormat:
    """Tell what separates the numbers in most of the rows, and what their commas are."""
    texts = RowFormat().without_comments("\n".join(texts)).split("\n")
    marks = [_find_mark(text, ";,") for text in texts if text.strip()]
    mark = Counter(marks or [""]).most_common(1)[0][0]
    if not mark:
        return RowFormat()
    texts = [text for text in texts if mark in text]
    if mark == ",":
        return _judge_commas(texts, first, path)
    return RowFormat(";", "." if any(map(_COMMA_AND_DIGIT.search, texts)) else ",")


def _judge_commas(texts: list[str], first: Line, path: Path) -> RowFormat:
    words = [text.replace('"', "").split() for text in texts]
    if all(len(row) >= 3 and all(map(_may_be_decimal, row)) for row in words):
        if all("\t" in text for text in texts):
            return RowFormat(None, ".")
        problem = "is the comma a decimal comma, or does it separate numbers?"
        raise line_error(path, first, problem, "use a decimal point")
    quoted = (word for text in texts if '"' in text for word in _split_quoted(text, ","))
    if any(map(_DECIMAL_COMMA.fullmatch, quoted)):
        raise line_error(path, first, "decimal commas within quotes", "use a decimal point")
    texts = RowFormat(",").clean("\n".join(texts)).split("\n")
    parts = [part.split() for text in texts for part in text.split(",")]
    with_blanks = sum(len(part) > 1 and all(map(is_number, part)) for part in parts)
    return RowFormat(None, " ") if with_blanks >= len(texts) else RowFormat(",")


def _may_be_decimal(word: str) -> bool:
    return bool(_DECIMAL_COMMA.fullmatch(word)) or (is_number(word) and "." not in word)


def _match_names(
    head: _Head, fields: list[list[str]], path: Path, findings: Findings
) -> tuple[str, ...] | None:
    """Compare the names with the columns; None where there are no names."""
    names, columns = head.names, len(fields[0])
    if names is None:
        named = head.commented_names
        return named if named and len(named) == columns else None
    missing = set(AXES) - set(map(find_role, names))
    if missing:
        problem = f"no column is named {', '.join(sorted(missing)).upper()}: {', '.join(names)}"
        raise line_error(path, head.names_line, problem[:200], "name the columns x, y and z")
    if len(names) > columns:
        problem = f"{len(names)} names for {columns} columns"
        raise line_error(path, head.names_line, problem, "name every column once")
    if any(word for row in fields for word in row[len(names) :]):
        findings.warn(
            f"{len(names)} names for {columns} columns: those after {names[-1]!r} are passed over"
        )
    return names + ("",) * (columns - len(names))


def _find_numbers(
    fields: list[list[str]],
    names: tuple[str, ...] | None,
    first: Line,
    path: Path,
    findings: Findings,
) -> tuple[int, ...]:
    """Return the columns that hold numbers, and shall be read."""
    shares = [_share_of_numbers(column) for column in zip(*fields, strict=True)]
    if names is None:
        wanted = tuple(i for i, share in enumerate(shares) if share > 0)
        for i, share in enumerate(shares):
            if share == 0:
                findings.warn(f"column {i + 1} holds no numbers, and is passed over")
    else:
        wanted = _choose_by_name(names, shares, findings)
    if len(wanted) < 3:
        problem = f"{len(wanted)} columns of numbers, x, y and z are 3"
        raise line_error(path, first, problem, "check the file")
    return wanted


def _share_of_numbers(column: Sequence[str]) -> float:
    """Return the share of a column's words that are numbers; NaN where there are none."""
    are_numbers = [is_number(word) for word in column if not is_missing(word)]
    return sum(are_numbers) / len(are_numbers) if are_numbers else math.nan


def _choose_by_name(
    names: tuple[str, ...], shares: list[float], findings: Findings
) -> tuple[int, ...]:
    """Choose coordinates, what normals and colours have numbers, and named columns of numbers."""
    wanted, mixed = [], []
    for i, (name, share) in enumerate(zip(names, shares, strict=True)):
        role = find_role(name)
        least = 0.0 if role in NORMALS + COLOURS else 1.0
        if role in AXES or (name and 0 < share >= least):
            wanted.append(i)
        elif name and share > 0:  # without any number it is names or dates: nothing of a mesh
            mixed.append(name)
    if mixed:
        findings.warn(f"left out, as not all of a column is numbers: {name_some(mixed)}")
    return tuple(wanted)


def _find_counts(
    path: Path, encoding: str, announced: tuple[int, int]
) -> tuple[tuple[int, int], ...]:
    """Find all lines that announce a number of rows, from the first on."""
    counts = [announced]
    for number, text in read_blocks(path, encoding):
        letters = np.frombuffer(text.encode("latin-1", "replace"), np.uint8)
        ends = np.append(np.flatnonzero(letters == ord("\n")), len(letters))
        lengths = np.diff(ends, prepend=-1)
        for i in np.flatnonzero((lengths > 1) & (lengths <= _LONGEST_COUNT)).tolist():
            word = text[ends[i] + 1 - lengths[i] : ends[i]].strip()
            if is_count(word) and number + i > announced[0]:
                counts.append((number + i, int(word)))
        if len(counts) > _MOST_COUNTS:
            problem = f"more than {_MOST_COUNTS} lines announce points"
            raise InputError(f"{path}: {problem}", "check whether the file holds x, y and z")
    return tuple(counts)
