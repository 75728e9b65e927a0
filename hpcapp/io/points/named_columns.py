"""Columns that have names, put together to a point cloud: those of PLY, PCD and NumPy files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.point_records import Column, PointRecords, colour_type
from hpcapp.geometry.points import FloatArray, IntArray, PointCloud
from hpcapp.io.columns import Numbers
from hpcapp.io.points.column_roles import AXES, COLOURS, MOST_COLUMNS, NORMALS, find_role
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

_ROWS_AT_ONCE = 1 << 16

Number = TypeVar("Number", bound=np.generic)


@dataclass(frozen=True, slots=True)
class ColumnPlan:
    """What the columns of a file are to be, by their names in the file.

    Positions, normals and colours are three names each, the last two none where the file has none;
    attributes are the other columns: our name of each, and the file's.
    """

    positions: tuple[str, ...]
    normals: tuple[str, ...]
    colours: tuple[str, ...]
    attributes: tuple[tuple[str, str], ...]


def plan_columns(names: Sequence[str], place: str) -> ColumnPlan:
    """Tell what columns are by their names; messages say in what `place` they are.

    Where two have one role, it goes to the one that is spelled like it, else to the first; the
    other is an attribute. Raise InputError where a coordinate, or a component of normals beside
    others, is missing, or there are more columns than `MOST_COLUMNS`.

    Examples
    --------
    >>> plan_columns(["X", "Y", "Z", "height", "diffuse_red", "class"], "a.ply").attributes
    (('height', 'height'), ('diffuse_red', 'diffuse_red'), ('classification', 'class'))
    """
    if len(names) > MOST_COLUMNS:
        raise InputError(
            f"{place} has {len(names)} columns, more than {MOST_COLUMNS}", "export fewer of them"
        )
    by_role = _assign_roles(names)
    positions, normals = _pick(by_role, AXES), _pick(by_role, NORMALS)
    colours = _pick(by_role, COLOURS)
    if not positions:
        missing = ", ".join(axis for axis in AXES if axis not in by_role)
        raise InputError(f"{place} has no {missing}", "export the file with coordinates x, y and z")
    present = ", ".join(name for name in NORMALS if name in by_role)
    if present and not normals:
        raise InputError(
            f"{place} has {present} but not all of nx, ny, nz",
            "export the file with whole normals, or without",
        )
    taken = {*positions, *normals, *colours}
    attributes = tuple((_own_name(name, by_role), name) for name in names if name not in taken)
    return ColumnPlan(positions, normals, colours, attributes)


def _assign_roles(names: Sequence[str]) -> dict[str, str]:
    by_role: dict[str, str] = {}
    for name in sorted(names, key=lambda name: find_role(name) != name.lower()):
        by_role.setdefault(find_role(name), name)
    return by_role


def _pick(by_role: Mapping[str, str], roles: Sequence[str]) -> tuple[str, ...]:
    """Return the names of the columns that have some roles; none where one has no column."""
    names = tuple(by_role[role] for role in roles if role in by_role)
    return names if len(names) == len(roles) else ()


def _own_name(name: str, by_role: Mapping[str, str]) -> str:
    """Return the name of an attribute: its role, where it has one for itself alone."""
    role = find_role(name)
    return name if by_role[role] != name or role in COLOURS else role


def build_cloud(columns: Mapping[str, Numbers], plan: ColumnPlan) -> PointCloud:
    """Copy columns, of any numeric type and byte order, into a point cloud.

    Colours stay as they are: uint8, uint16 or float32.
    """
    colours = None
    if plan.colours:
        dtype = colour_type(columns[name].dtype for name in plan.colours)
        colours = _stack(columns, plan.colours, dtype)
    return PointCloud(
        stack(columns, plan.positions),
        stack(columns, plan.normals) if plan.normals else None,
        colours,
        {
            ours: columns[name].astype(columns[name].dtype.newbyteorder("="))
            for ours, name in plan.attributes
        },
    )


def stack(columns: Mapping[str, Numbers], names: Sequence[str]) -> FloatArray:
    """Copy columns, in the order of their names, into those of one array."""
    return _stack(columns, names, np.dtype(np.float64))


def _stack(
    columns: Mapping[str, Numbers], names: Sequence[str], dtype: np.dtype[Number]
) -> NDArray[Number]:
    """Copy block by block, for the cache."""
    chosen = [columns[name] for name in names]
    stacked = np.empty((len(chosen[0]), len(chosen)), dtype)
    with np.errstate(invalid="ignore", over="ignore"):  # colours that are none
        for start in range(0, len(stacked), _ROWS_AT_ONCE):
            block = slice(start, start + _ROWS_AT_ONCE)
            for i, column in enumerate(chosen):
                stacked[block, i] = column[block]
    return stacked


def add_grid(cloud: PointCloud, cells: IntArray, width: int) -> PointCloud:
    """Give the points of an organised scan attributes ``row`` and ``column``.

    Their cells (n,) are numbered row by row; those in none have -1, as are row and column.
    """
    row, column = np.divmod(cells, width)
    column[cells < 0] = -1
    places = {"row": row.astype(np.int32), "column": column.astype(np.int32)}
    return replace(cloud, attributes={**cloud.attributes, **places})


def describe_records(
    path: Path, start: int, length: int, count: int, columns: Mapping[str, Column], plan: ColumnPlan
) -> PointRecords:
    """Describe points in a binary file, to be read from any of them on; see `PointRecords`."""

    def pick(names: tuple[str, ...]) -> tuple[Column, ...]:
        return tuple(columns[name] for name in names)

    return PointRecords(
        str(path), start, length, count, pick(plan.positions), pick(plan.normals),
        pick(plan.colours), tuple((ours, columns[name]) for ours, name in plan.attributes),
    )  # fmt: skip
