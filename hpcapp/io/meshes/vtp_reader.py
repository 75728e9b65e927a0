"""Reads VTK's XML PolyData as a mesh: appended or inline arrays, raw, base64 or text.

https://docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Callable
from dataclasses import replace
from itertools import accumulate, pairwise
from pathlib import Path
from typing import NoReturn
from xml.etree import ElementTree as Xml

import numpy as np

from hpcapp.geometry.mesh import Mesh
from hpcapp.io.columns import Numbers, Ragged
from hpcapp.io.meshes.polygons import mesh_of_polygons
from hpccomponent.dataclass import dataclass
from hpccomponent.decoding.claims import Claims
from hpccomponent.errors import InputError

_ZLIB = "vtkZLibDataCompressor"
_APPENDED = b"<AppendedData"
_MOST_XML = 1 << 20  # bytes in front of appended data: far more than any list of arrays
_A_TAG = 256  # bytes of memory that an element takes, at most, its text set aside
_TYPES = {
    f"{name}{bits}": f"{letter}{bits // 8}"
    for name, letter, sizes in (("Int", "i", 8), ("UInt", "u", 8), ("Float", "f", 32))
    for bits in (8, 16, 32, 64)
    if bits >= sizes
}


def read_vtp(path: Path) -> Mesh:
    """Read a VTP file of one piece, compressed by zlib or not at all, as a triangle mesh.

    Polygons become triangle fans. An array ``RGB`` of bytes becomes the colours, ``Normals`` the
    normals, and every other array of one number for each vertex an attribute. Raise InputError
    where the file is damaged, has no polygons, or is compressed in another way.
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
        vertices = np.asarray(file.array(points, to="f8"), np.float64).reshape(-1, 3)
        corners = file.array(arrays["connectivity"], "iu", "i8")
        ends = file.array(arrays["offsets"], "iu", "i8")
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
class _VtpFile:
    """What is in a VTP."""

    root: Xml.Element
    appended: memoryview
    order: str
    length: np.dtype[np.unsignedinteger]
    claims: Claims

    def array(self, element: Xml.Element, kinds: str = "iuf", to: str | None = None) -> Numbers:
        """Return the numbers of a ``DataArray``, flat; they are of some kinds, or become a type."""
        kind, name = element.get("type", ""), element.get("Name", "")
        dtype = np.dtype(self.order + _TYPES.get(kind, "V0"))
        if dtype.kind not in kinds:
            raise ValueError(f"array {name!r} is of {kind}")
        widened = np.dtype(to or dtype)
        match element.get("format"):
            case "ascii":
                return np.array((element.text or "").split(), dtype).astype(widened)
            case "binary":
                packed = memoryview((element.text or "").strip().encode())
            case _:
                start = int(element.get("offset", 0))
                if not 0 <= start <= len(self.appended):
                    raise ValueError(f"an array begins at byte {start} of {len(self.appended)}")
                packed = self.appended[start:]

        def claim(size: int) -> None:
            self.claims.add(size // dtype.itemsize * widened.itemsize, f"array {name!r}")

        return np.frombuffer(self._unpack(packed, claim), dtype).astype(widened, copy=False)

    def _unpack(self, packed: memoryview, claim: Callable[[int], None]) -> bytes:
        """Return the bytes of an array, from where it starts."""
        is_compressed = self.root.get("compressor") is not None
        is_text = self.root.find("AppendedData") is None or (
            self.root.find("AppendedData").get("encoding") == "base64"  # type: ignore[union-attr]
        )
        word = self.length.itemsize
        head = self._numbers(packed, 3 if is_compressed else 1, is_text)
        if not is_compressed:
            claim(head[0])
            return _take(packed, word, head[0], is_text)
        blocks, block, last = head
        claim(max(blocks - 1, 0) * block + (last or block))
        sizes = self._numbers(packed, 3 + blocks, is_text)[3:]
        edges = list(accumulate(sizes, initial=0))
        body = memoryview(_take(packed, (3 + blocks) * word, edges[-1], is_text, is_apart=True))
        lengths = [block] * (blocks - 1) + [last or block]
        return b"".join(
            _inflate(body[a:b], length)
            for (a, b), length in zip(pairwise(edges), lengths, strict=False)
        )

    def _numbers(self, packed: memoryview, count: int, is_text: bool) -> list[int]:
        numbers = _take(packed, 0, count * self.length.itemsize, is_text)
        return [int(number) for number in np.frombuffer(numbers, self.length, count)]


def _inflate(packed: memoryview, length: int) -> bytes:
    """Return what a block holds, which is so long."""
    inflated = zlib.decompressobj().decompress(packed, length + 1)
    if len(inflated) != length:
        raise ValueError("a block holds more or less than it says")
    return inflated


def _take(
    packed: memoryview, start: int, size: int, is_text: bool, is_apart: bool = False
) -> bytes:
    """Return some bytes of what is packed; a head that stands apart is padded for itself."""
    if is_text:
        if is_apart:
            packed, start = packed[4 * -(-start // 3) :], 0
        text = packed[: 4 * -(-(start + size) // 3)]
        taken = base64.b64decode(text)[start : start + size]
    else:
        taken = bytes(packed[start : start + size])
    if len(taken) < size:
        raise ValueError("an array is cut")
    return taken


class _Builder(Xml.TreeBuilder):
    """Builds elements of a document without a document type, in any encoding."""

    def doctype(self, *declared: object) -> NoReturn:  # noqa: ARG002
        raise ValueError("it declares a document type")


def _open(path: Path) -> _VtpFile:
    raw = path.read_bytes()
    appended, text = memoryview(b""), raw
    tag = raw.find(_APPENDED, 0, _MOST_XML)
    marker = raw.find(b"_", raw.find(b">", tag, _MOST_XML), _MOST_XML) if tag >= 0 else -1
    if marker >= 0:
        appended = memoryview(raw)[marker + 1 :]
        text = raw[:marker] + b"</AppendedData></VTKFile>"
    claims = Claims(path)
    claims.add(len(text) + _A_TAG * text.count(b"<"), "its XML")
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
    return _VtpFile(root, appended, order, np.dtype(f"{order}u{word}"), claims)


def _add_columns(file: _VtpFile, piece: Xml.Element, mesh: Mesh) -> Mesh:
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
