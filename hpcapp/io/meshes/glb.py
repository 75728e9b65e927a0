"""Binary glTF 2.0: a mesh with the colours, normals and numbers of its vertices, to be shown.

::

    header │ JSON: one node, one mesh, one primitive │ vertices, interleaved │ faces

https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream
from hpcapp.io.staging import replacing
from hpccomponent.errors import OutputError
from hpccomponent.surface.types.mesh import Mesh
from hpccomponent.surface.types.points import PointCloud

__all__ = ["write_glb"]

_MAGIC, _VERSION = b"glTF", 2
_JSON, _BINARY = b"JSON", b"BIN\0"
_BYTE, _UINT, _FLOAT = 5121, 5125, 5126  # component types
_VERTICES, _FACES = 34962, 34963  # targets of buffer views
_MOST_STRIDE = 252  # bytes of a vertex
_MOST_BYTES = 2**32 - 1


def write_glb(path: Path, mesh: Mesh | MeshStream) -> None:
    """Write a triangle mesh as GLB.

    Parameters
    ----------
    path : Path
        Appears whole or not at all.
    mesh : Mesh or MeshStream
        Vertices are written in single precision, in the local frame; the origin is the
        translation of the node. Colours keep their bytes, attributes become ``float`` under their
        names in capitals, after an underscore; NaN, which glTF forbids, becomes zero.

    Raises
    ------
    OutputError
        The file cannot be written, or would have more than 4 GB.
    """
    stream = as_stream(mesh)
    names, dtype = _lay_out(stream.layout)
    sizes = stream.vertex_count * dtype.itemsize, 12 * stream.face_count
    text = json.dumps(_describe(stream, names, dtype, sizes), separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + sum(sizes)
    if total > _MOST_BYTES or dtype.itemsize > _MOST_STRIDE:
        raise OutputError(
            f"{path}: the mesh is too large for a GLB: {total} bytes, {dtype.itemsize} a vertex",
            "write a .ply, or carry fewer --attributes",
        )
    with replacing(path) as file:
        file.write(_MAGIC + _integers(_VERSION, total) + _integers(len(text)) + _JSON + text)
        file.write(_integers(sum(sizes)) + _BINARY)
        for vertices in stream.vertices():
            file.write(_join_rows(vertices, names, dtype).data)
        for faces in stream.faces():
            file.write(np.ascontiguousarray(faces, "<u4").data)


def _lay_out(layout: PointCloud) -> tuple[dict[str, str], np.dtype[Any]]:
    """Return what glTF calls each attribute, and the structure of a vertex."""
    names: dict[str, str] = {}
    for name in layout.attributes:
        semantic = stem = "_" + re.sub(r"[^A-Z0-9]", "_", name.upper())
        number = 2
        while semantic in names.values():
            semantic, number = f"{stem}_{number}", number + 1
        names[name] = semantic
    fields: list[tuple[Any, ...]] = [("POSITION", "<f4", 3)]
    if layout.normals is not None:
        fields.append(("NORMAL", "<f4", 3))
    if layout.colours is not None:
        fields.append(("COLOR_0", "u1", 4))
    return names, np.dtype(fields + [(semantic, "<f4") for semantic in names.values()])


def _describe(
    stream: MeshStream, names: dict[str, str], dtype: np.dtype[Any], sizes: tuple[int, int]
) -> dict[str, Any]:
    """Return the JSON of a mesh."""
    assert dtype.fields is not None  # noqa: S101 - it has some
    accessors: list[dict[str, Any]] = []
    for semantic, (kind, offset, *_) in dtype.fields.items():
        is_colour = semantic == "COLOR_0"
        accessor = {
            "bufferView": 0,
            "byteOffset": offset,
            "componentType": _BYTE if is_colour else _FLOAT,
            "count": stream.vertex_count,
            "type": {(): "SCALAR", (3,): "VEC3", (4,): "VEC4"}[kind.shape],
        }
        if is_colour:
            accessor["normalized"] = True
        if semantic == "POSITION":
            low, high = np.asarray(stream.box, np.float32).tolist()
            accessor |= {"min": low, "max": high}
        accessors.append(accessor)
    attributes = {semantic: number for number, semantic in enumerate(dtype.fields)}
    indices = {"bufferView": 1, "componentType": _UINT, "count": 3 * stream.face_count}
    node: dict[str, Any] = {"mesh": 0, "name": "mesh"}
    if stream.origin.any():
        node["translation"] = stream.origin.tolist()
    # No material: readers that find one look for its texture, and set colours aside.
    primitive = {"attributes": attributes, "indices": len(accessors), "mode": 4}
    return {
        "asset": {"version": "2.0", "generator": "hpcapp"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [node],
        "meshes": [{"primitives": [primitive], "extras": {"attributes": names}}],
        "accessors": [*accessors, {**indices, "type": "SCALAR"}],
        "bufferViews": [
            {
                "buffer": 0,
                "byteLength": sizes[0],
                "byteStride": dtype.itemsize,
                "target": _VERTICES,
            },
            {"buffer": 0, "byteOffset": sizes[0], "byteLength": sizes[1], "target": _FACES},
        ],
        "buffers": [{"byteLength": sum(sizes)}],
    }


def _join_rows(vertices: PointCloud, names: dict[str, str], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return some vertices as rows of the buffer."""
    rows = np.zeros(len(vertices), dtype)
    rows["POSITION"] = vertices.positions
    if vertices.normals is not None:
        rows["NORMAL"] = vertices.normals
        rows["NORMAL"][~vertices.normals.any(axis=1)] = (0, 0, 1)  # they must have a length
    if vertices.colours is not None:
        rows["COLOR_0"][:, :3] = vertices.colours
        rows["COLOR_0"][:, 3] = 255
    with np.errstate(over="ignore"):
        for name, semantic in names.items():
            column = vertices.attributes[name].astype(np.float32)
            rows[semantic] = np.where(np.isfinite(column), column, np.float32(0))
    return rows


def _integers(*values: int) -> bytes:
    return np.array(values, "<u4").tobytes()
