"""Point clouds of the Point Cloud Library: .pcd, ascii, binary or compressed.

References
----------
"The PCD (Point Cloud Data) file format", https://pointclouds.org/documentation/tutorials
"""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from itertools import accumulate, islice
from pathlib import Path

import numpy as np

from hpcapp.geometry.point_records import Column, PointRecords
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io.columns import Numbers
from hpcapp.io.pcd.header import PcdField, PcdHeader, read_pcd_header
from hpcapp.io.pcd.lzf import MOST_EXPANSION, expand_lzf
from hpcapp.io.points.named_columns import (
    ColumnPlan,
    add_grid,
    build_cloud,
    describe_records,
    plan_columns,
)
from hpcapp.io.points.packed_colours import PACKED, unpack_float_text, unpack_words
from hpcapp.io.points.point_source import Findings, PointSource, Scan
from hpcapp.io.rows import numbered, parse_table, take_lines
from hpccomponent.dataclass import dataclass
from hpccomponent.decoding.claims import Claims
from hpccomponent.errors import InputError

_MOST_COLUMNS = 4  # of one field: more of them are a descriptor, not attributes
_LONGEST_ROW = 1 << 20
_COPY_AGAIN = "copy or export the file again"


def open_pcd(path: Path) -> PointSource:
    """Open a PCD file: ascii, binary or binary_compressed.

    Coordinates stay as they are in the file: its viewpoint is where the scanner stood. The points
    of an organised cloud have the attributes ``row`` and ``column``. Raise InputError where there
    is no header, no field x, y or z, or the file is cut.
    """
    header = read_pcd_header(path)
    findings = Findings(list(header.warnings))
    columns = _find_columns(header)
    plan = plan_columns(list(columns), f"{path}: the PCD header")
    records = None
    if header.encoding == "ascii":
        scan_body = _Ascii(path, header, columns, plan, findings).scan
    elif header.encoding == "binary":
        records = _describe_body(path, header, columns, plan, findings)
        scan_body = records.scan
    else:
        scan_body = _Compressed(path, header, columns, plan).scan

    def scan(rows: int) -> Iterator[PointCloud]:
        first = 0
        for part in scan_body(rows):
            cells = np.arange(first, first + len(part))
            yield part if header.grid is None else add_grid(part, cells, header.grid[0])
            first += len(part)

    return PointSource(
        path,
        header.points,
        header.encoding == "ascii" or any(columns[name].is_double for name in plan.positions),
        bool(plan.normals),
        scan,
        records if header.grid is None else None,
        (lambda: None) if records is not None and header.grid is None else None,
        f"PCD, {header.encoding}",
        tuple(field.name for field in header.fields),
        (Scan(header.points, header.scanner, header.grid),),
        findings=findings,
    )


@dataclass(frozen=True, slots=True)
class _PcdColumn:
    """A number that each point has.

    Parameters
    ----------
    field : int
        Number of its field.
    at : int
        Which of the field's numbers it is.
    dtype : str
        Of it, as numpy names it; of a colour that is packed with others into one number, a byte.
    byte : int
        Of a packed colour, which byte of the number it is; else 0.
    """

    field: int
    at: int
    dtype: str
    byte: int = 0

    @property
    def is_double(self) -> bool:
        return self.dtype not in ("<f4", "<i1", "<u1", "<i2", "<u2")


def _find_columns(header: PcdHeader) -> dict[str, _PcdColumn]:
    """Name the numbers of a point: padding has none, nor have descriptors."""
    columns: dict[str, _PcdColumn] = {}
    for number, field in enumerate(header.fields):
        if field.name == "_" or not 0 < field.count <= _MOST_COLUMNS:
            continue
        if _is_packed(field):
            for colour, byte in PACKED:
                columns.setdefault(colour, _PcdColumn(number, 0, "|u1", byte))
            continue
        for at in range(field.count):
            name = field.name if field.count == 1 else f"{field.name}_{at}"
            columns.setdefault(name, _PcdColumn(number, at, field.dtype))
    return columns


def _is_packed(field: PcdField) -> bool:
    return field.name.lower() in ("rgb", "rgba") and field.size == 4 and field.count == 1


def _describe_body(
    path: Path,
    header: PcdHeader,
    columns: dict[str, _PcdColumn],
    plan: ColumnPlan,
    findings: Findings,
) -> PointRecords:
    """Describe the points of a binary file as records; refuse one that is cut."""
    starts = [0, *accumulate(field.size for field in header.fields)]
    length = starts[-1]
    following = path.stat().st_size - header.body_start
    if length * header.points > following:
        raise InputError(
            f"{path}: truncated: {header.points} points of {length} bytes are announced, "
            f"{following} bytes follow",
            _COPY_AGAIN,
        )
    if length * header.points < following:
        findings.warn(
            f"{following - length * header.points} bytes follow after the {header.points} points "
            "that the header announces: they are left out"
        )
    placed: dict[str, Column] = {}
    for name, column in columns.items():
        size = np.dtype(header.fields[column.field].dtype).itemsize
        placed[name] = (starts[column.field] + column.at * size + column.byte, column.dtype)
    return describe_records(path, header.body_start, length, header.points, placed, plan)


@dataclass(frozen=True, slots=True, eq=False)
class _Ascii:
    """A line for each point."""

    path: Path
    header: PcdHeader
    columns: dict[str, _PcdColumn]
    plan: ColumnPlan
    findings: Findings

    def scan(self, rows: int) -> Iterator[PointCloud]:
        starts = [0, *accumulate(field.count for field in self.header.fields)]
        with self.path.open("rb") as file, io.TextIOWrapper(file, "latin-1") as text:
            file.seek(self.header.body_start)
            has_commas = b"," in file.readline(_LONGEST_ROW)
            file.seek(self.header.body_start)
            rows_of_text = (row.replace(",", " ") for row in text) if has_commas else text
            lines = numbered(rows_of_text, self.header.body_line)
            taken = take_lines(lines, self.header.points, self.path, "points")
            for _ in range(0, max(self.header.points, 1), rows):
                chunk = islice(taken, rows)
                table = parse_table(chunk, starts[-1], self.path)
                yield self._build(table, starts)
            more = sum(1 for _ in lines)
        if more:
            self.findings.warn(
                f"{self.header.points + more} rows, of which the header announces "
                f"{self.header.points}: the others are left out"
            )

    def _build(self, table: FloatArray, starts: list[int]) -> PointCloud:
        columns: dict[str, Numbers] = {}
        for name, column in self.columns.items():
            numbers = table[:, starts[column.field] + column.at]
            field = self.header.fields[column.field]
            if not _is_packed(field):
                columns[name] = _as_announced(numbers, field.dtype)
            elif field.dtype == "<f4":
                columns[name] = unpack_float_text(numbers, column.byte)
            else:
                with np.errstate(invalid="ignore"):  # of what is no packed colour
                    words = numbers.astype(np.int64).astype("<u4")
                columns[name] = unpack_words(words, column.byte)
        return build_cloud(columns, self.plan)


def _as_announced(numbers: FloatArray, dtype: str) -> Numbers:
    """Return whole numbers as their type; decimal ones stay float64: nothing is rounded."""
    if dtype[1] == "f":
        return numbers
    limits = np.iinfo(dtype)
    fits = (numbers >= limits.min) & (numbers <= limits.max) & (numbers == np.rint(numbers))
    return numbers.astype(dtype) if fits.all() else numbers


@dataclass(frozen=True, slots=True, eq=False)
class _Compressed:
    """All numbers of a field, then those of the next; they are in memory all at once."""

    path: Path
    header: PcdHeader
    columns: dict[str, _PcdColumn]
    plan: ColumnPlan

    def scan(self, rows: int) -> Iterator[PointCloud]:
        points = self.header.points
        starts = [0, *accumulate(field.size * points for field in self.header.fields)]
        body = self._expand(starts[-1])
        columns: dict[str, Numbers] = {}
        for name, column in self.columns.items():
            field = self.header.fields[column.field]
            size = np.dtype(field.dtype).itemsize
            at = starts[column.field] + column.at * size + column.byte
            columns[name] = np.ndarray(points, column.dtype, body, at, (field.size,))
        for start in range(0, max(points, 1), rows):
            block = slice(start, start + rows)
            yield build_cloud({name: all_[block] for name, all_ in columns.items()}, self.plan)

    def _expand(self, size: int) -> bytearray:
        with self.path.open("rb") as file:
            file.seek(self.header.body_start)
            head = file.read(8)
            packed_size, whole_size = struct.unpack("<II", head.ljust(8, b"\0"))
            packed = file.read(min(packed_size, self.path.stat().st_size))
        if len(head) < 8 or len(packed) < packed_size:
            raise InputError(f"{self.path}: truncated: the compressed points are cut", _COPY_AGAIN)
        if size != whole_size or size > MOST_EXPANSION * len(packed):
            raise InputError(
                f"{self.path}: the fields announce {size} bytes of points, "
                f"the compressed block {whole_size} from {len(packed)}",
                _COPY_AGAIN,
            )
        Claims(self.path).add(size, "its compressed block")
        try:
            return expand_lzf(packed, size)
        except ValueError as error:
            raise InputError(
                f"{self.path}: the compressed block is damaged: {error}", _COPY_AGAIN
            ) from error
