"""OFF, the Object File Format of Geomview: vertices and faces, without colours."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np

from hpcapp.geometry.mesh import Mesh
from hpcapp.io.columns import Ragged
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream
from hpcapp.io.meshes.obj import comment_lines, coordinate_format
from hpcapp.io.meshes.polygons import mesh_of_polygons
from hpcapp.io.rows import (
    Line,
    is_count,
    line_error,
    numbered,
    parse_index,
    parse_table,
    take_lines,
    write_rows,
)
from hpcapp.io.staging import replacing
from hpccomponent.errors import InputError


def read_off(path: Path) -> Mesh:
    """Read an OFF file as a triangle mesh; polygons become triangle fans.

    ``#`` starts a comment; numbers after a face's corners are passed over. Raise InputError where a
    line is wrong, or the file is shorter or longer than its counts say.
    """
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        lines = numbered(line.partition("#")[0] for line in file)
        vertices, faces = _counts(lines, path)
        table = parse_table(take_lines(lines, vertices, path, "vertices"), 3, path)
        polygons = _polygons(take_lines(lines, faces, path, "faces"), path)
        for line in lines:
            raise line_error(path, line, "lines follow after the last face", "correct the counts")
    return mesh_of_polygons(table, polygons, path)


def _counts(lines: Iterator[Line], path: Path) -> tuple[int, int]:
    """Read the keyword and the counts, which may share a line."""
    number, text = next(lines, (1, ""))
    keyword, *words = text.split() or [""]
    if keyword != "OFF":
        raise InputError(
            f"{path}:{number}: not an OFF file: it starts with {keyword[:20]!r}, not OFF",
            "export the mesh without colours or normals, or as PLY",
        )
    lines = chain([(number, " ".join(words))], lines) if words else lines
    line = next(lines, (number, ""))
    counts = line[1].split()
    if len(counts) not in (2, 3) or not all(is_count(count) for count in counts):
        problem = f"not the counts of vertices, faces and edges: {line[1].strip()[:60]!r}"
        raise line_error(path, line, problem, "export the file again")
    return int(counts[0]), int(counts[1])


def _polygons(lines: Iterator[Line], path: Path) -> Ragged:
    lengths: list[int] = []
    corners: list[int] = []
    for line in lines:
        try:
            length, *rest = line[1].split()
            lengths.append(parse_index(length))
            corners += [parse_index(word) for word in rest[: lengths[-1]]]
        except ValueError:
            fits = False
        else:
            fits = 0 <= lengths[-1] <= len(rest)
        if not fits:
            problem = f"not a face: {line[1].strip()[:60]!r}"
            raise line_error(path, line, problem, "export the file again")
    return Ragged(np.array(lengths, np.int64), np.array(corners, np.int64))


def write_off(path: Path, mesh: Mesh | MeshStream) -> None:
    """Write a triangle mesh as OFF, in the input's frame, with coordinates like an OBJ's."""
    stream = as_stream(mesh)
    row = " ".join([coordinate_format(stream.origin)] * 3) + "\n"
    with replacing(path) as file:
        file.write(b"OFF\n")
        file.writelines(comment_lines(stream))
        file.write(f"{stream.vertex_count} {stream.face_count} 0\n".encode("ascii"))
        for vertices in stream.vertices():
            file.writelines(write_rows(row, vertices.positions + stream.origin))
        for faces in stream.faces():
            file.writelines(write_rows("3 %d %d %d\n", faces))
