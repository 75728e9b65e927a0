"""A copy of a mesh with few enough triangles to be shown, at bounded memory.

Vertices in one cell of a lattice become one, at their mean; faces that collapse go. It is for the
eye: the copy may be neither watertight nor manifold.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hpcapp.geometry.lattice import pack_places
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray, PointCloud
from hpcapp.io.batches import join_points
from hpcapp.io.meshes.mesh_stream import MeshStream, as_stream, make_mesh

MOST_FACES = 2_000_000
"""Faces that a page shows; of a larger mesh it shows a copy with about as many at most."""
_COARSER = 1.25  # cells of a next attempt, where too many faces are left


def thin_mesh(mesh: Mesh | MeshStream, most: int = MOST_FACES) -> Mesh:
    """Return a mesh as it is, or in the same frame a copy of it with at most so many faces.

    Of what the vertices of a cell carry, colours are means and attributes are those of the first.
    """
    stream = as_stream(mesh)
    if stream.face_count <= most:
        return mesh if isinstance(mesh, Mesh) else gather_mesh(stream)
    # About two faces for each cell that the surface passes; edges of the copy are cells long.
    edge = _mean_edge(stream) * float(np.sqrt(stream.face_count / most))
    while True:
        keys, corners = _merge_faces(stream, edge)
        if len(corners) <= most:
            return _merge_vertices(stream, edge, keys, corners)
        edge *= _COARSER


def gather_mesh(stream: MeshStream) -> Mesh:
    """Return a mesh that comes in blocks as one in memory."""
    vertices = join_points(list(stream.vertices()) or [stream.layout])
    faces = [np.empty((0, 3), np.int64), *stream.faces()]
    return make_mesh(vertices, np.concatenate(faces).astype(np.int64), stream.origin)


def _mean_edge(stream: MeshStream) -> float:
    """Return the mean length of the edges in the first block of faces."""
    corners = next(stream.corners())
    return float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).mean())


def _cells(places: FloatArray, low: FloatArray, edge: float) -> IntArray:
    """Return the key of the cell that each place lies in."""
    return pack_places(np.floor((places - low) / edge).astype(np.int64))


def _merge_faces(stream: MeshStream, edge: float) -> tuple[IntArray, IntArray]:
    """Return the cells that are corners, sorted, and the faces between them."""
    faces = np.empty((0, 3), np.int64)
    for corners in stream.corners():
        cells = _cells(corners.reshape(-1, 3), stream.box[0], edge).reshape(-1, 3)
        a, b, c = cells.T
        faces = np.concatenate([faces, cells[(a != b) & (b != c) & (c != a)]])
    first = faces.argmin(axis=1)  # a face begins with its least corner: so equal ones are alike
    faces = np.stack([faces[np.arange(len(faces)), (first + k) % 3] for k in range(3)], axis=1)
    keys, rows = np.unique(faces.reshape(-1), return_inverse=True)
    return keys, np.unique(rows.reshape(-1, 3), axis=0)


def _merge_vertices(stream: MeshStream, edge: float, keys: IntArray, corners: IntArray) -> Mesh:
    """Return the mesh whose vertices are the means of those in the cells `keys`."""
    count = np.zeros(len(keys))
    sums = np.zeros((len(keys), 3))
    has_colours = stream.layout.colours is not None
    shades = np.zeros((len(keys), 3))
    attributes = {
        name: np.zeros(len(keys), c.dtype) for name, c in stream.layout.attributes.items()
    }
    for rows, block in _rows_of_cells(stream, edge, keys):
        for axis in range(3):
            sums[:, axis] += np.bincount(rows, block.positions[:, axis], len(keys))
            if block.colours is not None:
                shades[:, axis] += np.bincount(rows, block.colours[:, axis], len(keys))
        first, where = np.unique(rows, return_index=True)
        new = count[first] == 0
        for name, column in attributes.items():
            column[first[new]] = block.attributes[name][where[new]]
        count += np.bincount(rows, minlength=len(keys))
    share = 1.0 / np.maximum(count, 1.0)[:, None]
    colours = np.rint(shades * share).astype(np.uint8) if has_colours else None
    return Mesh(sums * share, corners, stream.origin, None, colours, attributes)


def _rows_of_cells(
    stream: MeshStream, edge: float, keys: IntArray
) -> Iterator[tuple[IntArray, PointCloud]]:
    """Yield vertices that lie in cells of the copy, with the rows of these."""
    for block in stream.vertices():
        cells = _cells(block.positions, stream.box[0], edge)
        rows = np.minimum(np.searchsorted(keys, cells), len(keys) - 1)
        is_there = keys[rows] == cells
        yield rows[is_there], block.take(is_there)
