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
from typing import Any

import numpy as np

from hpcapp.io.meshes.glb import write_glb
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream
from hpcapp.io.staging import replacing_folder
from hpcapp.simplification.mesh import Target, simplify_mesh
from hpccomponent.surface.types.mesh import Mesh
from hpccomponent.surface.types.points import FloatArray, IntArray

__all__ = ["TILE_FACES", "write_tileset"]

TILE_FACES = 1 << 16
"""Triangles of a tile at most, but for those that its rim needs: some 2 MB."""


def write_tileset(path: Path, mesh: Mesh | MeshStream, tile_faces: int = TILE_FACES) -> None:
    """Write a triangle mesh as a folder of 3D Tiles, with ``tileset.json`` and GLB files.

    Parameters
    ----------
    path : Path
        The folder; it appears with all tiles, or not at all.
    mesh : Mesh or MeshStream
        Is brought into memory as a whole. The tiles are in the local frame, in single precision;
        the transform of the root adds the origin.
    tile_faces : int
        Most triangles of a tile.

    Raises
    ------
    OutputError
        The folder holds something, or cannot be written.
    UsageError
        The mesh needs coarser levels, and pyfqmr is not installed.
    """
    whole = _collect(as_stream(mesh))
    if len(whole.faces) > tile_faces:
        Target(faces=tile_faces).check()
    with replacing_folder(path) as folder:
        root, _ = _write_tile(folder, "0", whole, np.arange(len(whole.faces)), tile_faces)
        root["refine"] = "REPLACE"
        if whole.origin.any():
            root["transform"] = [*np.eye(4)[:3].ravel().tolist(), *whole.origin.tolist(), 1.0]
        diagonal = 2.0 * float(np.linalg.norm(_half_sides(root)))
        tileset = {
            "asset": {"version": "1.1", "generator": "hpcapp"},
            "geometricError": max(diagonal, root["geometricError"]),
            "root": root,
        }
        (folder / "tileset.json").write_text(json.dumps(tileset, indent=1) + "\n")


def _collect(stream: MeshStream) -> Mesh:
    """Return a mesh in memory, with what its vertices carry."""
    blocks, layout = list(stream.vertices()), stream.layout
    normals = [block.normals for block in blocks if block.normals is not None]
    colours = [block.colours for block in blocks if block.colours is not None]
    return Mesh(
        np.concatenate([np.empty((0, 3)), *(block.positions for block in blocks)]),
        np.concatenate([np.empty((0, 3), np.int64), *stream.faces()]),
        stream.origin,
        np.concatenate(normals) if normals else None,
        np.concatenate(colours) if colours else None,
        {name: np.concatenate([b.attributes[name] for b in blocks]) for name in layout.attributes},
    )


def _write_tile(
    folder: Path, name: str, whole: Mesh, faces: IntArray, most: int
) -> tuple[dict[str, Any], Mesh]:
    """Write a tile and all below it; return what the tileset says of it, and its mesh."""
    children: list[dict[str, Any]] = []
    error = 0.0
    if len(faces) <= most:
        tile = _take(whole, faces)
    else:
        halves = []
        for number, part in enumerate(_halve(whole, faces)):
            child, half = _write_tile(folder, f"{name}{number}", whole, part, most)
            children.append(child)
            halves.append(half)
        joined = _unite(*halves)
        tile = simplify_mesh(joined, Target(faces=most))
        error = max(child["geometricError"] for child in children) + _distance(joined, tile)
    write_glb(folder / f"{name}.glb", replace(tile, origin=np.zeros(3)), turns_up=True)
    low, high = tile.vertices.min(axis=0), tile.vertices.max(axis=0)
    for child in children:  # a box holds the boxes below it
        centre, sides = np.array(child["boundingVolume"]["box"][:3]), _half_sides(child)
        low, high = np.minimum(low, centre - sides), np.maximum(high, centre + sides)
    described: dict[str, Any] = {
        "boundingVolume": {
            "box": [*((low + high) / 2).tolist(), *np.diag((high - low) / 2).ravel().tolist()]
        },
        "geometricError": error,
        "content": {"uri": f"{name}.glb"},
    }
    if children:
        described["children"] = children
    return described, tile


def _half_sides(tile: dict[str, Any]) -> FloatArray:
    sides: FloatArray = np.array(tile["boundingVolume"]["box"][3:]).reshape(3, 3).diagonal()
    return sides


def _halve(whole: Mesh, faces: IntArray) -> tuple[IntArray, IntArray]:
    """Cut faces in two at the median of their centres along the longest side."""
    centres = whole.vertices[whole.faces[faces]].mean(axis=1)
    axis = int(np.ptp(centres, axis=0).argmax())
    order = np.argsort(centres[:, axis], kind="stable")
    middle = len(faces) // 2
    return np.sort(faces[order[:middle]]), np.sort(faces[order[middle:]])


def _take(whole: Mesh, faces: IntArray) -> Mesh:
    """Return some faces as a mesh of their own."""
    used, rows = np.unique(whole.faces[faces], return_inverse=True)
    return Mesh(
        whole.vertices[used],
        rows.reshape(-1, 3),
        whole.origin,
        None if whole.normals is None else whole.normals[used],
        None if whole.colours is None else whole.colours[used],
        {name: column[used] for name, column in whole.attributes.items()},
    )


def _unite(first: Mesh, second: Mesh) -> Mesh:
    """Join two tiles at the places of vertices that both have on their rims."""
    places = np.concatenate([first.vertices, second.vertices])
    _, rows, which = np.unique(places, axis=0, return_index=True, return_inverse=True)
    both = Mesh(
        places,
        np.concatenate([first.faces, second.faces + len(first.vertices)]),
        first.origin,
        _stack(first.normals, second.normals),
        _stack(first.colours, second.colours),
        {
            name: np.concatenate([column, second.attributes[name]])
            for name, column in first.attributes.items()
        },
    )
    same = rows[which.reshape(-1)]
    return _take(replace(both, faces=same[both.faces]), np.arange(len(both.faces)))


def _stack(first: Any, second: Any) -> Any:
    return None if first is None else np.concatenate([first, second])


def _distance(fine: Mesh, coarse: Mesh) -> float:
    """Return how far the vertices of a mesh are from the planes at the nearest of a coarser one."""
    from scipy.spatial import cKDTree  # scipy takes its time

    a, b, c = (coarse.vertices[coarse.faces[:, corner]] for corner in range(3))
    across = np.cross(b - a, c - a)
    normals = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300)
    centres = (a + b + c) / 3.0
    _, near = cKDTree(centres).query(fine.vertices)
    away = np.abs(((fine.vertices - centres[near]) * normals[near]).sum(axis=1))
    return float(away.max(initial=0.0))
