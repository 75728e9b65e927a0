"""Faces that pass through each other: for tests of meshes that must not."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray


def count_crossings(mesh: Mesh, first: int) -> int:
    """Count the sides of faces from the first on that go through another face, and the reverse."""
    corners = mesh.vertices[mesh.faces]
    middles = corners.mean(axis=1)
    reach = np.linalg.norm(corners - middles[:, None], axis=2).max(axis=1)
    near = cKDTree(middles).query_ball_point(middles[first:], reach[first:] + reach.max())
    one = np.repeat(np.arange(first, len(middles)), [len(some) for some in near])
    other = np.concatenate(near).astype(np.int64)
    is_apart = (mesh.faces[one][:, :, None] != mesh.faces[other][:, None]).all(axis=(1, 2))
    one, other = one[is_apart], other[is_apart]
    return _count(corners, one, other) + _count(corners, other, one)


def _count(corners: FloatArray, sides_of: FloatArray, faces: FloatArray) -> int:
    """Count pairs of which a side of the one goes through the other (Moller and Trumbore 1997)."""
    a, b, c = corners[faces].transpose(1, 0, 2)
    crosses = np.zeros(len(faces), np.bool_)
    for k in range(3):
        start = corners[sides_of, k]
        along = corners[sides_of, (k + 1) % 3] - start
        normal = np.cross(b - a, c - a)
        slope = -np.einsum("ij,ij->i", along, normal)
        slope = np.where(np.abs(slope) < 1e-300, 1e-300, slope)
        arm = start - a
        turned = np.cross(arm, along)
        t = np.einsum("ij,ij->i", arm, normal) / slope
        u = np.einsum("ij,ij->i", c - a, turned) / slope
        v = -np.einsum("ij,ij->i", b - a, turned) / slope
        crosses |= (t > 0) & (t < 1) & (u > 0) & (v > 0) & (u + v < 1)
    return int(crosses.sum())
