"""PLY files: strict in what is accepted, double precision where it is needed.

The parts: `header` (what the body holds), `body` (`binary` or `ascii`), and what the elements mean:
``vertex`` is a point cloud (`points`), ``vertex`` and ``face`` are a mesh.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.ply_rows import (
    FACE_SIZE,
    SharedPly,
    coordinate_lines,
    face_rows,
    mesh_header,
    ply_header,
    vertex_rows,
    vertex_size,
)
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io.crs import UNKNOWN, Crs
from hpcapp.io.frame import needs_double
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream
from hpcapp.io.meshes.polygons import mesh_of_polygons
from hpcapp.io.ply.body import read_body
from hpcapp.io.ply.columns import VertexProperties
from hpcapp.io.ply.comments import keep, parse_comments
from hpcapp.io.ply.faces import find_polygons
from hpcapp.io.ply.header import read_header
from hpcapp.io.ply.points import plan_vertex
from hpcapp.io.points.column_roles import AXES
from hpcapp.io.points.named_columns import build_cloud
from hpcapp.io.points.point_source import Scan
from hpcapp.io.staging import replacing
from hpccomponent.errors import InputError, OutputError

_ROWS_AT_ONCE = 1 << 16
_MOST_VERTICES = 2**31 - 1


def holds_ply_faces(path: Path) -> bool:
    """Tell whether a PLY file has faces; InputError where its header is damaged."""
    header = read_header(path)
    face = header.find("face")
    return face is not None and face.count > 0 and find_polygons(header) is not None


def find_ply_crs(path: Path) -> Crs:
    """Return what the comments of a PLY file say of its coordinates."""
    kept = parse_comments(read_header(path).comments)
    return Crs(kept.crs, kept.unit, kept.height_unit)


def read_ply_mesh(path: Path) -> Mesh:
    """Read a PLY file, ascii or binary in either byte order; polygons become triangle fans.

    Normals, colours of one byte and attributes are those of the vertices. Raise InputError where
    the file is damaged, has no faces, or a face names a vertex that is not there.
    """
    header = read_header(path)
    _, plan = plan_vertex(header, path)
    polygons = find_polygons(header)
    if polygons is None:
        raise InputError(
            f"{path}: no element 'face' with a list vertex_indices of integers: not a mesh",
            "a point cloud can be meshed with 'hpcapp reconstruct'",
        )
    elements = read_body(path, header, {"vertex", "face"})
    vertices = build_cloud(elements["vertex"].scalars, plan)
    mesh = mesh_of_polygons(vertices.positions, elements["face"].lists[polygons], path)
    has_bytes = vertices.colours is not None and vertices.colours.dtype == np.uint8
    return replace(
        mesh,
        normals=vertices.normals,
        colours=vertices.colours if has_bytes else None,
        attributes=vertices.attributes,
    )


def write_ply_points(
    path: Path,
    cloud: PointCloud,
    crs: str | None = None,
    unit: str | None = None,
    scans: Sequence[Scan] = (),
    height_unit: str | None = None,
) -> None:
    """Write a point cloud as binary little-endian PLY.

    Coordinates are written in the input's frame, as ``double`` if an origin was subtracted or
    ``float`` would round by more than a millionth of the extent; otherwise as ``float``. Normals
    are written as ``float``, colours and attributes as the type they have, these under their names,
    whose blanks become ``_``; whole numbers of 64 bits as ``double``. Unit, coordinate reference
    system and scanners are kept in comments of the header.
    """
    is_double = needs_double(cloud.positions, cloud.origin)
    properties = VertexProperties.of(cloud)
    kept = keep(Crs(crs, unit, height_unit), scans)
    lines = [*kept, *coordinate_lines(len(cloud), is_double), *properties.lines]
    with replacing(path) as file:
        file.write(ply_header(lines))
        for start in range(0, len(cloud), _ROWS_AT_ONCE):
            part = cloud.view(slice(start, start + _ROWS_AT_ONCE))
            file.write(_make_rows(part, cloud.origin, is_double, properties).data)


def write_ply_mesh(path: Path, mesh: Mesh | MeshStream) -> None:
    """Write a triangle mesh as binary little-endian PLY.

    Vertices are written like the points of `write_ply_points`, with all that they carry: normals as
    ``float``, colours as ``uchar``, attributes under their names. What its coordinates mean is in
    comments of the header.
    """
    stream = as_stream(mesh)
    is_double = needs_double(stream.box, stream.origin)
    carried = VertexProperties.of(stream.layout)
    counts = stream.vertex_count, stream.face_count
    with replacing(path) as file:
        file.write(_mesh_header(counts, is_double, carried.lines, stream.crs))
        for vertices in stream.vertices():
            file.write(_make_rows(vertices, stream.origin, is_double, carried).data)
        for faces in stream.faces():
            file.write(face_rows(faces).data)


@contextmanager
def shared_ply(
    path: Path, counts: tuple[int, int], origin: FloatArray, box: FloatArray, crs: Crs = UNKNOWN
) -> Iterator[SharedPly]:
    """Open a mesh's PLY file for many to write: the file that `write_ply_mesh` would write.

    The file appears when the block ends well; else nothing is left of it. Counts are of vertices
    and faces; origin and box are those of a `MeshStream`. Yield where `write_part` and `write_kept`
    of the surface's `stitching.shared_ply` are to write, until the block ends.
    """
    is_double = needs_double(box, origin)
    header = _mesh_header(counts, is_double, crs=crs)
    face_start = len(header) + counts[0] * vertex_size(is_double)
    with replacing(path) as file:
        file.write(header)
        file.truncate(face_start + counts[1] * FACE_SIZE)
        file.flush()
        yield SharedPly(str(file.name), str(path), len(header), face_start, is_double, origin)


def _make_rows(
    vertices: PointCloud, origin: FloatArray, is_double: bool, carried: VertexProperties
) -> NDArray[np.generic]:
    """Return the rows of some vertices with what they carry."""
    places = vertex_rows(vertices.positions, origin, is_double)
    if not carried.names:
        return places
    coordinates = [(name, places.dtype.str) for name in AXES]
    rows = np.empty(len(places), coordinates + carried.fields)
    for name, column in zip(AXES, places.T, strict=True):
        rows[name] = column
    carried.fill(rows, vertices)
    return rows


def _mesh_header(
    counts: tuple[int, int],
    is_double: bool,
    property_lines: Sequence[str] = (),
    crs: Crs = UNKNOWN,
) -> bytes:
    if counts[0] > _MOST_VERTICES:
        raise OutputError(
            f"{counts[0]} vertices are more than the faces of a PLY file can name",
            "choose an output that ends in .tiles",
        )
    return mesh_header(*counts, is_double, property_lines, tuple(keep(crs)))
