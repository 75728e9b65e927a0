"""Reads VTK's XML PolyData as a mesh: appended or inline arrays, raw, base64 or text.

https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

from __future__ import annotations

import base64
import binascii
import re
import zlib
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree as Xml

import numpy as np

from hpcapp.geometry.mesh import Mesh
from hpcapp.io.columns import Numbers, Ragged
from hpcapp.io.meshes.polygons import mesh_of_polygons
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

_ZLIB = "vtkZLibDataCompressor"
_APPENDED = re.compile(rb"<AppendedData[^>]*>\s*_")
_MOST_XML = 1 << 20  # bytes in front of appended data: far more than any list of arrays


def read_vtp(path: Path) -> Mesh:
    """Read a VTP file of one piece, compressed by zlib or not at all, as a triangle mesh.

    Polygons become triangle fans. An array ``RGB`` of bytes becomes the colours, ``Normals`` the
    normals, and every other array of one number for each vertex an attribute.

    Raises
    ------
    InputError
        The file is damaged, has no polygons, or is compressed in another way.
    """
    try:
        file = _open(path)
        piece = file.root.find("PolyData/Piece")
        if piece is None:
            raise ValueError("no PolyData with a Piece")
        points = piece.find("Points/DataArray")
        arrays = {one.get("Name"): one for one in piece.iterfind("Polys/DataArray")}
        if points is None or not {"connectivity", "offsets"} <= arrays.keys():
            raise ValueError("no points, or no polygons")
        vertices = file.array(points).reshape(-1, 3).astype(np.float64)
        corners = file.array(arrays["connectivity"]).astype(np.int64)
        ends = file.array(arrays["offsets"]).astype(np.int64)
        if not len(ends):
            raise InputError(f"{path}: holds no polygons", "give a mesh")
        _check_counts(piece, path, len(vertices), len(ends))
        polygons = Ragged(np.diff(ends, prepend=0), corners)
        mesh = mesh_of_polygons(vertices, polygons, path)
        return _add_columns(file, piece, mesh)
    except (KeyError, IndexError, TypeError, ValueError, Xml.ParseError, zlib.error) as error:
        raise InputError(
            f"{path}: is no whole VTP: {type(error).__name__}: {error}", "export it again"
        ) from None


def _check_counts(piece: Xml.Element, path: Path, points: int, polygons: int) -> None:
    """Compare what a piece announces with what it holds."""
    for name, present in (("NumberOfPoints", points), ("NumberOfPolys", polygons)):
        announced = piece.get(name)
        if announced is not None and int(announced) != present:
            raise InputError(
                f"{path}: {name} is {announced}, and {present} are there",
                "copy or export the file again",
            )


@dataclass(frozen=True, slots=True, eq=False)
class _File:
    """What is in a VTP."""

    root: Xml.Element
    appended: bytes
    order: str
    length: np.dtype[np.unsignedinteger]

    def array(self, element: Xml.Element) -> Numbers:
        """Return the numbers of a ``DataArray``, flat."""
        kind = element.get("type", "")
        size = re.fullmatch(r"(U?Int|Float)(8|16|32|64)", kind)
        if size is None:
            raise ValueError(f"an array of {kind}")
        letter = {"Int": "i", "UInt": "u", "Float": "f"}[size[1]]
        dtype = np.dtype(f"{self.order}{letter}{int(size[2]) // 8}")
        match element.get("format"):
            case "ascii":
                return np.array((element.text or "").split(), dtype)
            case "binary":
                return np.frombuffer(self._unpack((element.text or "").strip().encode()), dtype)
            case _:
                start = int(element.get("offset", 0))
                return np.frombuffer(self._unpack(self.appended[start:]), dtype)

    def _unpack(self, packed: bytes) -> bytes:
        """Return the bytes of an array, from where it starts."""
        is_compressed = self.root.get("compressor") is not None
        is_text = self.root.find("AppendedData") is None or (
            self.root.find("AppendedData").get("encoding") == "base64"  # type: ignore[union-attr]
        )
        word = self.length.itemsize
        words = 3 if is_compressed else 1
        head = self._numbers(packed, words, is_text)
        if is_compressed:
            blocks = int(head[0])
            sizes = self._numbers(packed, 3 + blocks, is_text)[3:]
            words, total = 3 + blocks, int(sizes.sum())
        else:
            total = int(head[0])
        body = _take(packed, words * word, total, is_text, is_apart=is_compressed)
        if len(body) < total:
            raise ValueError("an array is cut")
        if not is_compressed:
            return body
        edges = np.cumsum([0, *sizes.tolist()]).tolist()
        return b"".join(zlib.decompress(body[a:b]) for a, b in pairwise(edges))

    def _numbers(self, packed: bytes, count: int, is_text: bool) -> Numbers:
        numbers = _take(packed, 0, count * self.length.itemsize, is_text)
        return np.frombuffer(numbers, self.length, count)


def _take(packed: bytes, start: int, size: int, is_text: bool, is_apart: bool = False) -> bytes:
    """Return some bytes of what is packed; a head that stands apart is padded for itself."""
    if not is_text:
        return packed[start : start + size]
    if is_apart:
        packed, start = packed[4 * -(-start // 3) :], 0
    text = packed[: 4 * -(-(start + size) // 3)]
    try:
        return base64.b64decode(text)[start : start + size]
    except binascii.Error as error:
        raise ValueError(str(error)) from None


class _Builder(Xml.TreeBuilder):
    """Builds elements of a document without a document type, in any encoding."""

    def doctype(self, *declared: object) -> NoReturn:  # noqa: ARG002
        raise ValueError("it declares a document type")


def _open(path: Path) -> _File:
    raw = path.read_bytes()
    marker = _APPENDED.search(raw, 0, _MOST_XML)
    appended = b""
    text = raw
    if marker:
        appended = raw[marker.end() :]
        text = raw[: marker.end() - 1] + b"</AppendedData></VTKFile>"
    parser = Xml.XMLParser(target=_Builder())  # noqa: S314 - without a document type nothing is expanded
    parser.feed(text)
    root: Xml.Element = parser.close()
    if root.tag != "VTKFile" or root.get("type") != "PolyData":
        raise ValueError("it is no PolyData")
    if root.get("compressor") not in (None, _ZLIB):
        raise InputError(
            f"{path}: is compressed by {root.get('compressor')}", "write it by zlib, or as it is"
        )
    order = ">" if root.get("byte_order") == "BigEndian" else "<"
    word = 8 if root.get("header_type") == "UInt64" else 4
    return _File(root, appended, order, np.dtype(f"{order}u{word}"))


def _add_columns(file: _File, piece: Xml.Element, mesh: Mesh) -> Mesh:
    """Return a mesh with the arrays of its vertices."""
    count, attributes = len(mesh.vertices), {}
    for element in piece.iterfind("PointData/DataArray"):
        name, values = element.get("Name", ""), file.array(element)
        if name == "RGB" and values.dtype == np.uint8 and len(values) == 3 * count:
            mesh = replace(mesh, colours=values.view(np.uint8).reshape(-1, 3))
        elif name == "Normals" and len(values) == 3 * count:
            mesh = replace(mesh, normals=values.reshape(-1, 3).astype(np.float64))
        elif len(values) == count:
            attributes[name] = values
    return replace(mesh, attributes=attributes)
