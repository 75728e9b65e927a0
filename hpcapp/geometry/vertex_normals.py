"""Normals of a mesh's vertices: those of the faces around, by their areas."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import FloatArray, IntArray


def add_face_normals(sums: FloatArray, faces: IntArray, corners: FloatArray) -> None:
    """Add the normals of faces (f, 3), as long as their areas are large, to sums (3, v).

    Corners (f, 3, 3) are the places of their vertices. Face after face is added, so that blocks of
    faces of any size give the same sums.
    """
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    vertices = np.ascontiguousarray(faces).reshape(-1)
    for axis in range(3):
        y, z = (axis + 1) % 3, (axis + 2) % 3
        normals = first[:, y] * second[:, z] - first[:, z] * second[:, y]
        np.add.at(sums[axis], vertices, np.repeat(normals, 3))


def scale_normals(sums: FloatArray) -> FloatArray:
    """Return vectors (3, v) with a length of one, as (v, 3).

    They are zero where there are no faces with an area.
    """
    with np.errstate(over="ignore"):  # of vertices far beyond all: no direction
        lengths = np.sqrt(sums[0] * sums[0] + sums[1] * sums[1] + sums[2] * sums[2])
    scaled = np.divide(sums, lengths, out=np.zeros_like(sums), where=lengths > 0.0)
    return np.ascontiguousarray(scaled.T)
