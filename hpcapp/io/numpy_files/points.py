"""Point clouds of NumPy: .npy and .npz.

===========================  =======================================================
array                        taken for
===========================  =======================================================
(n, 3 to 16)                 columns x y z, the others as in a text without names
(3, n) or (6, n), n > 16     the same, transposed, with a warning
(h, w, 3 to 16)              a grid of points
records (n,) or (h, w)       columns by the names of their fields
several, in an .npz          positions, normals and colours by name; arrays of n numbers
                             are attributes
===========================  =======================================================
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.point_records import Column, PointRecords
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io.columns import Numbers
from hpcapp.io.numpy_files.arrays import is_archive, map_array, read_archive
from hpcapp.io.points.column_roles import AXES, COLOURS, NORMALS
from hpcapp.io.points.named_columns import (
    ColumnPlan,
    add_grid,
    build_cloud,
    describe_records,
    plan_columns,
)
from hpcapp.io.points.packed_colours import PACKED, unpack_words
from hpcapp.io.points.point_source import Findings, PointSource, Scan
from hpcapp.io.text.columns import assign_by_value
from hpccomponent.errors import InputError

Columns = dict[str, Numbers]
Mapped = np.memmap[tuple[int, ...], np.dtype[np.number]]

_MOST_COLUMNS = 16
_EXACT_IN_SINGLE = {"f2", "f4", "i1", "u1", "i2", "u2"}
_RUNS, _RUN = 16, 1024  # rows that tell what columns without names are
_POSITIONS = (
    "positions", "position", "points", "point", "xyz", "vertices", "verts", "coords", "coord",
    "coordinates", "pos", "pcd", "pc", "cloud", "pointcloud", "point_cloud", "data", "arr_0",
)  # fmt: skip
_NORMALS = ("normals", "normal", "vertex_normals", "nxnynz", "nxyz", "n")
_COLOURS = ("colours", "colors", "colour", "color", "rgb", "rgba", "vertex_colors", "c")
_GROUPS: dict[str, tuple[tuple[str, ...], tuple[int, ...]]] = {
    **dict.fromkeys(_POSITIONS, (AXES, (3,))),
    **dict.fromkeys(_NORMALS, (NORMALS, (3,))),
    **dict.fromkeys(_COLOURS, (COLOURS, (3, 4))),
}
"""By the name of an array, what its columns are, and how many they may be."""

_EXPORT = "save points as (n, 3) numbers, or as records with fields x, y and z"


def open_npy(path: Path) -> PointSource:
    """Open a NumPy file: NPY, which is read in parts, or NPZ, which is read whole.

    Raise InputError where it is damaged, is a pickle, or holds no points.
    """
    findings = Findings()
    mapped = None if is_archive(path) else map_array(path)
    if mapped is None:
        columns, grid = _columns_of_archive(path, read_archive(path, findings), findings)
    else:
        columns, grid = _columns_of_array(path, mapped, findings)
    plan = plan_columns(list(columns), f"{path}: the file")
    count = len(columns[plan.positions[0]])
    types = {columns[axis].dtype.str[1:] for axis in plan.positions}
    records = None
    if isinstance(mapped, np.memmap):
        following = path.stat().st_size - mapped.offset - mapped.nbytes
        if following:
            findings.warn(f"{following} bytes follow after the array: they are left out")
        records = _find_records(path, mapped, columns, plan) if grid is None else None

    def scan(rows: int) -> Iterator[PointCloud]:
        for start in range(0, max(count, 1), rows):
            part = {name: column[start : start + rows] for name, column in columns.items()}
            cloud = build_cloud(part, plan)
            cells = np.arange(start, start + len(cloud))
            yield cloud if grid is None else add_grid(cloud, cells, grid[0])

    return PointSource(
        path, count, not types <= _EXACT_IN_SINGLE, bool(plan.normals),
        scan if records is None else records.scan,
        records, None if records is None else lambda: None, "NPZ" if mapped is None else "NPY",
        tuple(columns), (Scan(count, grid=grid),), findings=findings,
    )  # fmt: skip


def _find_records(
    path: Path, mapped: Mapped, columns: Columns, plan: ColumnPlan
) -> PointRecords | None:
    """Describe the rows of a mapped array as records; None where its columns are in no rows."""
    length, start = mapped.strides[0], mapped.ctypes.data
    placed: dict[str, Column] = {}
    for name, column in columns.items():
        at = column.ctypes.data - start
        if column.strides != (length,) or not 0 <= at < length:
            return None
        placed[name] = (at, column.dtype.str)
    count = len(columns[plan.positions[0]])
    return describe_records(path, mapped.offset, length, count, placed, plan)


def _columns_of_array(
    path: Path, array: Numbers, findings: Findings
) -> tuple[Columns, tuple[int, int] | None]:
    """Return the columns of one array, and width and height of a grid."""
    if array.dtype.names:
        grid = (array.shape[1], array.shape[0]) if array.ndim == 2 else None
        return _columns_of_records(path, cast("NDArray[np.void]", array.reshape(-1))), grid
    if array.dtype.kind not in "fiu":
        raise InputError(f"{path}: an array of {array.dtype}, not of numbers", _EXPORT)
    shape, grid = array.shape, None
    match shape:
        case (3 | 6, count) if count > _MOST_COLUMNS:
            findings.warn(f"shape {shape}: taken for points whose axes are swapped")
            array = array.T
        case (_, _, _) if array.dtype.itemsize == 1:
            problem = f"shape {shape} of {array.dtype}: a picture, no points"
            raise InputError(f"{path}: {problem}", _EXPORT)
        case (height, width, columns):
            grid = width, height
            array = array.reshape(-1, columns)
    if array.ndim != 2 or not len(AXES) <= array.shape[1] <= _MOST_COLUMNS:
        counted = f"{array.shape[1]} columns, " if array.ndim == 2 else ""
        raise InputError(
            f"{path}: {counted}shape {shape}: not points of 3 to {_MOST_COLUMNS} columns", _EXPORT
        )
    return _columns_of_table(path, array, findings), grid


def _columns_of_table(path: Path, table: Numbers, findings: Findings) -> Columns:
    """Name the columns of a table by what they can be."""
    roles: tuple[str, ...] = AXES
    if table.shape[1] > len(AXES):
        rows = _sample(table)
        rows = rows[np.isfinite(rows).all(axis=1)]
        roles = assign_by_value(path, rows, tuple(range(table.shape[1])), findings).roles
    return dict(zip(roles, table.T, strict=True))


def _sample(table: Numbers) -> FloatArray:
    """Return runs of rows from all over a table, which may be a mapped file."""
    starts = np.linspace(0, max(len(table) - _RUN, 0), _RUNS).astype(np.int64)
    runs = [table[start : start + _RUN] for start in np.unique(starts)]
    return np.concatenate(runs).astype(np.float64)


def _columns_of_records(path: Path, records: NDArray[np.void]) -> Columns:
    columns: Columns = {}
    for name in records.dtype.names or ():
        _add_columns(columns, name, records[name])
    if not columns:
        raise InputError(f"{path}: records without numbers", _EXPORT)
    return columns


def _columns_of_archive(
    path: Path, arrays: dict[str, Numbers], findings: Findings
) -> tuple[Columns, tuple[int, int] | None]:
    """Return the columns of several arrays; those that do not belong to points are passed over."""
    coordinates = _find_coordinates(path, arrays)
    columns: Columns = {}
    grid, count = None, arrays[coordinates[0]].size
    others = arrays
    if len(coordinates) == 1:
        columns, grid = _columns_of_array(path, arrays[coordinates[0]], findings)
        count = len(next(iter(columns.values())))
        others = {name: array for name, array in arrays.items() if name not in coordinates}
    for name, array in others.items():
        if grid is not None and array.shape[:2] == grid[::-1]:
            array = array.reshape(count, *array.shape[2:])
        if array.shape[:1] != (count,) or not _add_columns(columns, name, array):
            findings.warn(f"array {name!r} of shape {array.shape} is passed over")
    return columns, grid


def _find_coordinates(path: Path, arrays: Columns) -> list[str]:
    """Return the name of the array of points, or the names of those of x, y and z."""
    if len(arrays) == 1 and any(only.dtype.names or only.ndim > 1 for only in arrays.values()):
        return list(arrays)
    lower = {name.lower(): name for name in arrays}
    for known in _POSITIONS:
        if known in lower:
            return [lower[known]]
    if set(AXES) <= lower.keys():
        return [lower["x"], lower["y"], lower["z"]]
    named = ", ".join(list(arrays)[:5]) or "nothing"
    raise InputError(f"{path}: no array of points: it holds {named}", "name one 'points'")


def _add_columns(columns: Columns, name: str, values: Numbers) -> bool:
    """Add what a field or an array holds; False where that is none that points can have."""
    if values.dtype.kind not in "fiub" or values.ndim > 2 or name in columns:
        return False
    if values.ndim == 2 and values.shape[1] == 1:
        values = values[:, 0]
    if values.ndim == 2:
        names, widths = _GROUPS.get(name.lower(), ((), ()))
        if values.shape[1] not in widths:
            return False
        columns.update(zip(names, values.T, strict=False))  # without alpha
    elif name.lower() in ("rgb", "rgba") and values.dtype.itemsize == 4:
        columns.update({colour: unpack_words(values, byte) for colour, byte in PACKED})
    else:
        columns[name] = values
    return True
