"""3D Tiles 1.1: a folder that a web viewer streams, coarse first and finer where it looks.

::

    tileset.json                the tree: boxes, errors, which file
    0.glb                       all of the mesh, simplified
    00.glb  01.glb              its halves, each of as many triangles at most
    000.glb ...                 and so on to the mesh itself

A tile's triangles are replaced by those of its halves. Where tiles meet, the vertices of the mesh
stay in all of them, so that a coarse one fits beside a fine one.

https://docs.ogc.org/cs/22-025r4/22-025r4.html
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from hpcapp.geometry.axes import turn_up
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.io.batches import join_points
from hpcapp.io.glb.writer import say_frame, write_glb
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream, find_vertices, make_mesh
from hpcapp.io.staging import replacing_folder
from hpcapp.simplification.parts import collapse, join_parts
from hpcapp.simplification.target import Target
from hpccomponent.dataclass import dataclass

TILE_FACES = 1 << 16
"""Triangles of a tile at most, but for those that its rim needs: some 2 MB."""


def write_tileset(path: Path, mesh: Mesh | MeshStream, tile_faces: int = TILE_FACES) -> None:
    """Write a triangle mesh as a folder of 3D Tiles, with ``tileset.json`` and GLB files.

    The mesh is brought into memory as a whole. The tiles, of so many triangles at most, are in the
    local frame, in single precision; the root's transform adds the origin, and turns what is up to
    z.
    """
    stream = as_stream(mesh)
    whole = _collect(stream)
    with replacing_folder(path) as folder:
        tile, *_ = _write_tile(folder, "0", whole, np.arange(len(whole.faces)), tile_faces)
        root = {**tile.to_json(), "refine": "REPLACE"}
        place = np.eye(4)
        place[:3, :3] = turn_up(stream.up)
        place[:3, 3] = place[:3, :3] @ whole.origin
        if (place != np.eye(4)).any():
            root["transform"] = place.T.ravel().tolist()
        tileset = {
            "asset": {"version": "1.1", "generator": "hpcapp"} | say_frame(stream),
            "geometricError": max(2.0 * float(np.linalg.norm(tile.half_sides)), tile.error),
            "root": root,
        }
        (folder / "tileset.json").write_text(json.dumps(tileset, indent=1) + "\n")


def _collect(stream: MeshStream) -> Mesh:
    """Return a mesh in memory, with what its vertices carry."""
    vertices = join_points([stream.layout, *stream.vertices()])
    faces = np.concatenate([np.empty((0, 3), np.int64), *stream.faces()])
    return make_mesh(vertices, faces, stream.origin)


@dataclass(frozen=True, slots=True, eq=False)
class _Tile:
    """A tile that is written.

    Its box, of centre and half sides (3,), is around it and all below it; `error` is how far the
    mesh is from it, at most.
    """

    name: str
    centre: FloatArray
    half_sides: FloatArray
    error: float
    children: list[_Tile]

    def to_json(self) -> dict[str, object]:
        """Return what the tileset says of it, and of all below it."""
        box = [*self.centre.tolist(), *np.diag(self.half_sides).ravel().tolist()]
        described: dict[str, object] = {
            "boundingVolume": {"box": box},
            "geometricError": self.error,
            "content": {"uri": f"{self.name}.glb"},
        }
        if self.children:
            described["children"] = [child.to_json() for child in self.children]
        return described


def _write_tile(
    folder: Path, name: str, whole: Mesh, faces: IntArray, most: int
) -> tuple[_Tile, Mesh, IntArray]:
    """Write a tile and all below it, and return it with its mesh.

    The vertices of the mesh are named by those of the whole that they still are, or -1.
    """
    children: list[_Tile] = []
    error = 0.0
    if len(faces) <= most:
        mesh, names = _take(whole, faces)
    else:
        halves = []
        for number, part in enumerate(_halve(whole, faces)):
            child, *half = _write_tile(folder, f"{name}{number}", whole, part, most)
            children.append(child)
            halves.append(half)
        joined, joined_names = join_parts(*zip(*halves, strict=True))
        mesh, kept = collapse(joined, Target(faces=most), keeps_border=True)
        names = np.where(kept >= 0, joined_names[kept], -1)
        error = max(child.error for child in children) + _distance(joined, mesh)
    write_glb(folder / f"{name}.glb", replace(mesh, origin=np.zeros(3)))
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    for child in children:  # a box holds the boxes below it
        low = np.minimum(low, child.centre - child.half_sides)
        high = np.maximum(high, child.centre + child.half_sides)
    return _Tile(name, (low + high) / 2, (high - low) / 2, error, children), mesh, names


def _halve(whole: Mesh, faces: IntArray) -> tuple[IntArray, IntArray]:
    """Cut faces in two at the median of their centres along the longest side."""
    centres = whole.vertices[whole.faces[faces]].mean(axis=1)
    axis = int(np.ptp(centres, axis=0).argmax())
    order = np.argsort(centres[:, axis], kind="stable")
    middle = len(faces) // 2
    return np.sort(faces[order[:middle]]), np.sort(faces[order[middle:]])


def _take(whole: Mesh, faces: IntArray) -> tuple[Mesh, IntArray]:
    """Return some faces as a mesh of their own, and which vertices of the whole it has."""
    used, rows = np.unique(whole.faces[faces], return_inverse=True)
    return make_mesh(find_vertices(whole).take(used), rows.reshape(-1, 3), whole.origin), used


def _distance(fine: Mesh, coarse: Mesh) -> float:
    """Return how far the vertices of a mesh are from the planes at the nearest of a coarser one."""
    from scipy.spatial import cKDTree  # scipy takes its time

    a, b, c = (coarse.vertices[coarse.faces[:, corner]] for corner in range(3))
    across = np.cross(b - a, c - a)
    normals = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    centres = (a + b + c) / 3.0
    _, nearest = cKDTree(centres).query(fine.vertices)
    away = np.abs(((fine.vertices - centres[nearest]) * normals[nearest]).sum(axis=1))
    return float(away.max(initial=0.0))
