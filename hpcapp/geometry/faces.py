"""Vectors across the triangles of a mesh."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import FloatArray


def cross_edges(corners: FloatArray) -> FloatArray:
    """Return the vectors (f, 3) across triangles, corners (f, 3, 3), by the right-hand rule.

    Each is twice as long as the area of its triangle is large.
    """
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def unit_normals(corners: FloatArray) -> FloatArray:
    """Return the unit normals (f, 3) of triangles (f, 3, 3); zero for those without area."""
    normals = cross_edges(corners)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    units: FloatArray = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
    return units
