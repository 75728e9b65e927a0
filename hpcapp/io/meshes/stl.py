"""STL: triangles one by one, in single precision; read from both kinds, written as binary."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hpcapp.geometry.faces import unit_normals
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray
from hpcapp.io.columns import Ragged
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream
from hpcapp.io.meshes.polygons import mesh_of_polygons
from hpcapp.io.meshes.single_corners import round_corners
from hpcapp.io.rows import Line, numbered, parse_table
from hpcapp.io.staging import replacing
from hpccomponent.errors import InputError

_HEAD_BYTES = 80
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def read_stl(path: Path) -> Mesh:
    """Read an STL file, ascii or binary; corners at the same place become one vertex.

    Raise InputError where it is shorter or longer than it says, or a line is wrong.
    """
    corners = _binary_corners(path)
    if corners is None:
        corners = _ascii_corners(path)
    if not len(corners):
        raise InputError(f"{path}: no triangles: not a mesh", "check the file")
    # + 0.0: -0 and 0 are one place
    vertices, indices = np.unique(corners + 0.0, axis=0, return_inverse=True)
    lengths = np.full(len(corners) // 3, 3, np.int64)
    return mesh_of_polygons(vertices, Ragged(lengths, indices.ravel()), path)


def _binary_corners(path: Path) -> FloatArray | None:
    """Return the corners of a binary file, None for ascii; both kinds may start with ``solid``."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
        count = int.from_bytes(file.read(4), "little")
        if size == _HEAD_BYTES + 4 + count * _TRIANGLE.itemsize:
            triangles = np.fromfile(file, _TRIANGLE, count)
            return triangles["corners"].reshape(-1, 3).astype(np.float64)
    if head.lstrip().startswith(b"solid"):
        return None
    raise InputError(
        f"{path}: not an STL file, or truncated: its {count} triangles would take "
        f"{_HEAD_BYTES + 4 + count * _TRIANGLE.itemsize} bytes, it has {size}",
        "copy or export the file again",
    )


def _ascii_corners(path: Path) -> FloatArray:
    vertex_lines, last = list[Line](), ""
    with path.open(encoding="latin-1") as file:
        for number, text in numbered(file):
            last = text.lstrip()
            if last.startswith("vertex"):
                vertex_lines.append((number, last.removeprefix("vertex")))
    corners = parse_table(iter(vertex_lines), 3, path)
    problem = None if last.startswith("endsolid") else "its last line is not 'endsolid'"
    if len(corners) % 3:
        problem = f"{len(corners)} corners are no whole number of triangles"
    if problem is not None:
        raise InputError(f"{path}: truncated: {problem}", "copy or export the file again")
    return corners


def write_stl(path: Path, mesh: Mesh | MeshStream) -> None:
    """Write a triangle mesh as binary STL, in single precision; the header notes its origin."""
    stream = as_stream(mesh)
    head = "hpcapp" + (f" origin {stream.said['origin']}" if stream.shift.any() else "")
    with replacing(path) as file:
        file.write(head.encode("ascii")[:_HEAD_BYTES].ljust(_HEAD_BYTES))
        file.write(stream.face_count.to_bytes(4, "little"))
        for corners, rounded in round_corners(path, stream):
            triangles = np.zeros(len(corners), _TRIANGLE)
            triangles["corners"] = rounded
            triangles["normal"] = unit_normals(corners)
            file.write(triangles.data)
