"""The header and the rows of a binary little-endian PLY file: all rows of a kind have one size."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.points import FloatArray, IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.records import record

_CORNERS = np.dtype("V12")  # three int32, moved as one


_FACE = np.dtype([("n", "u1"), ("corners", _CORNERS)])


FACE_SIZE = _FACE.itemsize
"""Bytes of a face."""


@record("surface.shared_ply")
@dataclass(frozen=True, slots=True, eq=False)
class SharedPly:
    """Where the rows of a binary little-endian PLY file are, in bytes from its start.

    It has the name `path` while it is written, and will have that of the target: what messages call
    it. Coordinates are ``double`` or ``float``; the origin (3,) is to be added to them.
    """

    path: str
    target: str
    vertex_start: int
    face_start: int
    is_double: bool
    origin: FloatArray


def ply_header(element_lines: list[str]) -> bytes:
    """Return the header of a binary little-endian PLY file with these lines of elements."""
    start = ["ply", "format binary_little_endian 1.0", "comment hpcapp"]
    return "\n".join([*start, *element_lines, "end_header", ""]).encode("utf-8")


def mesh_header(
    vertex_count: int,
    face_count: int,
    is_double: bool,
    property_lines: Sequence[str] = (),
    comment_lines: Sequence[str] = (),
) -> bytes:
    """Return the header of a mesh, with coordinates of float64 or float32.

    Property lines are of the vertices; comment lines tell what the coordinates mean.
    """
    return ply_header(
        [
            *comment_lines,
            *coordinate_lines(vertex_count, is_double),
            *property_lines,
            f"element face {face_count}",
            "property list uchar int vertex_indices",
        ]
    )


def coordinate_lines(vertex_count: int, is_double: bool) -> list[str]:
    """Return what a header says of the vertices and their coordinates, of float64 or float32."""
    kind = "double" if is_double else "float"
    return [f"element vertex {vertex_count}", *(f"property {kind} {name}" for name in "xyz")]


def vertex_size(is_double: bool) -> int:
    """Return the bytes of a vertex of float64 or float32."""
    return 24 if is_double else 12


def vertex_rows(vertices: FloatArray, origin: FloatArray, is_double: bool) -> NDArray[Any]:
    """Return vertices (v, 3), moved by the origin (3,), as the rows of a binary PLY file.

    They are of float64 or float32.
    """
    kind = "<f8" if is_double else "<f4"
    with np.errstate(over="ignore"):  # what float cannot hold becomes infinite
        if not origin.any():
            return vertices.astype(kind, copy=False)
        # Axis by axis straight into the type of the file: all at once would be a copy in float64.
        rows = np.empty((len(vertices), 3), kind)
        for axis, shift in enumerate(origin):
            column = vertices[:, axis]
            rows[:, axis] = column + shift if shift else column
    return rows


def face_rows(faces: IntArray) -> NDArray[Any]:
    """Return faces (f, 3) as the rows of a binary PLY file, structured, (f,)."""
    rows = np.empty(len(faces), _FACE)
    # 13 bytes each: how many corners, and these.
    rows["n"] = 3
    rows["corners"] = np.ascontiguousarray(faces, "<i4").view(_CORNERS)[:, 0]
    return rows
