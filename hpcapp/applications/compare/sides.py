"""On which side of a closed mesh points are.

A point outside is in front of the place of the mesh that is nearest to it. Where that is on an edge
or a corner, the normal there is the one of Baerentzen and Aanaes (doi:10.1109/TVCG.2005.49): the
sum of the normals of the faces around, by their angles.
"""

from __future__ import annotations

import numpy as np

from hpcapp.applications.compare.nearest import face_normals
from hpcapp.geometry.faces import cross_edges
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray

_ON = 1e-9  # a weight so small is none


def find_sides(mesh: Mesh, points: FloatArray, faces: IntArray) -> FloatArray:
    """Return 1 for points (n, 3) in front of their nearest faces (n,), and -1 behind them.

    The mesh is closed, its faces anticlockwise as seen from outside.
    """
    corners = mesh.vertices[mesh.faces[faces]]  # (n, 3, 3)
    weights = _weigh_foot(points, corners)
    feet = np.einsum("ij,ijk->ik", weights, corners)
    own = face_normals(mesh)
    normals = own[faces]
    is_off = weights <= _ON  # (n, 3): the corners that the foot has nothing of
    on_edge = np.flatnonzero(is_off.sum(axis=1) == 1)
    if len(on_edge):
        edges = _edge_normals(mesh, own)
        normals[on_edge] = edges[faces[on_edge], is_off[on_edge].argmax(axis=1)]
    on_corner = np.flatnonzero(is_off.sum(axis=1) == 2)
    if len(on_corner):
        vertices = mesh.faces[faces[on_corner], weights[on_corner].argmax(axis=1)]
        normals[on_corner] = _corner_normals(mesh, own)[vertices]
    return np.where(np.einsum("ij,ij->i", points - feet, normals) < 0.0, -1.0, 1.0)


def _weigh_foot(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Return the weights of the corners of triangles, at the place nearest to a point of each."""
    normals = cross_edges(corners)
    area = np.einsum("ij,ij->i", normals, normals)
    # (n, 3): how much of the triangle lies beyond the foot, seen from each corner
    parts = []
    for k in range(3):
        start, end = corners[:, (k + 1) % 3], corners[:, (k + 2) % 3]
        parts.append(np.einsum("ij,ij->i", np.cross(end - start, points - start), normals))
    weights = np.stack(parts, axis=1) / np.where(area > 0.0, area, 1.0)[:, None]
    outside = (weights < 0.0).any(axis=1) | (area == 0.0)
    least = np.where(outside, np.inf, 0.0)
    for k in range(3):
        start, along = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        length = np.einsum("ij,ij->i", along, along)
        share = np.einsum("ij,ij->i", points - start, along) / np.where(length > 0.0, length, 1.0)
        share = np.clip(share, 0.0, 1.0)
        away = points - start - share[:, None] * along
        squares = np.einsum("ij,ij->i", away, away)
        rows = np.flatnonzero(outside & (squares < least))
        least[rows] = squares[rows]
        weights[rows] = 0.0
        weights[rows, k], weights[rows, (k + 1) % 3] = 1.0 - share[rows], share[rows]
    return weights


def _edge_normals(mesh: Mesh, normals: FloatArray) -> FloatArray:
    """Return the sums of the normals at the edge opposite to each corner, shape (f, 3, 3)."""
    ends = np.stack([np.roll(mesh.faces, -1, axis=1), np.roll(mesh.faces, -2, axis=1)], axis=2)
    ends = np.sort(ends.reshape(-1, 2), axis=1)
    _, edge = np.unique(ends[:, 0] * len(mesh.vertices) + ends[:, 1], return_inverse=True)
    edge = edge.ravel()
    each = np.repeat(normals, 3, axis=0)
    sums: FloatArray = np.stack([np.bincount(edge, column) for column in each.T], axis=1)
    return sums[edge].reshape(-1, 3, 3)


def _corner_normals(mesh: Mesh, normals: FloatArray) -> FloatArray:
    """Return the sums of the normals of the faces around each vertex, by their angles there."""
    corners = mesh.vertices[mesh.faces]
    sums = np.zeros((len(mesh.vertices), 3))
    for k in range(3):
        first, second = (corners[:, (k + turn) % 3] - corners[:, k] for turn in (1, 2))
        lengths = np.linalg.norm(first, axis=1) * np.linalg.norm(second, axis=1)
        cosine = np.einsum("ij,ij->i", first, second) / np.where(lengths > 0.0, lengths, 1.0)
        angles = np.arccos(np.clip(cosine, -1.0, 1.0))
        for axis in range(3):
            sums[:, axis] += np.bincount(
                mesh.faces[:, k], angles * normals[:, axis], len(mesh.vertices)
            )
    return sums
