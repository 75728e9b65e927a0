"""Vectors across the triangles of a mesh."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import FloatArray


def cross_edges(corners: FloatArray) -> FloatArray:
    """Return the vectors (f, 3) across triangles, corners (f, 3, 3), by the right-hand rule.

    Each is twice as long as the area of its triangle is large.
    """
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
