"""Wavefront OBJ: vertices and faces, colours and normals of vertices; the rest is passed over."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray, PointCloud
from hpcapp.io.batches import find_different, join_points
from hpcapp.io.columns import Ragged
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream
from hpcapp.io.meshes.mtl import write_material
from hpcapp.io.meshes.polygons import mesh_of_polygons
from hpcapp.io.rows import Line, line_error, numbered, parse_index, parse_table, write_rows
from hpcapp.io.staging import replacing
from hpccomponent.errors import InputError


def read_obj(path: Path) -> Mesh:
    """Read an OBJ file as a triangle mesh; polygons become triangle fans.

    It has colours where each vertex has its own behind its coordinates, from 0 to 1. Raise
    InputError where a line is wrong, or there are no faces.
    """
    vertex_lines: list[Line] = []
    colour_lines: list[Line] = []
    lengths: list[int] = []
    corners: list[int] = []
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for line in numbered(file):
            keyword, *words = line[1].split()
            if keyword == "v":
                vertex_lines.append((line[0], " ".join(words[:3])))  # w or a colour may follow
                if len(words) >= 6:
                    colour_lines.append((line[0], " ".join(words[3:6])))
            elif keyword == "f":
                lengths.append(len(words))
                corners += _corners(words, len(vertex_lines), line, path)
    if not lengths:
        raise InputError(
            f"{path}: no faces (lines that start with f): not a mesh", "check the file"
        )
    vertices = parse_table(iter(vertex_lines), 3, path)
    polygons = Ragged(np.array(lengths, np.int64), np.array(corners, np.int64))
    mesh = mesh_of_polygons(vertices, polygons, path)
    if len(colour_lines) < len(vertex_lines):
        return mesh
    shares = np.clip(np.nan_to_num(parse_table(iter(colour_lines), 3, path)), 0.0, 1.0)
    return replace(mesh, colours=np.rint(255.0 * shares).astype(np.uint8))


def holds_obj_faces(path: Path) -> bool:
    """Tell whether an OBJ file has faces."""
    with path.open("rb") as file:
        return any(line.startswith((b"f ", b"f\t")) for line in file)


def _corners(words: list[str], vertices: int, line: Line, path: Path) -> list[int]:
    """Return vertex indices from 0; a negative one counts back from the latest vertex."""
    try:
        numbers = [parse_index(word.partition("/")[0]) for word in words]
    except ValueError:
        problem = f"not a face: {line[1].strip()[:60]!r}"
        raise line_error(path, line, problem, "export the file again") from None
    return [n - 1 if n > 0 else vertices + n if n < 0 else -1 for n in numbers]


def write_obj(path: Path, mesh: Mesh | MeshStream) -> None:
    """Write a triangle mesh as OBJ.

    Coordinates are written to the last digit if an origin was subtracted, else to the nine digits
    that tell one ``float`` from another; colours behind them, from 0 to 1. Comments say what
    coordinates mean. A texture lies in files beside it (see `write_material`); a vertex that it has
    in several charts is one, so that a closed mesh is.
    """
    stream = as_stream(mesh)
    formats = [coordinate_format(stream.origin)] * 3
    if stream.layout.colours is not None:
        formats += ["%.4f"] * 3
    row = "v " + " ".join(formats) + "\n"
    has_normals = stream.layout.normals is not None
    corner = "%d//%d" if has_normals else "%d"
    texture = stream.texture
    if texture is not None:
        corner = corner.replace("//", "/%d/") if has_normals else "%d/%d"
    face = f"f {corner} {corner} {corner}\n"
    material = [] if texture is None else write_material(path, texture)
    blocks, joined = _join_charts(stream)
    with replacing(path) as file:
        file.writelines([*comment_lines(stream), *material])
        for vertices in blocks:
            places = vertices.positions + stream.origin
            if vertices.colours is not None:
                places = np.hstack([places, vertices.colours / 255.0])
            file.writelines(write_rows(row, places))
            if vertices.normals is not None:
                file.writelines(write_rows("vn %.6g %.6g %.6g\n", vertices.normals))
        if texture is not None:
            file.writelines(write_rows("vt %.7g %.7g\n", abs(texture.places - (0.0, 1.0))))
        for faces in stream.faces():
            columns = [faces if joined is None else joined[faces], faces] * 2
            corners = np.stack(columns[: corner.count("%")], axis=2).reshape(len(faces), -1)
            file.writelines(write_rows(face, corners + 1))


def _join_charts(stream: MeshStream) -> tuple[Iterator[PointCloud], IntArray | None]:
    """Return the vertices to write, those of all charts once, and which of them each one is."""
    if stream.texture is None:
        return stream.vertices(), None
    rows, numbers = find_different(stream.texture.sources)
    return iter([join_points(list(stream.vertices())).take(rows)]), numbers


def comment_lines(stream: MeshStream) -> list[bytes]:
    """Return the comments that say what coordinates mean."""
    return [f"# {name} {value}\n".encode() for name, value in stream.said.items()]


def coordinate_format(origin: FloatArray) -> str:
    """Return the %-placeholder of a coordinate: all digits where an origin is added to it."""
    return "%.17g" if origin.any() else "%.9g"
