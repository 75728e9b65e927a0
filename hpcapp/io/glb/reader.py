"""Reads binary glTF 2.0 as one mesh: the triangles of all nodes of its scene, in its frame.

https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from hpcapp.geometry.axes import turn_by, turn_up
from hpcapp.geometry.axis_names import AXES
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import ByteArray, FloatArray, IntArray
from hpcapp.io.batches import find_different
from hpcapp.io.columns import Numbers
from hpcapp.io.frame import check_coordinates, choose_origin, finite_bounds
from hpcapp.io.glb.document import (
    MEMORY,
    Accessor,
    Document,
    MeshExtras,
    Node,
    NodeExtras,
    Primitive,
    pick,
    read_extras,
)
from hpcapp.io.glb.linear_colours import to_bytes
from hpcapp.io.meshes.mesh_stream import find_vertices, make_mesh
from hpccomponent.dataclass import dataclass
from hpccomponent.decoding.claims import Claims
from hpccomponent.errors import InputError
from hpccomponent.foreign_json import decode_large

_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_HEAD, _CHUNK = 12, 8  # bytes
_TRIANGLES = 4
_DEEPEST = 64  # of nodes in nodes
_SIZES = {"POSITION": 1, "indices": 3}  # rows that make a vertex, and a face
_DECODED = 8  # bytes of a number, as float64 or int64


def read_glb(path: Path) -> Mesh:
    """Read a GLB file, with one buffer of its own and without compression, as a triangle mesh.

    Nodes are where their matrices put them, but for the turn to y up of `write_glb`; colours are
    kept where all primitives have some, attributes (semantics with an underscore, under the name
    that `write_glb` gave them) where there is one primitive. Vertices that a texture has cut apart,
    to lie in several charts, are one again. Raise InputError where the file is damaged, has no
    triangles, needs an extension, or claims too much memory.
    """
    with _translated(path):
        file = _open(path)
        known: set[int] = set()
        parts: list[_PlacedPrimitive] = []
        for root in file.roots:
            for part in _list_parts(file, root, np.eye(4), known, 0):
                file.claim(part)
                parts.append(part)
        with np.errstate(invalid="ignore", over="ignore"):  # NaN of any kind
            mesh = parts[0].read(file) if len(parts) == 1 else _join(file, parts)
        if parts and all("TEXCOORD_0" in part.primitive.attributes for part in parts):
            mesh = _join_charts(mesh)
        if not len(mesh.faces):
            raise InputError(f"{path}: holds no triangles", "give a mesh")
        return mesh


def find_glb_up(path: Path) -> str:
    """Return the axis that points up in the coordinates that `read_glb` gives: y, as glTF has it.

    Of a file of `write_glb` it is the one that was up before. Errors are those of `read_glb`.
    """
    with _translated(path):
        file = _open(path)
        nodes = [pick(file.document.nodes, root, "node") for root in file.roots]
        return next((up for node in nodes if (up := _find_turned(node))), "y")


def _find_turned(node: Node) -> str | None:
    """Return the axis that `write_glb` has turned to y in a node; None of other nodes."""
    up = read_extras(node.extras, NodeExtras).up
    return up if up in AXES else None


@contextmanager
def _translated(path: Path) -> Iterator[None]:
    """Say of what a damaged file raises that it is damaged."""
    try:
        yield
    except (KeyError, IndexError, ValueError, OverflowError) as error:
        raise InputError(
            f"{path}: is no whole GLB: {type(error).__name__}: {error}", "export it again"
        ) from None


@dataclass(frozen=True, slots=True, eq=False)
class _GlbFile:
    """What is in a GLB."""

    path: Path
    document: Document
    body: memoryview
    claims: Claims

    @property
    def roots(self) -> list[int]:
        scenes, nodes = self.document.scenes, self.document.nodes
        if scenes:
            return pick(scenes, self.document.scene, "scene").nodes
        inner = {child for node in nodes for child in node.children}
        return [number for number in range(len(nodes)) if number not in inner]

    def accessor(self, number: int) -> Accessor:
        """Return an accessor."""
        return pick(self.document.accessors, number, "accessor")

    def claim(self, part: _PlacedPrimitive) -> None:
        """Ask for the memory of what is read of a part."""
        for semantic, number in part.numbers.items():
            size = _DECODED * self._map(number).size
            self.claims.add(size, f"{semantic}, accessor {number}")

    def array(self, number: int, widths: Sequence[int], rows: int | None = None) -> Numbers:
        """Return the rows of an accessor: of such widths, and of so many rows."""
        accessor, array = self.accessor(number), self._map(number)
        if array.shape[1] not in widths or rows not in (None, len(array)):
            raise ValueError(f"accessor {number} is {len(array)} rows of {accessor.type}")
        if accessor.normalized and array.dtype.kind != "f":
            return np.divide(array, float(np.iinfo(array.dtype.str).max))
        return array

    def _map(self, number: int) -> Numbers:
        """Return the rows of an accessor as they are in the file, where nothing is copied."""
        accessor = self.accessor(number)
        if accessor.is_sparse or accessor.buffer_view is None:
            raise InputError(f"{self.path}: holds sparse accessors", "export it without them")
        dtype, width = np.dtype(_TYPES[accessor.component_type]), _WIDTHS[accessor.type]
        start, end, stride = self._view(accessor.buffer_view)
        count, length = accessor.count, dtype.itemsize * width
        stride = length if stride is None else stride
        if stride < length:
            raise ValueError(f"rows of accessor {number} overlap: they are {stride} bytes apart")
        start += accessor.byte_offset
        needed = start + (count - 1) * stride + length
        if not count:
            return np.empty((0, width), dtype)
        if needed > end:
            raise ValueError(
                f"{count} rows of accessor {number} end at byte {needed}, their view at {end}"
            )
        return np.ndarray((count, width), dtype, self.body, start, (stride, dtype.itemsize))

    def _view(self, number: int) -> tuple[int, int, int | None]:
        """Return where a view starts and ends in the body, and how far its rows are apart."""
        view = pick(self.document.buffer_views, number, "buffer view")
        if view.buffer or pick(self.document.buffers, 0, "buffer").has_uri:
            raise InputError(f"{self.path}: has buffers in other files", "export it as one file")
        end = view.byte_offset + view.byte_length
        if end > len(self.body):
            raise ValueError(f"buffer view {number} ends at byte {end} of {len(self.body)}")
        return view.byte_offset, end, view.byte_stride


def _open(path: Path) -> _GlbFile:
    raw = path.read_bytes()
    if raw[:4] != b"glTF" or len(raw) < _HEAD + _CHUNK:
        raise InputError(f"{path}: does not start as a GLB does", "export it as binary glTF 2.0")
    if (announced := int.from_bytes(raw[8:12], "little")) > len(raw):
        raise InputError(
            f"{path}: truncated: {announced} bytes are announced, the file has {len(raw)}",
            "copy or export the file again",
        )
    chunks: dict[bytes, memoryview] = {}
    at = _HEAD
    while at + _CHUNK <= len(raw):
        length = int.from_bytes(raw[at : at + 4], "little")
        chunks.setdefault(raw[at + 4 : at + 8], memoryview(raw)[at + _CHUNK :][:length])
        at += _CHUNK + length
    text, claims = bytes(chunks[b"JSON"]), Claims(path)
    claims.add(MEMORY * len(text), "its JSON")
    document = decode_large(text, Document)
    if needed := document.extensions_required:
        raise InputError(
            f"{path}: needs the extension {needed[0]}", "export it without compression"
        )
    return _GlbFile(path, document, chunks.get(b"BIN\0", memoryview(b"")), claims)


@dataclass(frozen=True, slots=True, eq=False)
class _PlacedPrimitive:
    """A primitive where a node puts it, and what `write_glb` says of its columns."""

    primitive: Primitive
    matrix: FloatArray
    extras: MeshExtras

    @property
    def numbers(self) -> dict[str, int]:
        """The accessors of what is read of it, by semantic."""
        columns, corners = self.primitive.attributes, self.primitive.indices
        found = {"POSITION": columns["POSITION"]}
        found["indices"] = columns["POSITION"] if corners is None else corners
        wanted = ("COLOR_0", *self.extras.attributes.values())
        return found | {name: columns[name] for name in wanted if name in columns}

    def read(self, file: _GlbFile) -> Mesh:
        """Read it; a translation alone keeps the local frame, as `write_glb` writes it."""
        columns, matrix = self.primitive.attributes, self.matrix
        places = file.array(columns["POSITION"], [3]).astype(np.float64)
        faces = self._read_faces(file, len(places))
        colours: ByteArray | None = None
        if "COLOR_0" in columns:
            light = file.array(columns["COLOR_0"], [3, 4], len(places))
            colours = to_bytes(light[:, :3].astype(np.float64))
        attributes = {
            name: file.array(columns[semantic], [1, 2, 3, 4], len(places))[:, 0].copy()
            for name, semantic in self.extras.attributes.items()
            if semantic in columns
        }
        for name, offset in self.extras.offsets.items():
            attributes[name] = attributes[name].astype(np.float64) + offset
        if not np.array_equal(matrix[:3, :3], np.eye(3)):
            places = places @ matrix[:3, :3].T
        return Mesh(places, faces, matrix[:3, 3].copy(), None, colours, attributes)

    def _read_faces(self, file: _GlbFile, vertices: int) -> IntArray:
        corners = np.arange(vertices)
        if self.primitive.indices is not None:
            named = file.array(self.primitive.indices, [1])
            if named.dtype.kind != "u":
                raise ValueError(f"faces that name their vertices as {named.dtype}")
            corners = named.reshape(-1).astype(np.int64)
        faces = corners[: len(corners) // 3 * 3].reshape(-1, 3)
        if len(faces) and faces.max() >= vertices:
            raise ValueError(f"a face names vertex {faces.max()} of {vertices}")
        return faces[:, ::-1] if np.linalg.det(self.matrix[:3, :3]) < 0 else faces


def _list_parts(
    file: _GlbFile, number: int, outer: FloatArray, known: set[int], depth: int
) -> Iterator[_PlacedPrimitive]:
    """Yield the primitives of a node and of those in it; a node is in one other at most."""
    node = pick(file.document.nodes, number, "node")
    if number in known:
        raise ValueError(f"node {number} is in two others, or in itself")
    if depth > _DEEPEST:
        raise ValueError("nodes are nested too deep")
    known.add(number)
    with np.errstate(over="ignore", invalid="ignore"):
        matrix = outer @ _matrix(node)
    if up := _find_turned(node):
        back = np.eye(4)
        back[:3, :3] = turn_up("y", to=up)
        matrix = back @ matrix
    check_coordinates(matrix[:3], file.path, f"the matrix of node {number}")
    if node.mesh is not None:
        mesh = pick(file.document.meshes, node.mesh, "mesh")
        is_single = len(mesh.primitives) == 1
        extras = read_extras(mesh.extras, MeshExtras) if is_single else MeshExtras()
        for primitive in mesh.primitives:
            if primitive.mode == _TRIANGLES:
                yield _PlacedPrimitive(primitive, matrix, extras)
    for child in node.children:
        yield from _list_parts(file, child, matrix, known, depth + 1)


def _matrix(node: Node) -> FloatArray:
    """Return the matrix of a node."""
    if node.matrix is not None:
        return np.array(node.matrix).reshape(4, 4).T
    matrix = np.eye(4)
    matrix[:3, :3] = turn_by(np.roll(node.rotation, 1)) * np.array(node.scale)
    matrix[:3, 3] = node.translation
    return matrix


def _join(file: _GlbFile, parts: list[_PlacedPrimitive]) -> Mesh:
    """Read parts as one mesh, one after the other: only one of them is in memory twice."""
    sizes = [
        [file.accessor(part.numbers[name]).count // group for name, group in _SIZES.items()]
        for part in parts
    ]
    ends = np.cumsum([[0, 0], *sizes], axis=0)
    has_colours = all("COLOR_0" in part.primitive.attributes for part in parts)
    vertices, faces = np.empty((ends[-1, 0], 3)), np.empty((ends[-1, 1], 3), np.int64)
    colours = np.empty(vertices.shape, np.uint8) if has_colours else None
    for part, (vertex, face), (end, last) in zip(parts, ends, ends[1:], strict=False):
        mesh = part.read(file)
        np.add(mesh.vertices, mesh.origin, out=vertices[vertex:end])
        np.add(mesh.faces, vertex, out=faces[face:last])
        if colours is not None and mesh.colours is not None:
            colours[vertex:end] = mesh.colours
    origin = choose_origin(*finite_bounds(vertices))
    vertices -= origin
    return Mesh(vertices, faces, origin, None, colours)


def _join_charts(mesh: Mesh) -> Mesh:
    """Return a mesh with one vertex at each place, without the faces that have two there."""
    rows, numbers = find_different(mesh.vertices)
    faces = numbers[mesh.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    return make_mesh(find_vertices(mesh).take(rows), faces, mesh.origin)
