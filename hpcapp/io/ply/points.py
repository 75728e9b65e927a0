"""The vertices of a PLY file as a point cloud."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import field, replace
from pathlib import Path
from typing import ClassVar, Literal

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
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError
from hpccomponent.ranges import is_place

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
    Raise InputError where there are no vertices with coordinates, or it is cut before their end.
    """
    header = read_header(path)
    findings = Findings(list(header.warnings))
    header = _without_absent_lists(path, header, findings)
    header = _with_byte_colours(path, header)
    vertices = _choose_vertices(path, header, findings)
    kept = parse_comments(header.comments)
    if kept.sampled:
        findings.warn(
            f"the vertices of a mesh are too few to stand for its faces: {kept.sampled} points on "
            f"these are taken in their place ({name_option('sample')} takes another number)"
        )
    columns = tuple(p.name for p in vertices.element.properties)
    return PointSource(
        path,
        vertices.element.count,
        vertices.is_double,
        bool(vertices.plan.normals) or vertices.makes_normals,
        vertices.scan,
        vertices.records,
        vertices.check_rest,
        kept.joined or f"PLY, {_ENCODINGS[header.byte_order]}{vertices.kind}",
        columns,
        _find_scans(path, header, vertices.element.count, kept, vertices.grid),
        kept.crs,
        kept.unit,
        findings,
        vertices.normals_from,
        oriented=vertices.oriented,
        height_unit=kept.height_unit,
    )


def _choose_vertices(path: Path, header: Header, findings: Findings) -> _Vertices:
    """Tell by the header what the vertices are."""
    vertex, plan = plan_vertex(header, path)
    if are_splats([p.name for p in vertex.scalars]):
        findings.warn("splats: their shortest axes are taken for normals, whose sign is not known")
        return _Splats(path, header, vertex, plan_splats(plan), findings)
    face = header.find("face")
    polygons = find_polygons(header) if face is not None and face.count else None
    if polygons is not None and not plan.normals:
        return _MeshVertices(path, header, vertex, plan, findings, polygons)
    if grid := find_range_grid(header):
        return _GridVertices(path, header, vertex, plan, findings, grid=grid)
    records = _find_points(path, header, vertex, plan) if header.byte_order else None
    return _Vertices(path, header, vertex, plan, findings, records=records)


def plan_vertex(header: Header, path: Path) -> tuple[Element, ColumnPlan]:
    """Find the element ``vertex`` of a header, and what its scalars are.

    Raise InputError where it is missing, or lacks coordinates or some components of normals.
    """
    vertex = header.find("vertex")
    if vertex is None:
        raise InputError(f"{path}: no element 'vertex'", "export the file as a point cloud or mesh")
    return vertex, plan_columns([p.name for p in vertex.scalars], f"{path}: element 'vertex'")


@dataclass(frozen=True, slots=True, eq=False)
class _Vertices:
    """The vertices of a file, read in parts: here as they are."""

    path: Path
    header: Header
    element: Element
    plan: ColumnPlan
    findings: Findings
    records: PointRecords | None = field(default=None, kw_only=True)
    grid: tuple[int, int] | None = field(default=None, kw_only=True)
    kind: ClassVar[str] = ""
    makes_normals: ClassVar[bool] = False
    normals_from: ClassVar[Literal["file", "faces"]] = "file"
    oriented: ClassVar[bool] = True

    @property
    def is_double(self) -> bool:
        types = {p.name: p.dtype for p in self.element.scalars}
        is_single = all(types[name] in _EXACT_IN_SINGLE for name in self.plan.positions)
        return not (self.header.byte_order and is_single)

    def parts(self, element: str, rows: int) -> Iterator[Rows]:
        parts = scan_body(self.path, self.header, {element}, rows, self.findings.warn)
        return (part for _, part in parts)

    def clouds(self, rows: int) -> Iterator[PointCloud]:
        return (build_cloud(part.scalars, self.plan) for part in self.parts("vertex", rows))

    def scan(self, rows: int) -> Iterator[PointCloud]:
        if self.records is None:
            yield from self.clouds(rows)
            return
        yield from self.records.scan(rows)
        self.check_rest()

    def check_rest(self) -> None:
        for _ in scan_body(self.path, self.header, (), 1, self.findings.warn):
            """Nothing is asked for: all is measured."""


@dataclass(frozen=True, slots=True, eq=False)
class _MeshVertices(_Vertices):
    """Vertices with the normals of their faces; they are in memory all at once."""

    polygons: str
    kind = ", a mesh"
    makes_normals = True
    normals_from = "faces"

    def scan(self, rows: int) -> Iterator[PointCloud]:
        cloud = join_points(list(self.clouds(_ROWS_AT_ONCE)))
        normals, has_face = vertex_normals(cloud.positions, self._polygons(), self.path)
        cloud = replace(cloud, normals=normals)
        left_out = len(cloud) - int(has_face.sum())
        self.findings.dropped.pop(_FACELESS, None)  # a file may be scanned more than once
        self.findings.drop(_FACELESS, left_out)
        return cut_points(cloud.take(has_face) if left_out else cloud, rows)

    def _polygons(self) -> Iterator[Ragged]:
        for faces in self.parts("face", _ROWS_AT_ONCE):
            yield faces.lists[self.polygons]


@dataclass(frozen=True, slots=True, eq=False)
class _Splats(_Vertices):
    """Splats without the floaters."""

    kind = ", splats"
    makes_normals = True
    oriented = False

    def scan(self, rows: int) -> Iterator[PointCloud]:
        self.findings.dropped.pop(FLOATERS, None)  # they are counted anew
        return batch_points(self._without_floaters(rows), rows)

    def _without_floaters(self, rows: int) -> Iterator[PointCloud]:
        for part in self.parts("vertex", rows):
            splats = build_splats(part.scalars, self.plan)
            is_floater = find_floaters(splats)
            self.findings.drop(FLOATERS, int(is_floater.sum()))
            yield splats.take(~is_floater) if is_floater.any() else splats


@dataclass(frozen=True, slots=True, eq=False)
class _GridVertices(_Vertices):
    """Vertices with their places in the grid of a range scan."""

    def scan(self, rows: int) -> Iterator[PointCloud]:
        assert self.grid is not None  # noqa: S101 - it is of these
        lists = (part.lists[GRID_LIST] for part in self.parts("range_grid", _ROWS_AT_ONCE))
        cells, first = find_cells(lists, self.element.count, self.path), 0
        for part in self.clouds(rows):
            yield add_grid(part, cells[first : first + len(part)], self.grid[0])
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
    if not vertex.lists or not vertex.count:
        return header
    bare = _with_properties(header, vertex, vertex.scalars)
    if not (_is_of_size(path, bare) if header.byte_order else _starts_with(path, bare, vertex)):
        return header
    for p in vertex.lists:
        findings.warn(
            f"line {p.line} of the header declares the list {p.name!r}, which no vertex has"
        )
    return bare


def _is_of_size(path: Path, header: Header) -> bool:
    """Tell whether a binary body is as long as rows without lists make it."""
    size = header.body_start
    for element in header.filled:
        if element.lists:
            return False
        size += element.count * sum(np.dtype(p.dtype).itemsize for p in element.properties)
    return size == path.stat().st_size


def _starts_with(path: Path, header: Header, vertex: Element) -> bool:
    """Tell whether an ascii body starts with a vertex that has no more numbers than scalars."""
    first = header.filled[0]
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
    camera = header.find("camera")
    if camera is None or camera.count != 1 or not set(_VIEW) <= {p.name for p in camera.properties}:
        return None
    place = stack(read_body(path, header, {"camera"})["camera"].scalars, _VIEW)[0]
    return place if place.any() and is_place(*place) else None
