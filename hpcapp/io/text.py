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
from itertools import chain
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from hpcapp.io.frame import to_local
from hpcapp.io.rows import Line, is_count, line_error, numbered, parse_table, take_lines, write_rows
from hpcapp.io.staging import replacing
from hpccomponent.errors import InputError
from hpccomponent.surface.points import FloatArray, PointCloud

__all__ = ["read_text_points", "write_text_points"]

_LAYOUTS = (3, 4, 6, 7, 9)
_COMMENTS = ("#", "//")


def read_text_points(path: Path) -> PointCloud:
    """Read lines of numbers as a point cloud.

    Blank lines, lines that start with ``#``, ``;`` or ``//`` and what follows ``#`` or ``//``
    on a line are comments.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    PointCloud
        Normals as they are in the file, of any length.

    Raises
    ------
    InputError
        Names the first line that does not fit.
    OSError
        The file cannot be read.
    """
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        lines = numbered(_without_comments(file))
        first = next(lines, None)
        if first is None:
            raise InputError(
                f"{path}: no points: the file has no line of numbers", "check the file"
            )
        if is_count(first[1].strip()):
            return _read_counted(lines, first, path)
        return _read_table(chain([first], lines), path)


def _without_comments(file: TextIO) -> Iterator[str]:
    for line in file:
        if line.lstrip().startswith(";"):
            yield ""
            continue
        for mark in _COMMENTS:
            if mark in line:
                line = line[: line.index(mark)]
        yield line


def _read_counted(lines: Iterator[Line], count_line: Line, path: Path) -> PointCloud:
    """Read the points that a count line announces, and nothing may follow."""
    count = int(count_line[1])
    cloud = _read_table(take_lines(lines, count, path, "points"), path)
    for line in lines:
        problem = f"lines follow after the {count} points that line {count_line[0]} announces"
        raise line_error(path, line, problem, "correct the count, or cut the file there")
    return cloud


def _read_table(lines: Iterator[Line], path: Path) -> PointCloud:
    first = next(lines, None)
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
    table = parse_table(chain([first], lines), columns, path, delimiter)
    normals, colors = _interpret(table, path)
    positions, origin = to_local(np.ascontiguousarray(table[:, :3]))
    return PointCloud(positions, normals, colors, origin)


def _interpret(table: FloatArray, path: Path) -> tuple[FloatArray | None, NDArray[np.uint8] | None]:
    """Find normals and colours in the columns after x y z."""
    columns = table.shape[1]
    if columns < 6:
        return None, None
    groups = [table[:, at : at + 3] for at in range(columns % 3 + 3, columns, 3)]
    if columns == 7:
        return None, _as_colors(groups[0], path)
    if columns == 6:
        normals, colors = (None, groups[0]) if _looks_colored(groups[0]) else (groups[0], None)
    elif _looks_colored(groups[0]) and not _looks_colored(groups[1]):
        colors, normals = groups
    else:
        normals, colors = groups
    return (
        None if normals is None else normals.copy(),
        None if colors is None else _as_colors(colors, path),
    )


def _looks_colored(values: FloatArray) -> bool:
    return bool(_are_bytes(values).all() and (values > 1).any())


def _are_bytes(values: FloatArray) -> NDArray[np.bool_]:
    fits: NDArray[np.bool_] = (values >= 0) & (values <= 255) & (values == np.rint(values))
    return fits


def _as_colors(values: FloatArray, path: Path) -> NDArray[np.uint8]:
    wrong = ~_are_bytes(values).all(axis=1)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise InputError(
            f"{path}: point {row} has the colour {values[row].tolist()}",
            "colours are whole numbers of 0 to 255",
        )
    return values.astype(np.uint8)


def write_text_points(path: Path, cloud: PointCloud) -> None:
    """Write a point cloud as lines of numbers that `read_text_points` reads back.

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
    elif cloud.colors is not None:
        columns.append(np.zeros((len(cloud), 1), np.uint8))  # an intensity: 6 columns mean normals
    template = " ".join(["%.17g"] * (6 if cloud.normals is not None else 3))
    if cloud.colors is not None:
        columns.append(cloud.colors)
        template += " %d" * (3 if cloud.normals is not None else 4)
    with replacing(path) as file:
        file.writelines(write_rows(template + "\n", np.hstack(columns)))
