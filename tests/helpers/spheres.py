"""Points of spheres, normals outwards."""

from __future__ import annotations

from directions import random_directions

from hpcapp.geometry.points import PointCloud


def make_sphere(points: int, radius: float = 1.0, seed: int = 7) -> PointCloud:
    """Return points that are drawn evenly from a sphere around the origin."""
    normals = random_directions(points, seed)
    return PointCloud(radius * normals, normals)
