"""PLY files: strict in what is accepted, double precision where it is needed.

The parts: `header` (what the body holds), `binary` and `ascii` (the body), and what the elements
mean: ``vertex`` is a point cloud (`points`), ``vertex`` and ``face`` are a mesh.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from hpcapp.io.frame import needs_double
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream
from hpcapp.io.meshes.polygons import mesh_of_polygons
from hpcapp.io.ply.ascii import read_ascii
from hpcapp.io.ply.binary import read_binary
from hpcapp.io.ply.columns import VertexProperties
from hpcapp.io.ply.faces import find_polygons
from hpcapp.io.ply.header import SCALAR_TYPES, read_header
from hpcapp.io.ply.points import plan_vertex
from hpcapp.io.points.column_roles import AXES, COLOURS, NORMALS
from hpcapp.io.points.named_columns import stack
from hpcapp.io.staging import replacing
from hpccomponent.errors import InputError, OutputError
from hpccomponent.surface.tasks.shared_ply import (
    FACE_SIZE,
    SharedPly,
    face_rows,
    mesh_header,
    ply_header,
    vertex_rows,
    vertex_size,
)
from hpccomponent.surface.types.mesh import Mesh
from hpccomponent.surface.types.points import FloatArray, PointCloud

__all__ = ["read_ply_mesh", "shared_ply", "write_ply_mesh", "write_ply_points"]

_ROWS_AT_ONCE = 1 << 16
_MOST_VERTICES = 2**31 - 1


@dataclass(frozen=True, slots=True, eq=False)
class _Column:
    """One property of the vertices, as it is to be written."""

    name: str
    dtype: str
    values: NDArray[Any]
    shift: float = 0.0


def read_ply_mesh(path: Path) -> Mesh:
    """Read a PLY file as a triangle mesh; polygons become triangle fans.

    Parameters
    ----------
    path : Path
        ascii or binary in either byte order.

    Returns
    -------
    Mesh

    Raises
    ------
    InputError
        The file is damaged, has no faces, or a face names a vertex that is not there.
    OSError
        The file cannot be read.
    """
    header = read_header(path)
    _, plan = plan_vertex(header, path)
    polygons = find_polygons(header)
    if polygons is None:
        raise InputError(
            f"{path}: no element 'face' with a list vertex_indices of integers: not a mesh",
            "a point cloud can be meshed with 'hpcapp reconstruct'",
        )
    read = read_binary if header.byte_order else read_ascii
    elements = read(path, header, {"vertex", "face"})
    positions = stack(elements["vertex"].scalars, plan.positions)
    return mesh_of_polygons(positions, elements["face"].lists[polygons], path)


def write_ply_points(path: Path, cloud: PointCloud) -> None:
    """Write a point cloud as binary little-endian PLY.

    Coordinates are written in the input's frame, as ``double`` if an origin was subtracted or
    ``float`` would round by more than a millionth of the extent; otherwise as ``float``.

    Parameters
    ----------
    path : Path
        Appears whole or not at all.
    cloud : PointCloud
        Its normals are written as ``float``, its attributes under their names, whose blanks
        become ``_``, as the type they have; whole numbers of 64 bit as ``double``.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    columns = _coordinate_columns(cloud.positions, cloud.origin)
    if cloud.normals is not None:
        columns += _plain_columns(NORMALS, "<f4", cloud.normals)
    if cloud.colours is not None:
        columns += _plain_columns(COLOURS, _ply_type(cloud.colours.dtype), cloud.colours)
    for name, values in cloud.attributes.items():
        name = "_".join(name.split())
        unique = f"{name}_attribute" if any(name == c.name for c in columns) else name
        columns += _plain_columns((unique,), _ply_type(values.dtype), values[:, None])
    with replacing(path) as file:
        file.write(ply_header(_vertex_lines(columns)))
        _write_columns(file, columns)


def write_ply_mesh(path: Path, mesh: Mesh | MeshStream) -> None:
    """Write a triangle mesh as binary little-endian PLY.

    Parameters
    ----------
    path : Path
        Appears whole or not at all.
    mesh : Mesh or MeshStream
        Vertices are written like the points of `write_ply_points`, with all that they carry:
        normals as ``float``, colours as ``uchar``, attributes under their names.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    stream = as_stream(mesh)
    is_double = needs_double(stream.box, stream.origin)
    carried = VertexProperties.of(stream.layout)
    counts = stream.vertex_count, stream.face_count
    with replacing(path) as file:
        file.write(_mesh_header(counts, is_double, carried.lines))
        for vertices in stream.vertices():
            places = vertex_rows(vertices.positions, stream.origin, is_double)
            file.write(_join_rows(places, vertices, carried).data)
        for faces in stream.faces():
            file.write(face_rows(faces).data)


@contextmanager
def shared_ply(
    path: Path, counts: tuple[int, int], origin: FloatArray, box: FloatArray
) -> Iterator[SharedPly]:
    """Open a mesh's PLY file for many to write: the file that `write_ply_mesh` would write.

    Parameters
    ----------
    path : Path
        Appears when the block ends well; else nothing is left of it.
    counts : tuple of int
        Vertices and faces.
    origin, box : ndarray of float64, shape (3,) and (2, 3)
        See `MeshStream`.

    Yields
    ------
    SharedPly
        Where `write_part` and `write_kept` of `hpccomponent.surface.tasks.shared_ply` are to write,
        until the block ends.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    is_double = needs_double(box, origin)
    header = _mesh_header(counts, is_double)
    face_start = len(header) + counts[0] * vertex_size(is_double)
    with replacing(path) as file:
        file.write(header)
        file.truncate(face_start + counts[1] * FACE_SIZE)
        file.flush()
        yield SharedPly(str(file.name), str(path), len(header), face_start, is_double, origin)


def _join_rows(
    places: NDArray[Any], vertices: PointCloud, carried: VertexProperties
) -> NDArray[Any]:
    """Return the rows of some vertices with what they carry."""
    if not carried.names:
        return places
    coordinates = [(name, places.dtype.str) for name in AXES]
    rows = np.empty(len(places), coordinates + carried.fields)
    for name, column in zip(AXES, places.T, strict=True):
        rows[name] = column
    carried.fill(rows, vertices)
    return rows


def _mesh_header(
    counts: tuple[int, int], is_double: bool, property_lines: Sequence[str] = ()
) -> bytes:
    if counts[0] > _MOST_VERTICES:
        raise OutputError(
            f"{counts[0]} vertices are more than the faces of a PLY file can name",
            "choose an output that ends in .tiles",
        )
    return mesh_header(*counts, is_double, property_lines)


def _plain_columns(names: tuple[str, ...], dtype: str, values: NDArray[Any]) -> list[_Column]:
    return [_Column(name, dtype, column) for name, column in zip(names, values.T, strict=True)]


def _coordinate_columns(local: FloatArray, origin: FloatArray) -> list[_Column]:
    dtype = "<f8" if needs_double(local, origin) else "<f4"
    return [_Column(*column) for column in zip(AXES, [dtype] * 3, local.T, origin, strict=True)]


def _vertex_lines(columns: list[_Column]) -> list[str]:
    spelled = {dtype: name for name, dtype in reversed(SCALAR_TYPES.items())}
    properties = [f"property {spelled[c.dtype[-2:]]} {c.name}" for c in columns]
    return [f"element vertex {len(columns[0].values)}", *properties]


def _ply_type(dtype: np.dtype[Any]) -> str:
    """Return the PLY type that holds all values of a type, as numpy names it."""
    fitting = (kind for kind in SCALAR_TYPES.values() if np.can_cast(dtype, kind))
    return "<" + min(fitting, key=lambda kind: np.dtype(kind).itemsize, default="f8")


def _write_columns(file: BinaryIO, columns: list[_Column]) -> None:
    rows = len(columns[0].values)
    with np.errstate(over="ignore"):  # what float cannot hold becomes infinite
        for start in range(0, rows, _ROWS_AT_ONCE):
            block = slice(start, min(start + _ROWS_AT_ONCE, rows))
            part = np.empty(block.stop - start, [(c.name, c.dtype) for c in columns])
            for c in columns:
                part[c.name] = c.values[block] + c.shift if c.shift else c.values[block]
            file.write(part.data)
