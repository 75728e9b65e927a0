"""Reads binary glTF 2.0 as one mesh: the triangles of all nodes of its scene, in its frame.

https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hpcapp.geometry.axes import turn_up
from hpcapp.geometry.axis_names import AXES
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import ByteArray, FloatArray
from hpcapp.io.batches import find_different
from hpcapp.io.columns import Numbers
from hpcapp.io.frame import to_local
from hpcapp.io.meshes.linear_colours import to_bytes
from hpcapp.io.meshes.mesh_stream import find_vertices, make_mesh
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError
from hpccomponent.foreign_json import decode

_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_HEAD, _CHUNK = 12, 8  # bytes
_TRIANGLES = 4
_DEEPEST = 64  # of nodes in nodes


def read_glb(path: Path) -> Mesh:
    """Read a GLB file, with one buffer of its own and without compression, as a triangle mesh.

    Nodes are where their matrices put them, but for the turn to y up of `write_glb`; colours are
    kept where all primitives have some, attributes (semantics with an underscore, under the name
    that `write_glb` gave them) where there is one primitive. Vertices that a texture has cut apart,
    to lie in several charts, are one again.

    Raises
    ------
    InputError
        The file is damaged, has no triangles, or needs an extension.
    """
    with _translated(path):
        file = _open(path)
        known: set[int] = set()
        parts = [
            part for root in file.roots for part in _read_node(file, root, np.eye(4), known, 0)
        ]
        if not parts:
            raise InputError(f"{path}: holds no triangles", "give a mesh")
        return _join(parts)


def find_glb_up(path: Path) -> str:
    """Return the axis that points up in the coordinates that `read_glb` gives: y, as glTF has it.

    Of a file of `write_glb` it is the one that was up before.

    Raises
    ------
    InputError
        See `read_glb`.
    """
    with _translated(path):
        file = _open(path)
        nodes = [file.document["nodes"][root] for root in file.roots]
        return next((up for node in nodes if (up := _find_turned(node))), "y")


def _find_turned(node: dict[str, Any]) -> str | None:
    """Return the axis that `write_glb` has turned to y in a node; None of other nodes."""
    up = node.get("extras", {}).get("up")
    return up if up in AXES else None


@contextmanager
def _translated(path: Path) -> Iterator[None]:
    """Say of what a damaged file raises that it is damaged."""
    try:
        yield
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(
            f"{path}: is no whole GLB: {type(error).__name__}: {error}", "export it again"
        ) from None


@dataclass(frozen=True, slots=True, eq=False)
class _File:
    """What is in a GLB."""

    path: Path
    document: dict[str, Any]
    body: bytes

    @property
    def roots(self) -> list[int]:
        scenes = self.document.get("scenes")
        if scenes:
            return list(scenes[self.document.get("scene", 0)].get("nodes", []))
        nodes = self.document.get("nodes", [])
        inner = {child for node in nodes for child in node.get("children", [])}
        return [number for number in range(len(nodes)) if number not in inner]

    def array(self, number: int) -> Numbers:
        """Return the rows of an accessor."""
        accessor = self.document["accessors"][number]
        if "sparse" in accessor or "bufferView" not in accessor:
            raise InputError(f"{self.path}: holds sparse accessors", "export it without them")
        view = self.document["bufferViews"][accessor["bufferView"]]
        dtype, width = np.dtype(_TYPES[accessor["componentType"]]), _WIDTHS[accessor["type"]]
        stride = view.get("byteStride", dtype.itemsize * width)
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        needed = start + (accessor["count"] - 1) * stride + dtype.itemsize * width
        if needed > len(self.body):
            raise ValueError(
                f"{accessor['count']} rows of accessor {number} end at byte {needed} of "
                f"{len(self.body)}"
            )
        rows = np.ndarray(
            (accessor["count"], width), dtype, self.body, start, (stride, dtype.itemsize)
        )
        if accessor.get("normalized") and dtype.kind != "f":
            return rows / np.iinfo(dtype).max
        return rows


def _open(path: Path) -> _File:
    raw = path.read_bytes()
    if raw[:4] != b"glTF" or len(raw) < _HEAD + _CHUNK:
        raise InputError(f"{path}: does not start as a GLB does", "export it as binary glTF 2.0")
    if (announced := int.from_bytes(raw[8:12], "little")) > len(raw):
        raise InputError(
            f"{path}: truncated: {announced} bytes are announced, the file has {len(raw)}",
            "copy or export the file again",
        )
    chunks: dict[bytes, bytes] = {}
    at = _HEAD
    while at + _CHUNK <= len(raw):
        length = int.from_bytes(raw[at : at + 4], "little")
        chunks.setdefault(raw[at + 4 : at + 8], raw[at + _CHUNK : at + _CHUNK + length])
        at += _CHUNK + length
    document = decode(chunks[b"JSON"], dict[str, Any])
    if needed := document.get("extensionsRequired"):
        raise InputError(
            f"{path}: needs the extension {needed[0]}", "export it without compression"
        )
    return _File(path, document, chunks.get(b"BIN\0", b""))


def _read_node(
    file: _File, number: int, outer: FloatArray, known: set[int], depth: int
) -> Iterator[Mesh]:
    """Yield the primitives of a node and of those in it; a node is in one other at most."""
    if number < 0:
        raise IndexError(f"there is no node {number}")
    if number in known:
        raise ValueError(f"node {number} is in two others, or in itself")
    if depth > _DEEPEST:
        raise ValueError("nodes are nested too deep")
    known.add(number)
    node = file.document["nodes"][number]
    matrix = outer @ _matrix(node)
    if up := _find_turned(node):
        back = np.eye(4)
        back[:3, :3] = turn_up("y", to=up)
        matrix = back @ matrix
    if "mesh" in node:
        mesh = file.document["meshes"][node["mesh"]]
        is_single = len(mesh["primitives"]) == 1
        for primitive in mesh["primitives"]:
            if primitive.get("mode", _TRIANGLES) == _TRIANGLES:
                extras = mesh.get("extras", {}) if is_single else {}
                yield _read_primitive(file, primitive, matrix, extras)
    for child in node.get("children", []):
        yield from _read_node(file, child, matrix, known, depth + 1)


def _matrix(node: dict[str, Any]) -> FloatArray:
    """Return the matrix of a node."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    turn = np.array([
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ])  # fmt: skip
    matrix = np.eye(4)
    matrix[:3, :3] = turn * np.array(node.get("scale", (1, 1, 1)))
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def _read_primitive(
    file: _File, primitive: dict[str, Any], matrix: FloatArray, extras: dict[str, Any]
) -> Mesh:
    columns = primitive["attributes"]
    places = file.array(columns["POSITION"]).astype(np.float64)
    corners = (
        file.array(primitive["indices"]).reshape(-1).astype(np.int64)
        if "indices" in primitive
        else np.arange(len(places))
    )
    faces = corners[: len(corners) // 3 * 3].reshape(-1, 3)
    if len(faces) and faces.max() >= len(places):
        raise ValueError(f"a face names vertex {faces.max()} of {len(places)}")
    if np.linalg.det(matrix[:3, :3]) < 0:
        faces = faces[:, ::-1]
    colours: ByteArray | None = None
    if "COLOR_0" in columns:
        colours = to_bytes(file.array(columns["COLOR_0"])[:, :3].astype(np.float64))
    attributes = {
        name: file.array(columns[semantic])[:, 0].copy()
        for name, semantic in extras.get("attributes", {}).items()
        if semantic in columns
    }
    for name, offset in extras.get("offsets", {}).items():
        attributes[name] = attributes[name].astype(np.float64) + float(offset)
    # A translation alone keeps the local frame, as `write_glb` writes it.
    if not np.array_equal(matrix[:3, :3], np.eye(3)):
        places = places @ matrix[:3, :3].T
    mesh = Mesh(places, faces, matrix[:3, 3].copy(), None, colours, attributes)
    return _join_charts(mesh) if "TEXCOORD_0" in columns else mesh


def _join_charts(mesh: Mesh) -> Mesh:
    """Return a mesh with one vertex at each place, without the faces that have two there."""
    rows, numbers = find_different(mesh.vertices)
    faces = numbers[mesh.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    return make_mesh(find_vertices(mesh).take(rows), faces, mesh.origin)


def _join(parts: list[Mesh]) -> Mesh:
    """Return some meshes as one."""
    if len(parts) == 1:
        return parts[0]
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    vertices, origin = to_local(np.concatenate([part.vertices + part.origin for part in parts]))
    faces = np.concatenate([p.faces + start for p, start in zip(parts, starts, strict=False)])
    colours = [part.colours for part in parts if part.colours is not None]
    mesh = Mesh(vertices, faces, origin)
    return replace(mesh, colours=np.concatenate(colours)) if len(colours) == len(parts) else mesh
