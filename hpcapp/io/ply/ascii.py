"""The body of an ascii PLY file."""

from __future__ import annotations

import io
from collections.abc import Callable, Container, Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpcapp.io.columns import Numbers, Ragged, Rows
from hpcapp.io.ply.header import Element, Header, Property
from hpcapp.io.rows import Line, line_error, numbered, parse_table, take_lines
from hpccomponent.errors import InputError


def scan_ascii(
    path: Path,
    header: Header,
    wanted: Container[str],
    at_once: int,
    warn: Callable[[str], None] | None = None,
) -> Iterator[tuple[str, Rows]]:
    """Read elements of an ascii file in parts, one line per row; see `scan_body`.

    `warn` is told of more rows than the header says, where these are of the last element, which is
    wanted and has no lists; without it they are refused.
    """
    with path.open("rb") as file, io.TextIOWrapper(file, "latin-1") as text:
        file.seek(header.body_start)
        lines = numbered(text, header.body_line)
        for element in header.elements:
            taken = take_lines(lines, element.count, path, f"rows of element {element.name!r}")
            if element.name not in wanted:
                for _ in taken:
                    pass
                continue
            parse = _parse_uneven if element.lists else _parse_even
            for first in range(0, max(element.count, 1), at_once):
                yield element.name, parse(islice(taken, at_once), element, path, first)
        for line in islice(lines, 1):
            last = header.filled[-1:]
            if warn is None or not last or not _is_more_of(line, last[0], wanted):
                problem = "lines follow after the last element"
                advice = "a count in the header is too small: export the file again"
                raise line_error(path, line, problem, advice)
            rows = last[0].count + 1 + sum(1 for _ in lines)
            warn(f"{rows} rows of element {last[0].name!r}, of which the header announces "
                 f"{last[0].count}: the others are left out")  # fmt: skip


def _is_more_of(line: Line, element: Element, wanted: Container[str]) -> bool:
    columns = len(element.properties)
    return element.name in wanted and not element.lists and len(line[1].split()) == columns


def _parse_even(lines: Iterator[Line], element: Element, path: Path, first: int) -> Rows:
    table = parse_table(lines, len(element.properties), path)
    properties = zip(table.T, element.properties, strict=True)
    return Rows(
        {p.name: _as_announced(column, p, element, path, first) for column, p in properties}, {}
    )


def _parse_uneven(lines: Iterator[Line], element: Element, path: Path, first: int) -> Rows:
    """Parse rows with lists, token by token."""
    values: dict[str, list[float]] = {p.name: [] for p in element.properties}
    lengths: dict[str, list[int]] = {p.name: [] for p in element.properties}
    for line in lines:
        try:
            _take_row([float(token) for token in line[1].split()], element, values, lengths)
        except (ValueError, IndexError, OverflowError):
            problem = f"not a row of element {element.name!r}: {line[1].strip()[:60]!r}"
            raise line_error(path, line, problem, "copy or export the file again") from None
    result = Rows({}, {})
    for p in element.properties:
        column = _as_announced(np.array(values[p.name], np.float64), p, element, path, first)
        if p.count_dtype is None:
            result.scalars[p.name] = column
        else:
            result.lists[p.name] = Ragged(np.array(lengths[p.name], np.int64), column)
    return result


def _take_row(
    numbers: list[float],
    element: Element,
    values: dict[str, list[float]],
    lengths: dict[str, list[int]],
) -> None:
    """Deal the numbers of one row out to its properties; ValueError or IndexError: no such row."""
    at = 0
    for p in element.properties:
        length = 1
        if p.count_dtype is not None:
            length = int(numbers[at])
            if length < 0 or length != numbers[at]:
                raise ValueError(length)
            at += 1
        lengths[p.name].append(length)
        values[p.name].extend(numbers[at : at + length])
        at += length
    if at != len(numbers):
        raise ValueError(at)


def _as_announced(
    column: FloatArray, p: Property, element: Element, path: Path, first: int
) -> Numbers:
    """Return integers as the type that the header announces, if they are of it.

    Decimal numbers stay float64 whatever is announced: nothing is rounded that need not be.
    """
    if p.dtype.startswith("f"):
        return column
    limits = np.iinfo(p.dtype)
    fits = (column >= limits.min) & (column <= limits.max) & (column == np.rint(column))
    if not fits.all():
        at = int(np.argmin(fits))
        raise InputError(
            f"{path}: element {element.name!r}: value {first + at} of {p.name} is {column[at]:g}, "
            f"not of the type {limits.dtype} that the header announces",
            "export the file again",
        )
    return column.astype(p.dtype)
