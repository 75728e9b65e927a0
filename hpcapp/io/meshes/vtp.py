"""VTK's XML PolyData: a mesh with all numbers of its vertices, for ParaView and others.

The arrays follow on the XML as they are, each after its length; where each begins is known before,
so that a mesh that comes block after block is written in one pass.

https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import BinaryIO
from xml.sax.saxutils import quoteattr

import numpy as np

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.ply_rows import vertex_rows
from hpcapp.geometry.points import PointCloud
from hpcapp.io.columns import Numbers
from hpcapp.io.crs import Crs
from hpcapp.io.frame import needs_double
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream
from hpcapp.io.staging import replacing
from hpccomponent.dataclass import dataclass

_LENGTH_BYTES = 8  # of the length in front of an array
_KINDS = {"i": "Int", "u": "UInt", "f": "Float"}


@dataclass(frozen=True, slots=True)
class _DataArray:
    """One array of the file."""

    name: str
    dtype: str
    components: int
    rows: int

    @property
    def size(self) -> int:
        return np.dtype(self.dtype).itemsize * self.components * self.rows

    def describe(self, offset: int) -> str:
        kind = np.dtype(self.dtype)
        return (
            f'<DataArray type="{_KINDS[kind.kind]}{8 * kind.itemsize}" Name={quoteattr(self.name)} '
            f'NumberOfComponents="{self.components}" format="appended" offset="{offset}"/>'
        )


def write_vtp(path: Path, mesh: Mesh | MeshStream) -> None:
    """Write a triangle mesh as VTP, in the input's frame.

    Coordinates are written like those of a PLY file; attributes are arrays of their names and
    types, normals and colours arrays called ``Normals`` and ``RGB``. Field data say what
    coordinates mean.
    """
    stream = as_stream(mesh)
    is_double = needs_double(stream.box, stream.origin)
    index = "<i4" if max(stream.vertex_count, 3 * stream.face_count) < 2**31 else "<i8"
    vertex_arrays = [
        _DataArray("Points", "<f8" if is_double else "<f4", 3, stream.vertex_count),
        *_list_arrays(stream.layout, stream.vertex_count),
    ]
    face_arrays = [
        _DataArray("connectivity", index, 1, 3 * stream.face_count),
        _DataArray("offsets", index, 1, stream.face_count),
    ]
    sizes = [_LENGTH_BYTES + array.size for array in (*vertex_arrays, *face_arrays)]
    offsets = [sum(sizes[:number]) for number in range(len(sizes))]
    with replacing(path) as file:
        file.write(_head(stream, vertex_arrays, face_arrays, offsets))
        start = file.tell()
        places = [start + offset for offset in offsets]
        count = len(vertex_arrays)
        vertices = (
            [vertex_rows(block.positions, stream.origin, is_double), *_columns(block)]
            for block in stream.vertices()
        )
        _write_arrays(file, vertex_arrays, places[:count], vertices)
        _write_arrays(file, face_arrays, places[count:], _index_faces(stream))
        file.seek(start + sum(sizes))
        file.write(b"\n</AppendedData>\n</VTKFile>\n")


def _list_arrays(layout: PointCloud, rows: int) -> Iterator[_DataArray]:
    """Yield the arrays of what vertices carry, in the order of `_columns`."""
    if layout.normals is not None:
        yield _DataArray("Normals", "<f4", 3, rows)
    if layout.colours is not None:
        yield _DataArray("RGB", "u1", 3, rows)
    for name, column in layout.attributes.items():
        kind, size = column.dtype.kind, column.dtype.itemsize
        dtype = {"b1": "u1", "f2": "<f4"}.get(f"{kind}{size}", f"{kind}{min(size, 8)}")
        yield _DataArray(name, np.dtype(dtype).newbyteorder("<").str, 1, rows)


def _columns(block: PointCloud) -> list[Numbers]:
    """Return what vertices carry."""
    given = (block.normals, block.colours)
    return [*(column for column in given if column is not None), *block.attributes.values()]


def _index_faces(stream: MeshStream) -> Iterator[list[Numbers]]:
    """Yield the corners of faces, and where each face's end."""
    done = 0
    for faces in stream.faces():
        yield [faces, 3 * np.arange(done + 1, done + len(faces) + 1)]
        done += len(faces)


def _head(
    stream: MeshStream,
    vertex_arrays: Sequence[_DataArray],
    face_arrays: Sequence[_DataArray],
    offsets: Sequence[int],
) -> bytes:
    """Return the XML in front of the arrays."""
    described = [
        array.describe(offset)
        for array, offset in zip((*vertex_arrays, *face_arrays), offsets, strict=True)
    ]
    count = len(vertex_arrays)
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">',
        "<PolyData>",
        *_say_frame(stream.crs),
        f'<Piece NumberOfPoints="{stream.vertex_count}" NumberOfVerts="0" NumberOfLines="0" '
        f'NumberOfStrips="0" NumberOfPolys="{stream.face_count}">',
        "<PointData>",
        *described[1:count],
        "</PointData>",
        "<Points>",
        described[0],
        "</Points>",
        "<Polys>",
        *described[count:],
        "</Polys>",
        "</Piece>",
        "</PolyData>",
        '<AppendedData encoding="raw">',
        "_",
    ]
    return "\n".join(lines).encode()


def _say_frame(crs: Crs) -> Iterator[str]:
    """Yield field data that say what coordinates mean, each character of a text as its number."""
    if crs.stated:
        yield "<FieldData>"
        for name, value in crs.stated.items():
            codes = " ".join(map(str, (*value.encode(), 0)))
            yield f'<DataArray type="String" Name="{name}" NumberOfTuples="1" format="ascii">'
            yield f"{codes}</DataArray>"
        yield "</FieldData>"


def _write_arrays(
    file: BinaryIO,
    arrays: Sequence[_DataArray],
    places: Sequence[int],
    blocks: Iterable[Sequence[Numbers]],
) -> None:
    """Write arrays side by side, some rows of each at a time."""
    at = []
    for array, place in zip(arrays, places, strict=True):
        file.seek(place)
        file.write(np.array([array.size], "<u8").data)
        at.append(place + _LENGTH_BYTES)
    for block in blocks:
        for number, (array, rows) in enumerate(zip(arrays, block, strict=True)):
            file.seek(at[number])
            with np.errstate(over="ignore"):  # what float cannot hold becomes infinite
                at[number] += file.write(np.ascontiguousarray(rows, array.dtype).data)
