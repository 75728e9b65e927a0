"""Points of spheres, normals outwards."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import PointCloud


def make_sphere(points: int, radius: float = 1.0, seed: int = 7) -> PointCloud:
    """Return points that are drawn evenly from a sphere around the origin."""
    normals = np.random.default_rng(seed).normal(size=(points, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return PointCloud(radius * normals, normals)
