"""Corners of triangles in single precision, for a format that knows vertices by their places alone.

Two vertices that fall on one another would be one to whoever reads them, and what was closed would
be closed no more: one of the two goes to the next number beside it.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np

from hpcapp.geometry.lattice import find_keys, number_keys, shuffle_keys, unique_keys
from hpcapp.geometry.points import BoolArray, Float32Array, FloatArray, IntArray
from hpcapp.io.meshes.mesh_stream import MeshStream, make_array
from hpccomponent.cli.option_names import name_option
from hpccomponent.errors import OutputError

_BESIDE = np.array(sorted(product((-1, 0, 1), repeat=3), key=np.count_nonzero)[1:], np.float32)
"""The steps to the 26 places around one, the nearest first."""


def round_corners(path: Path, mesh: MeshStream) -> Iterator[tuple[FloatArray, Float32Array]]:
    """Yield blocks of faces' corners (n, 3, 3), local, and with the origin in single precision.

    Messages name the path. Raise OutputError where vertices fall on one another, and no place
    beside them is free.
    """
    moved, places = _move_apart(path, mesh)
    if not len(moved):
        yield from ((corners, _round(corners, mesh.origin)) for corners in mesh.corners())
        return
    for faces, corners in zip(mesh.faces(), mesh.corners(), strict=True):
        rounded, rows = _round(corners, mesh.origin), find_keys(moved, faces)
        is_moved = rows < len(moved)
        rounded[is_moved] = places[rows[is_moved]]
        yield corners, rounded


def _round(places: FloatArray, origin: FloatArray) -> Float32Array:
    rounded: Float32Array = (places + origin).astype(np.float32)
    return rounded


def _hash(places: Float32Array) -> IntArray:
    """Return a key for each place, shape (n,)."""
    bits = (places + np.float32(0.0)).view(np.uint32).astype(np.int64)  # -0 and 0 are one place
    keys: IntArray = shuffle_keys(shuffle_keys(bits[:, 0] << 32 | bits[:, 1]) ^ bits[:, 2])
    return keys


def _move_apart(path: Path, mesh: MeshStream) -> tuple[IntArray, Float32Array]:
    """Return the vertices that have to move, sorted, and where to."""
    keys = _sort_keys(mesh)
    rows, places = _find_shared(mesh, unique_keys(keys[1:][keys[1:] == keys[:-1]]))
    _, first, group = np.unique(
        places + np.float32(0.0), axis=0, return_index=True, return_inverse=True
    )
    group = group.reshape(-1)
    # A border that touches itself or others is meant to: read back, it is closed there.
    is_left = np.bincount(group, _are_open(mesh, rows), len(first)) > 0
    is_left[np.bincount(group, minlength=len(first)) == 1] = True
    chosen = np.setdiff1d(np.flatnonzero(~is_left[group]), first)
    with np.errstate(over="ignore"):
        step = np.spacing(np.float32(np.abs(mesh.box + mesh.origin).max()))
    taken: set[int] = set()
    for row in chosen:
        beside = places[row] + step * _BESIDE
        beside_keys = _hash(beside)
        is_free = (find_keys(keys, beside_keys) == len(keys)) & np.isfinite(beside).all(axis=1)
        free = [at for at in np.flatnonzero(is_free) if int(beside_keys[at]) not in taken]
        if not free:
            raise OutputError(
                f"{path}: in single precision, vertices of the mesh fall on one another, so that "
                "it would not stay closed",
                f"write it near zero, {name_option('origin', 'auto')}, or a .ply",
            )
        taken.add(int(beside_keys[free[0]]))
        places[row] = beside[free[0]]
    return rows[chosen], places[chosen]


def _sort_keys(mesh: MeshStream) -> IntArray:
    """Return the keys of the places of all vertices, sorted, in a file."""
    keys, start = make_array((mesh.vertex_count,), np.int64), 0
    for block in mesh.vertices():
        keys[start : start + len(block)] = _hash(_round(block.positions, mesh.origin))
        start += len(block)
    keys.sort()
    return keys


def _find_shared(mesh: MeshStream, shared: IntArray) -> tuple[IntArray, Float32Array]:
    """Return the vertices with one of some sorted keys, and where they are."""
    rows, places, start = [np.empty(0, np.int64)], [np.empty((0, 3), np.float32)], 0
    for block in mesh.vertices() if len(shared) else ():
        rounded = _round(block.positions, mesh.origin)
        chosen = np.flatnonzero(find_keys(shared, _hash(rounded)) < len(shared))
        rows.append(start + chosen)
        places.append(rounded[chosen])
        start += len(block)
    return np.concatenate(rows), np.concatenate(places)


def _are_open(mesh: MeshStream, rows: IntArray) -> BoolArray:
    """Tell around which of some vertices, sorted, the faces are no ring."""
    if not len(rows):
        return np.empty(0, np.bool_)
    has_one = (block[(find_keys(rows, block) < len(rows)).any(axis=1)] for block in mesh.faces())
    tails = np.concatenate(list(has_one))
    heads = np.roll(tails, -1, axis=1)
    edges = np.minimum(tails, heads) * mesh.vertex_count + np.maximum(tails, heads)
    found, number = number_keys(edges.reshape(-1))
    is_bare = (np.bincount(number, minlength=len(found)) != 2)[number].reshape(-1, 3)
    is_open: BoolArray = np.isin(rows, np.concatenate([tails[is_bare], heads[is_bare]]))
    return is_open
