"""The vertices of a PLY file as a point cloud."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hpcapp.geometry.point_records import Column, PointRecords
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io.batches import batch_points, cut_points, join_points
from hpcapp.io.columns import Ragged, Rows
from hpcapp.io.ply.binary import find_records
from hpcapp.io.ply.body import read_body, scan_body
from hpcapp.io.ply.comments import Kept, parse_comments
from hpcapp.io.ply.faces import find_polygons, vertex_normals
from hpcapp.io.ply.header import Element, Header, Property, read_header
from hpcapp.io.ply.range_grid import GRID_LIST, find_cells, find_range_grid
from hpcapp.io.ply.splats import FLOATERS, are_splats, build_splats, find_floaters, plan_splats
from hpcapp.io.points.named_columns import (
    ColumnPlan,
    add_grid,
    build_cloud,
    describe_records,
    plan_columns,
    stack,
)
from hpcapp.io.points.point_source import Findings, PointSource, Scan
from hpccomponent.errors import InputError

_ROWS_AT_ONCE = 1 << 16
_EXACT_IN_SINGLE = ("f4", "i1", "u1", "i2", "u2")
_ENCODINGS = {"": "ascii", "<": "binary", ">": "binary, big endian"}
_LONGEST_LINE = 1 << 20
_MOST_SCANS = 100_000
_VIEW = ("view_px", "view_py", "view_pz")


def open_ply(path: Path) -> PointSource:
    """Open the vertices of a PLY file, ascii or binary in either byte order.

    Normals and colours are as in the file. Where a mesh has no normals, they come from its faces.
    The shortest axes of splats are taken for their normals, and floaters are left out and counted.

    Raises
    ------
    InputError
        The file has no vertices with coordinates, or is cut before their end.
    """
    header = read_header(path)
    findings = Findings(list(header.warnings))
    header = _without_absent_lists(path, header, findings)
    header = _with_byte_colours(path, header)
    vertex, plan = plan_vertex(header, path)
    types = {p.name: p.dtype for p in vertex.properties if p.count_dtype is None}
    is_double = not header.byte_order or any(
        types[name] not in _EXACT_IN_SINGLE for name in plan.positions
    )
    body = _Body(path, header, plan, findings)
    splats = are_splats(types)
    faces = next((e.count for e in header.elements if e.name == "face"), 0)
    polygons = None if plan.normals or splats or not faces else find_polygons(header)
    is_mesh = polygons is not None
    records, check_rest = None, None
    if splats:
        body = replace(body, plan=plan_splats(plan), build=build_splats)
        findings.warn("splats: their shortest axes are taken for normals, whose sign is not known")
        scan: Callable[[int], Iterator[PointCloud]] = _SplatScan(body)
    elif polygons is not None:
        scan = _MeshScan(body, polygons)
    else:
        records = _find_points(path, header, vertex, plan) if header.byte_order else None
        body = replace(body, records=records)
        scan, check_rest = body.scan, body.check_rest
    kept = parse_comments(header.comments)
    grid = None if is_mesh else find_range_grid(header)
    if grid is not None:
        records, check_rest, scan = None, None, _GridScan(body, vertex.count, grid[0])
    return PointSource(
        path,
        vertex.count,
        is_double,
        bool(plan.normals) or splats or is_mesh,
        scan,
        records,
        check_rest,
        kept.joined
        or f"PLY, {_ENCODINGS[header.byte_order]}{', splats' * splats}{', a mesh' * is_mesh}",
        tuple(p.name for p in vertex.properties),
        _find_scans(path, header, vertex.count, kept, grid),
        kept.crs,
        kept.unit,
        findings,
        "file" if polygons is None else "faces",
        oriented=not splats,
        height_unit=kept.height_unit,
    )


def plan_vertex(header: Header, path: Path) -> tuple[Element, ColumnPlan]:
    """Find the element ``vertex`` of a header, and what its scalars are.

    Raises
    ------
    InputError
        There is no such element, or it lacks coordinates or some components of normals.
    """
    vertex = next((e for e in header.elements if e.name == "vertex"), None)
    if vertex is None:
        raise InputError(f"{path}: no element 'vertex'", "export the file as a point cloud or mesh")
    scalars = [p.name for p in vertex.properties if p.count_dtype is None]
    return vertex, plan_columns(scalars, f"{path}: element 'vertex'")


@dataclass(frozen=True, slots=True, eq=False)
class _Body:
    """The elements of a file, read in parts."""

    path: Path
    header: Header
    plan: ColumnPlan
    findings: Findings
    build: Callable[..., PointCloud] = build_cloud
    records: PointRecords | None = None

    def parts(self, element: str, rows: int) -> Iterator[Rows]:
        parts = scan_body(self.path, self.header, {element}, rows, self.findings.warn)
        return (part for _, part in parts)

    def scan(self, rows: int) -> Iterator[PointCloud]:
        if self.records is not None:
            yield from self.records.scan(rows)
            self.check_rest()
            return
        for part in self.parts("vertex", rows):
            yield self.build(part.scalars, self.plan)

    def check_rest(self) -> None:
        for _ in scan_body(self.path, self.header, (), 1, self.findings.warn):
            """Nothing is asked for: all is measured."""


@dataclass(frozen=True, slots=True, eq=False)
class _MeshScan:
    """Vertices with the normals of their faces; they are in memory all at once."""

    body: _Body
    polygons: str

    def __call__(self, rows: int) -> Iterator[PointCloud]:
        cloud = join_points(list(self.body.scan(_ROWS_AT_ONCE)))
        normals, has_face = vertex_normals(cloud.positions, self._polygons(), self.body.path)
        cloud = replace(cloud, normals=normals)
        left_out = len(cloud) - int(has_face.sum())
        self.body.findings.dropped.pop(_FACELESS, None)  # a file may be scanned more than once
        self.body.findings.drop(_FACELESS, left_out)
        return cut_points(cloud.take(has_face) if left_out else cloud, rows)

    def _polygons(self) -> Iterator[Ragged]:
        for faces in self.body.parts("face", _ROWS_AT_ONCE):
            yield faces.lists[self.polygons]


@dataclass(frozen=True, slots=True, eq=False)
class _SplatScan:
    """Splats without the floaters."""

    body: _Body

    def __call__(self, rows: int) -> Iterator[PointCloud]:
        self.body.findings.dropped.pop(FLOATERS, None)  # they are counted anew
        return batch_points(self._without_floaters(rows), rows)

    def _without_floaters(self, rows: int) -> Iterator[PointCloud]:
        for part in self.body.scan(rows):
            is_floater = find_floaters(part)
            self.body.findings.drop(FLOATERS, int(is_floater.sum()))
            yield part.take(~is_floater) if is_floater.any() else part


@dataclass(frozen=True, slots=True, eq=False)
class _GridScan:
    """Vertices with their places in a grid."""

    body: _Body
    vertices: int
    width: int

    def __call__(self, rows: int) -> Iterator[PointCloud]:
        parts = self.body.parts("range_grid", _ROWS_AT_ONCE)
        lists = (part.lists[GRID_LIST] for part in parts)
        cells, first = find_cells(lists, self.vertices, self.body.path), 0
        for part in self.body.scan(rows):
            yield add_grid(part, cells[first : first + len(part)], self.width)
            first += len(part)


_FACELESS = "vertices without a face"


def _find_points(
    path: Path, header: Header, vertex: Element, plan: ColumnPlan
) -> PointRecords | None:
    """Describe the vertices of a binary file as records; None where they differ in length."""
    located = find_records(path, header, vertex.name)
    if located is None:
        return None
    start, dtype = located
    columns: dict[str, Column] = {}
    for number, p in enumerate(vertex.properties):
        if p.count_dtype is None:
            assert dtype.fields is not None  # noqa: S101 - it has these
            kind, offset = dtype.fields[f"v{number}"][:2]
            columns[p.name] = (int(offset), kind.str)
    return describe_records(path, start, dtype.itemsize, vertex.count, columns, plan)


def _with_properties(header: Header, vertex: Element, properties: Iterable[Property]) -> Header:
    changed = replace(vertex, properties=tuple(properties))
    return replace(header, elements=tuple(changed if e is vertex else e for e in header.elements))


def _with_byte_colours(path: Path, header: Header) -> Header:
    """Take colours that are announced as signed bytes for unsigned ones."""
    vertex, plan = plan_vertex(header, path)
    properties = (
        replace(p, dtype="u1") if p.name in plan.colours and p.dtype == "i1" else p
        for p in vertex.properties
    )
    return _with_properties(header, vertex, properties)


def _without_absent_lists(path: Path, header: Header, findings: Findings) -> Header:
    """Pass over lists of the vertices that the header declares and no row holds."""
    vertex, _ = plan_vertex(header, path)
    lists = [p for p in vertex.properties if p.count_dtype is not None]
    scalars = [p for p in vertex.properties if p.count_dtype is None]
    if not lists or not vertex.count:
        return header
    bare = _with_properties(header, vertex, scalars)
    if not (_is_of_size(path, bare) if header.byte_order else _starts_with(path, bare, vertex)):
        return header
    for p in lists:
        findings.warn(
            f"line {p.line} of the header declares the list {p.name!r}, which no vertex has"
        )
    return bare


def _is_of_size(path: Path, header: Header) -> bool:
    """Tell whether a binary body is as long as rows without lists make it."""
    size = header.body_start
    for element in header.elements:
        if element.count and element.has_lists:
            return False
        size += element.count * sum(np.dtype(p.dtype).itemsize for p in element.properties)
    return size == path.stat().st_size


def _starts_with(path: Path, header: Header, vertex: Element) -> bool:
    """Tell whether an ascii body starts with a vertex that has no more numbers than scalars."""
    first = next(e for e in header.elements if e.count)
    with path.open("rb") as file:
        file.seek(header.body_start)
        words = file.readline(_LONGEST_LINE).split()
    return first.name == vertex.name and len(words) == len(first.properties)


def _find_scans(
    path: Path, header: Header, count: int, kept: Kept, grid: tuple[int, int] | None
) -> tuple[Scan, ...]:
    """Return the scans that comments number, or the one that the file is."""
    if not kept.scanners:
        return (Scan(count, _find_scanner(path, header), grid),)
    last = max(kept.scanners)
    if last >= _MOST_SCANS:
        raise InputError(
            f"{path}: a comment names scanner {last}", f"number scanners from 0 to {_MOST_SCANS}"
        )
    counts = {0: count} if last == 0 else {}
    return tuple(Scan(counts.get(i), kept.scanners.get(i)) for i in range(last + 1))


def _find_scanner(path: Path, header: Header) -> FloatArray | None:
    """Return where the camera stood, as PCL writes it; at the origin it says nothing."""
    camera = next((e for e in header.elements if e.name == "camera" and e.count == 1), None)
    if camera is None or not set(_VIEW) <= {p.name for p in camera.properties}:
        return None
    place = stack(read_body(path, header, {"camera"})["camera"].scalars, _VIEW)[0]
    return place if place.any() and np.isfinite(place).all() else None
