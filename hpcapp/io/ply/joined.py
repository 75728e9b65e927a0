"""The points of one or several sources as one binary PLY, written in parts."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpcapp.io.ply.columns import choose_type, name_type
from hpcapp.io.ply.comments import keep
from hpcapp.io.points.column_roles import AXES, COLOURS, NORMALS
from hpcapp.io.points.point_source import PointSource
from hpcapp.io.staging import replacing
from hpccomponent.errors import InputError
from hpccomponent.surface.types.points import PointCloud

__all__ = ["write_joined"]

log = logging.getLogger("hpcapp")

SCAN = "scan"
_ROWS_AT_ONCE = 1 << 18
_COUNT_DIGITS = 20  # the count is known when the last point is written


def write_joined(path: Path, sources: Sequence[PointSource]) -> int:
    """Write the points of sources, one after the other, as one PLY.

    Parameters
    ----------
    path : Path
        Appears whole or not at all.
    sources : sequence of PointSource
        One or more. Memory is bounded where all of them stream.

    Returns
    -------
    int
        How many points were written.

    Raises
    ------
    InputError
        A source is damaged, or one has another unit or coordinate reference system.
    OutputError
        The file cannot be written.

    Notes
    -----
    Coordinates are written as ``double``, in those of the sources; normals as ``float``. What
    only some of the sources have is left out, with a warning.
    """
    _refuse_mixed(sources)
    dtype = _common_columns(sources)
    scans = np.cumsum([0, *(len(source.scans) for source in sources)])
    count = 0
    with replacing(path) as file:
        file.write(_make_header(0, dtype, sources))
        for source, first_scan in zip(sources, scans, strict=False):
            for part in source.chunks(_ROWS_AT_ONCE):
                file.write(_make_rows(part, dtype, int(first_scan)).data)
                count += len(part)
        file.seek(0)
        file.write(_make_header(count, dtype, sources))
    return count


def _refuse_mixed(sources: Sequence[PointSource]) -> None:
    """Refuse sources whose coordinates do not mean the same."""
    for what in ("unit", "crs"):
        known = [(source, getattr(source, what)) for source in sources if getattr(source, what)]
        for source, value in known[1:]:
            if value != known[0][1]:
                name = "unit" if what == "unit" else "coordinate reference system"
                raise InputError(
                    f"{source.path} has another {name} than {known[0][0].path}: "
                    f"{str(value)[:60]}, not {str(known[0][1])[:60]}",
                    "convert the files to one frame first",
                )


def _common_columns(sources: Sequence[PointSource]) -> np.dtype[Any]:
    """Return the columns that all sources have, as the fields of a row."""
    held = [_columns_of(next(source.chunks(1))) for source in sources]
    if len(sources) > 1:
        for columns in held:
            columns.setdefault(SCAN, np.dtype(np.int32))
    common = [name for name in held[0] if all(name in columns for columns in held)]
    for columns, source in zip(held, sources, strict=True):
        if left_out := [name for name in columns if name not in common]:
            names = ", ".join(left_out)
            log.warning("warning: %s: left out, as not all files have it: %s", source.path, names)
    types = [np.result_type(*(columns[name] for columns in held)) for name in common]
    return np.dtype([(name, choose_type(kind)) for name, kind in zip(common, types, strict=True)])


def _columns_of(part: PointCloud) -> dict[str, np.dtype[Any]]:
    columns: dict[str, np.dtype[Any]] = dict.fromkeys(AXES, np.dtype(np.float64))
    if part.normals is not None:
        columns |= dict.fromkeys(NORMALS, np.dtype(np.float32))
    if part.colours is not None:
        columns |= dict.fromkeys(COLOURS, part.colours.dtype)
    return columns | {name: values.dtype for name, values in part.attributes.items()}


def _make_rows(part: PointCloud, dtype: np.dtype[Any], first_scan: int) -> NDArray[Any]:
    rows = np.zeros(len(part), dtype)
    columns: dict[str, NDArray[Any]] = dict(part.attributes)
    columns |= zip(AXES, part.positions.T, strict=True)
    if part.normals is not None:
        columns |= zip(NORMALS, part.normals.T, strict=True)
    if part.colours is not None:
        columns |= zip(COLOURS, part.colours.T, strict=True)
    if SCAN in (dtype.names or ()):
        columns[SCAN] = columns.get(SCAN, np.zeros(len(part), np.int32)) + first_scan
    for name in dtype.names or ():
        rows[name] = columns[name]
    return rows


def _make_header(count: int, dtype: np.dtype[Any], sources: Sequence[PointSource]) -> bytes:
    """Return the header; as long for any count."""
    lines = ["ply", "format binary_little_endian 1.0", "comment written by hpcapp"]
    lines += keep(sources)
    lines += [f"element vertex {count}"]
    for name in dtype.names or ():
        lines.append(f"property {name_type(dtype[name].str)} {name.replace(' ', '_')}")
    filling = "comment ".ljust(8 + _COUNT_DIGITS - len(str(count)), "-")
    return "\n".join([*lines, filling, "end_header\n"]).encode("utf-8")
