"""Binary glTF 2.0: a mesh with the colours, normals and numbers of its vertices, to be shown.

::

    header │ JSON: one node, one mesh, one primitive │ each column of the vertices │ faces

https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hpcapp.geometry.axes import turn_up
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.io.columns import Numbers
from hpcapp.io.frame import choose_origin
from hpcapp.io.glb.linear_colours import to_light
from hpcapp.io.glb.texture import add_texture
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream
from hpcapp.io.staging import replacing
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import OutputError

_MAGIC, _VERSION = b"glTF", 2
_JSON, _BINARY = b"JSON", b"BIN\0"
_USHORT, _UINT, _FLOAT = 5123, 5125, 5126  # component types
_VERTICES, _FACES = 34962, 34963  # targets of buffer views
_MOST_BYTES = 2**32 - 1
_NAME = "mesh"
"""Of node, mesh and material; not the file's: bytes depend on what is in it alone."""
_SHAPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


@dataclass(frozen=True, slots=True)
class _VertexArray:
    """The numbers of all vertices for one semantic, 4 bytes or a multiple of them each."""

    semantic: str
    dtype: str
    width: int

    @property
    def size(self) -> int:
        return np.dtype(self.dtype).itemsize * self.width


def write_glb(path: Path, mesh: Mesh | MeshStream) -> None:
    """Write a triangle mesh as GLB.

    Vertices are written in single precision, in the local frame; the matrix of the node turns what
    is up into the y of glTF, and adds what is left of the origin. Colours become light, attributes
    become ``float`` under their names in capitals, after an underscore; NaN, which glTF forbids,
    becomes zero. From those that lie far from zero, as the times of GPS do, a number in the extras
    of the mesh is subtracted. What the input's coordinates mean is in the extras of the asset. A
    texture is in the file. Raise OutputError where it cannot be written, or would have more than 4
    GB.
    """
    stream = as_stream(mesh)
    names = _name_attributes(stream.layout)
    arrays = list(_list_arrays(stream.layout, names))
    sizes = [stream.vertex_count * array.size for array in arrays] + [12 * stream.face_count]
    offsets = _find_offsets(stream)
    document = _describe(stream, names, offsets, arrays, sizes)
    texture = [] if stream.texture is None else add_texture(document, stream.texture)
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    size = sum(sizes) + sum(map(len, texture))
    total = 12 + 8 + len(text) + 8 + size
    if total > _MOST_BYTES:
        raise OutputError(
            f"{path}: {total} bytes are too many for a GLB",
            f"write a .ply, or fewer {name_option('attributes')}",
        )
    with replacing(path) as file:
        file.write(_MAGIC + _integers(_VERSION, total) + _integers(len(text)) + _JSON + text)
        file.write(_integers(size) + _BINARY)
        starts = [file.tell(), *sizes]
        places = [sum(starts[: number + 1]) for number in range(len(arrays))]
        for vertices in stream.vertices():
            for number, rows in enumerate(_columns(vertices, offsets)):
                file.seek(places[number])
                places[number] += file.write(rows.data)
        file.seek(sum(starts[:-1]))
        for faces in stream.faces():
            file.write(np.ascontiguousarray(faces, "<u4").data)
        file.writelines(texture)


def _name_attributes(layout: PointCloud) -> dict[str, str]:
    """Return what glTF calls each attribute."""
    names: dict[str, str] = {}
    for name in layout.attributes:
        semantic = stem = "_" + re.sub(r"[^A-Z0-9]", "_", name.upper())
        number = 2
        while semantic in names.values():
            semantic, number = f"{stem}_{number}", number + 1
        names[name] = semantic
    return names


def _list_arrays(layout: PointCloud, names: dict[str, str]) -> Iterator[_VertexArray]:
    """Yield the arrays of what vertices have, in the order of `_columns`."""
    yield _VertexArray("POSITION", "<f4", 3)
    if layout.normals is not None:
        yield _VertexArray("NORMAL", "<f4", 3)
    if layout.colours is not None:
        yield _VertexArray("COLOR_0", "<u2", 4)
    for name in layout.attributes:
        yield _VertexArray(names[name], "<f4", 1)


def _find_offsets(stream: MeshStream) -> dict[str, float]:
    """Return what is subtracted from attributes that lie far from zero, by the first vertices."""
    if not any(column.dtype.itemsize > 2 for column in stream.layout.attributes.values()):
        return {}
    offsets: dict[str, float] = {}
    for name, column in next(stream.vertices(), stream.layout).attributes.items():
        finite = column[np.isfinite(column)].astype(np.float64)
        if (finite.astype(np.float32) != finite).any():
            offset = choose_origin(finite.min(keepdims=True), finite.max(keepdims=True))[0]
            offsets |= {name: float(offset)} if offset else {}
    return offsets


def _place(stream: MeshStream) -> dict[str, object]:
    """Return how the node of a mesh is placed, and which axis was up before."""
    matrix = np.eye(4)
    matrix[:3, :3] = turn_up(stream.up, to="y")
    matrix[:3, 3] = matrix[:3, :3] @ stream.origin
    return {"matrix": matrix.T.ravel().tolist(), "extras": {"up": stream.up}}


def _describe(
    stream: MeshStream,
    names: dict[str, str],
    offsets: dict[str, float],
    arrays: list[_VertexArray],
    sizes: list[int],
) -> dict[str, Any]:
    """Return the JSON of a mesh."""
    accessors: list[dict[str, object]] = []
    for number, array in enumerate(arrays):
        accessor: dict[str, object] = {
            "bufferView": number,
            "componentType": _FLOAT if array.dtype == "<f4" else _USHORT,
            "count": stream.vertex_count,
            "type": _SHAPES[array.width],
        }
        if array.semantic == "COLOR_0":
            accessor["normalized"] = True
        if array.semantic == "POSITION":
            low, high = np.asarray(stream.box, np.float32).tolist()
            accessor |= {"min": low, "max": high}
        accessors.append(accessor)
    primitive = {
        "attributes": {array.semantic: number for number, array in enumerate(arrays)},
        "indices": len(arrays),
        "mode": 4,
        "material": 0,
    }
    indices = {"bufferView": len(arrays), "componentType": _UINT, "count": 3 * stream.face_count}
    targets = [_VERTICES] * len(arrays) + [_FACES]
    extras = {"attributes": names} | ({"offsets": offsets} if offsets else {})
    return {
        "asset": {"version": "2.0", "generator": "hpcapp"} | say_frame(stream),
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": _NAME, **_place(stream)}],
        "meshes": [{"name": _NAME, "primitives": [primitive], "extras": extras}],
        # without a factor it is metal
        "materials": [{"name": _NAME, "pbrMetallicRoughness": {"metallicFactor": 0.0}}],
        "accessors": [*accessors, {**indices, "type": "SCALAR"}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": sum(sizes[:number]), "byteLength": size, "target": target}
            for number, (size, target) in enumerate(zip(sizes, targets, strict=True))
        ],
        "buffers": [{"byteLength": sum(sizes)}],
    }


def say_frame(stream: MeshStream) -> dict[str, object]:
    """Return what an asset says of the input's coordinates."""
    return {"extras": stream.said} if stream.said else {}


def _columns(vertices: PointCloud, offsets: dict[str, float]) -> Iterator[Numbers]:
    """Yield what some vertices have."""
    yield np.ascontiguousarray(vertices.positions, "<f4")
    if vertices.normals is not None:
        normals = vertices.normals.astype("<f4")
        normals[~vertices.normals.any(axis=1)] = (0, 0, 1)  # they must have a length
        yield normals
    if vertices.colours is not None:
        colours = np.full((len(vertices), 4), 65535, "<u2")
        colours[:, :3] = to_light(vertices.colours)
        yield colours
    for name, column in vertices.attributes.items():
        if name in offsets:
            column = column.astype(np.float64) - offsets[name]
        with np.errstate(over="ignore"):  # what float cannot hold becomes infinite, and zero
            single = column.astype("<f4")
        single[~np.isfinite(single)] = 0
        yield single


def _integers(*values: int) -> bytes:
    return np.array(values, "<u4").tobytes()
