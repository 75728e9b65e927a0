"""Point clouds as lines of numbers: .xyz, .txt, .asc and .pts, whose layout is guessed.

The first line of numbers decides: what separates the columns (white space, comma or semicolon)
and how many there are.

======= ============================================================
columns meaning
======= ============================================================
3       x y z
4       x y z intensity
6       x y z nx ny nz, or x y z r g b
7       x y z intensity r g b
9       x y z nx ny nz r g b, or x y z r g b nx ny nz
======= ============================================================

Colours are told from normals by being whole numbers of 0 to 255, some above 1. Intensities are
passed over. A single whole number on the first line announces how many points follow (PTS).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from hpcapp.io.points.point_source import PointSource
from hpcapp.io.rows import Line, is_count, line_error, numbered, parse_table, take_lines, write_rows
from hpcapp.io.staging import replacing
from hpccomponent.errors import InputError
from hpccomponent.surface.types.points import FloatArray, PointCloud

__all__ = ["open_text", "write_text_points"]

_LAYOUTS = (3, 4, 6, 7, 9)
_COMMENTS = ("#", "//")
_PROBED_ROWS = 1 << 12


@dataclass(frozen=True, slots=True)
class _Layout:
    """What the first lines of a file say of the others: a count of points, columns, groups."""

    count_line: Line | None
    delimiter: str | None
    columns: int

    @property
    def count(self) -> int | None:
        return None if self.count_line is None else int(self.count_line[1])


def open_text(path: Path) -> PointSource:
    """Open lines of numbers as a point cloud.

    Blank lines, lines that start with ``#``, ``;`` or ``//`` and what follows ``#`` or ``//``
    on a line are comments.

    Parameters
    ----------
    path : Path
        The file. It is read up to the first number that cannot be of a colour, to tell
        colours from normals.

    Returns
    -------
    PointSource
        Normals as they are in the file, of any length.

    Raises
    ------
    InputError
        Names the first line that does not fit.
    OSError
        The file cannot be read.
    """
    layout = _find_layout(path)
    normals, colours = _tell_groups(path, layout)

    def scan(rows: int) -> Iterator[PointCloud]:
        first = 0
        for table in _read_tables(path, layout, rows):
            yield PointCloud(
                np.ascontiguousarray(table[:, :3]),
                None if normals is None else table[:, normals].copy(),
                None if colours is None else _as_colors(table[:, colours], path, first),
            )
            first += len(table)

    return PointSource(path, layout.count, True, normals is not None, scan)


@contextmanager
def _open_lines(path: Path) -> Iterator[Iterator[Line]]:
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        yield numbered(_without_comments(file))


def _find_layout(path: Path) -> _Layout:
    with _open_lines(path) as lines:
        first = next(lines, None)
        if first is None:
            raise InputError(
                f"{path}: no points: the file has no line of numbers", "check the file"
            )
        count_line = None
        if is_count(first[1].strip()):
            count_line = first
            first = next(take_lines(lines, int(count_line[1]), path, "points"), None)
            if first is None:
                raise InputError(f"{path}: no points: the file announces none", "check the file")
    delimiter = next((mark for mark in (";", ",") if mark in first[1]), None)
    columns = len(first[1].split(delimiter))
    if columns not in _LAYOUTS:
        raise line_error(
            path,
            first,
            f"{columns} columns, none of {', '.join(map(str, _LAYOUTS))}",
            "write x y z, x y z nx ny nz, x y z intensity r g b or x y z nx ny nz r g b; "
            "put # in front of a line of names",
        )
    return _Layout(count_line, delimiter, columns)


def _read_tables(path: Path, layout: _Layout, rows: int) -> Iterator[FloatArray]:
    """Yield the numbers of a file, so many lines at a time; nothing may follow those announced."""
    with _open_lines(path) as lines:
        taken = lines
        if layout.count is not None:
            next(lines)
            taken = take_lines(lines, layout.count, path, "points")
        while len(
            table := parse_table(islice(taken, rows), layout.columns, path, layout.delimiter)
        ):
            yield table
        if layout.count_line is not None:
            for line in lines:
                problem = (
                    f"lines follow after the {layout.count} points "
                    f"that line {layout.count_line[0]} announces"
                )
                raise line_error(path, line, problem, "correct the count, or cut the file there")


def _tell_groups(path: Path, layout: _Layout) -> tuple[slice | None, slice | None]:
    """Return the columns of the normals and of the colours."""
    columns = layout.columns
    if columns < 6:
        return None, None
    groups = [slice(at, at + 3) for at in range(columns % 3 + 3, columns, 3)]
    if columns == 7:
        return None, groups[0]
    bytes_only, above_one = [True] * len(groups), [False] * len(groups)
    for table in _read_tables(path, layout, _PROBED_ROWS):
        for i, group in enumerate(groups):
            bytes_only[i] = bytes_only[i] and bool(_are_bytes(table[:, group]).all())
            above_one[i] = above_one[i] or bool((table[:, group] > 1).any())
        if not bytes_only[0]:
            break
    colored = [b and a for b, a in zip(bytes_only, above_one, strict=True)]
    if columns == 6:
        return (None, groups[0]) if colored[0] else (groups[0], None)
    normals, colours = groups[::-1] if colored == [True, False] else groups
    return normals, colours


def _without_comments(file: TextIO) -> Iterator[str]:
    for line in file:
        if line.lstrip().startswith(";"):
            yield ""
            continue
        for mark in _COMMENTS:
            if mark in line:
                line = line[: line.index(mark)]
        yield line


def _are_bytes(values: FloatArray) -> NDArray[np.bool_]:
    fits: NDArray[np.bool_] = (values >= 0) & (values <= 255) & (values == np.rint(values))
    return fits


def _as_colors(values: FloatArray, path: Path, first: int) -> NDArray[np.uint8]:
    wrong = ~_are_bytes(values).all(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"{path}: point {first + row} has the colour {values[row].tolist()}",
            "colours are whole numbers of 0 to 255",
        )
    return values.astype(np.uint8)


def write_text_points(path: Path, cloud: PointCloud) -> None:
    """Write a point cloud as lines of numbers that `open_text` reads back.

    Parameters
    ----------
    path : Path
        Appears whole or not at all.
    cloud : PointCloud
        Written in the input's frame, to the last digit.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    columns: list[NDArray[np.float64] | NDArray[np.uint8]] = [cloud.positions + cloud.origin]
    if cloud.normals is not None:
        columns.append(cloud.normals)
    elif cloud.colours is not None:
        columns.append(np.zeros((len(cloud), 1), np.uint8))  # an intensity: 6 columns mean normals
    template = " ".join(["%.17g"] * (6 if cloud.normals is not None else 3))
    if cloud.colours is not None:
        columns.append(cloud.colours)
        template += " %d" * (3 if cloud.normals is not None else 4)
    with replacing(path) as file:
        file.writelines(write_rows(template + "\n", np.hstack(columns)))
