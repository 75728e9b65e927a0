"""The vertices of a PLY file as a point cloud."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from hpcapp.io.columns import Rows
from hpcapp.io.ply.ascii import scan_ascii
from hpcapp.io.ply.binary import find_records, scan_binary
from hpcapp.io.ply.header import Element, Header, read_header
from hpcapp.io.points.point_source import PointSource
from hpccomponent.errors import InputError
from hpccomponent.surface.cloud.point_records import Column, PointRecords
from hpccomponent.surface.types.points import FloatArray, PointCloud

__all__ = ["AXES", "COLORS", "NORMALS", "open_ply", "stack", "vertex_of"]

AXES = ("x", "y", "z")
NORMALS = ("nx", "ny", "nz")
COLORS = ("red", "green", "blue")
_ROWS_AT_ONCE = 1 << 16


def open_ply(path: Path) -> PointSource:
    """Open the vertices of a PLY file.

    Properties other than coordinates, normals and colours of one byte are passed over, as are
    all elements but ``vertex``.

    Parameters
    ----------
    path : Path
        ascii or binary in either byte order.

    Returns
    -------
    PointSource
        Normals as they are in the file, of any length.

    Raises
    ------
    InputError
        The file has no vertices with coordinates, or is cut before their end.
    OSError
        The file cannot be read.
    """
    header = read_header(path)
    vertex = vertex_of(header, path)
    types = {p.name: p.dtype for p in vertex.properties if p.count_dtype is None}
    present = [name for name in NORMALS if name in types]
    if present and len(present) < len(NORMALS):
        raise InputError(
            f"{path}: element 'vertex' has {', '.join(present)} but not all of nx, ny, nz",
            "export the file with whole normals, or without",
        )

    records = _find_points(path, header, vertex) if header.byte_order else None

    def scan(rows: int) -> Iterator[PointCloud]:
        if records is not None:
            for start in range(0, max(records.count, 1), rows):
                yield records.read(start, min(start + rows, records.count))
            check_rest()
            return
        read = scan_binary if header.byte_order else scan_ascii
        for _, part in read(path, header, {vertex.name}, rows):
            yield _points(part)

    def check_rest() -> None:
        for _ in scan_binary(path, header, (), 1):
            """Nothing is asked for: all is measured."""

    return PointSource(
        path,
        vertex.count,
        not header.byte_order or any(types[name] not in _SINGLE for name in AXES),
        bool(present),
        scan,
        records,
        check_rest,
    )


def _find_points(path: Path, header: Header, vertex: Element) -> PointRecords | None:
    """Describe the vertices of a binary file as records; None where they differ in length."""
    found = find_records(path, header, vertex.name)
    if found is None:
        return None
    start, dtype = found
    columns: dict[str, Column] = {}
    for number, p in enumerate(vertex.properties):
        if p.count_dtype is None:
            assert dtype.fields is not None  # noqa: S101 - it has these
            kind, offset = dtype.fields[f"v{number}"][:2]
            columns[p.name] = (int(offset), kind.str)
    has_colours = all(columns.get(name, (0, ""))[1] == "|u1" for name in COLORS)
    return PointRecords(
        str(path), start, dtype.itemsize, vertex.count, _pick(columns, AXES),
        _pick(columns, NORMALS) if NORMALS[0] in columns else (),
        _pick(columns, COLORS) if has_colours else (),
    )  # fmt: skip


def _pick(columns: dict[str, Column], names: tuple[str, ...]) -> tuple[Column, ...]:
    return tuple(columns[name] for name in names)


_SINGLE = ("f4", "i1", "u1", "i2", "u2")  # what float32 holds exactly


def vertex_of(header: Header, path: Path) -> Element:
    """Return the element ``vertex`` of a header, which must have coordinates.

    Parameters
    ----------
    header : Header
    path : Path
        The file, for messages.

    Returns
    -------
    Element

    Raises
    ------
    InputError
        There is no such element, or it has no scalar x, y or z.
    """
    vertex = next((e for e in header.elements if e.name == "vertex"), None)
    if vertex is None:
        raise InputError(f"{path}: no element 'vertex'", "export the file as a point cloud or mesh")
    scalars = [p.name for p in vertex.properties if p.count_dtype is None]
    missing = [name for name in AXES if name not in scalars]
    if missing:
        raise InputError(
            f"{path}: element 'vertex' has no property {', '.join(missing)}",
            "export the file with coordinates x, y and z",
        )
    return vertex


def stack(rows: Rows, names: tuple[str, ...]) -> FloatArray:
    """Copy scalar properties into the columns of one array, block by block for the cache.

    Parameters
    ----------
    rows : Rows
    names : tuple of str
        Of scalars that the rows have: the columns, in order.

    Returns
    -------
    ndarray of float64, shape (n, len(names))
    """
    columns = [rows.scalars[name] for name in names]
    stacked = np.empty((len(columns[0]), len(columns)))
    for start in range(0, len(stacked), _ROWS_AT_ONCE):
        block = slice(start, start + _ROWS_AT_ONCE)
        for i, column in enumerate(columns):
            stacked[block, i] = column[block]
    return stacked


def _points(vertex: Rows) -> PointCloud:
    colours = None
    if all(name in vertex.scalars and vertex.scalars[name].dtype == np.uint8 for name in COLORS):
        colours = np.stack([vertex.scalars[name] for name in COLORS], axis=1)
    normals = stack(vertex, NORMALS) if NORMALS[0] in vertex.scalars else None
    return PointCloud(stack(vertex, AXES), normals, colours)
