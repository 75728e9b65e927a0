"""Meshes that tests cut, and what is measured of them."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import FloatArray, IntArray


def make_sphere() -> tuple[FloatArray, IntArray]:
    """Return an octahedron whose faces are halved five times, on the unit sphere.

    Some corners are on the axes.
    """
    vertices = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    faces = np.array(
        [[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]]
    )
    for _ in range(5):
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        distinct, which = np.unique(edges, axis=0, return_inverse=True)
        ab, bc, ca = (len(vertices) + which.reshape(-1, 3)).T
        vertices = np.concatenate([vertices, vertices[distinct].mean(axis=1)])
        vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
        a, b, c = faces.T
        rows = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = np.concatenate([np.stack(row, axis=1) for row in rows])
    return vertices, faces


def find_areas(vertices: FloatArray, faces: IntArray) -> FloatArray:
    """Return the area of each face."""
    a, b, c = (vertices[column] for column in faces.T)
    areas: FloatArray = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    return areas


def area(vertices: FloatArray, faces: IntArray) -> float:
    """Return the area of a mesh."""
    return float(find_areas(vertices, faces).sum())


def sample(vertices: FloatArray, faces: IntArray, count: int) -> FloatArray:
    """Return places on a mesh, evenly."""
    areas = find_areas(vertices, faces)
    random = np.random.default_rng(0)
    chosen = random.choice(len(faces), count, p=areas / areas.sum())
    shares = random.dirichlet((1, 1, 1), size=count)
    places: FloatArray = np.einsum("nk,nkd->nd", shares, vertices[faces[chosen]])
    return places
