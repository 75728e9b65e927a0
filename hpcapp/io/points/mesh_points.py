"""Meshes as point clouds: their vertices.

A vertex takes its normal from the faces around it, weighted by their areas; an OBJ may also have
normals and colours of its own, or no faces at all.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.geometry.vertex_normals import add_face_normals, scale_normals
from hpcapp.io.batches import cut_points
from hpcapp.io.columns import Numbers
from hpcapp.io.crs import UNKNOWN
from hpcapp.io.frame import finite_bounds
from hpcapp.io.geocentric import find_upright
from hpcapp.io.meshes.obj import read_obj
from hpcapp.io.meshes.off import read_off
from hpcapp.io.meshes.stl import read_stl
from hpcapp.io.points.column_roles import name_columns
from hpcapp.io.points.point_source import Findings, PointSource
from hpcapp.io.rows import Line, line_error, numbered, parse_table
from hpccomponent.errors import InputError

UNUSED = "vertices without a face"


def open_stl(path: Path) -> PointSource:
    """Open the corners of an STL file as points, each place once; InputError without triangles."""
    return _open_mesh(path, "STL, a mesh", read_stl(path))


def open_off(path: Path) -> PointSource:
    """Open the vertices of an OFF file as points."""
    return _open_mesh(path, "OFF, a mesh", read_off(path))


def open_obj(path: Path) -> PointSource:
    """Open the vertices of an OBJ file as points, with faces or without.

    Colours behind the coordinates of ``v`` are read; ``vn`` are the normals where there are no
    faces and as many of them as vertices. Raise InputError where a line is wrong, or there are no
    vertices.
    """
    vertex_lines: list[Line] = []
    normal_lines: list[Line] = []
    has_faces = False
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for number, text in numbered(file):
            keyword, _, rest = text.strip().partition(" ")
            if keyword == "v":
                vertex_lines.append((number, rest))
            elif keyword == "vn":
                normal_lines.append((number, rest))
            has_faces = has_faces or keyword == "f"
    if not vertex_lines:
        raise InputError(f"{path}: no points (lines that start with v)", "check the file")
    positions, colours = _parse_vertices(vertex_lines, path)
    if has_faces:
        return _open_mesh(path, "OBJ, a mesh", read_obj(path), colours)
    normals = None
    if len(normal_lines) == len(vertex_lines):
        normals = parse_table(iter(normal_lines), 3, path)
    return slice_cloud(path, "OBJ", PointCloud(positions, normals, colours))


def _parse_vertices(lines: list[Line], path: Path) -> tuple[FloatArray, NDArray[np.float64] | None]:
    """Return coordinates and colours: x y z, x y z w, x y z r g b or x y z r g b a."""
    columns = len(lines[0][1].split())
    if columns not in (3, 4, 6, 7):
        raise line_error(
            path, lines[0], f"{columns} numbers", "write v x y z, or v x y z red green blue"
        )
    table = parse_table(iter(lines), columns, path)
    positions = np.ascontiguousarray(table[:, :3])
    if columns == 4:
        weights = table[:, 3:]
        positions = np.divide(positions, weights, out=positions, where=weights != 0)
    return positions, table[:, 3:6].copy() if columns >= 6 else None


def _open_mesh(path: Path, name: str, mesh: Mesh, colours: Numbers | None = None) -> PointSource:
    sums = np.zeros((3, len(mesh.vertices)))
    add_face_normals(sums, mesh.faces, mesh.vertices[mesh.faces])
    normals = scale_normals(sums)
    used = np.zeros(len(mesh.vertices), np.bool_)
    used[mesh.faces] = True
    findings = Findings()
    findings.drop(UNUSED, int(len(used) - used.sum()))
    cloud = PointCloud(mesh.vertices + mesh.origin, normals, colours).take(used)
    return replace(slice_cloud(path, name, cloud, findings), normals_from="faces")


def slice_cloud(
    path: Path, name: str, cloud: PointCloud, findings: Findings | None = None
) -> PointSource:
    """Return a cloud in memory, in the file's coordinates, as a source of a named format."""
    return PointSource(
        path, len(cloud), True, cloud.normals is not None, partial(cut_points, cloud), format=name,
        columns=name_columns(cloud), findings=findings or Findings(),
        upright=find_upright(*finite_bounds(cloud.positions), UNKNOWN),
    )  # fmt: skip
