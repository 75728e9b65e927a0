"""Vertices moved off the surface, so that the faces balance around it."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.faces import cross_edges
from hpcapp.geometry.points import ByteArray, FloatArray, IntArray

__all__ = ["balance_vertices"]

_SLIVER = 0.16
"""Squared edges count as if they were longer by this share of a squared grid step."""

_ROUNDS = 4
"""Of holding folds: what a vertex gets depends on nothing farther away than seven faces."""


def balance_vertices(
    vertices: FloatArray, faces: IntArray, step: float, exponents: ByteArray | None = None
) -> FloatArray:
    """Move vertices (v, 3) off the surface that they lie on, so that the faces balance around it.

    Faces (f, 3) are anticlockwise as seen from outside; the stride of a face's brick, in steps of
    the grid, is two to the power of `exponents` (f,); by default all strides are 1. Vertices of
    faces that would turn over stay where they are.

    Notes
    -----
    A face is a chord: where the surface is convex it lies inside, and a mesh whose vertices are
    exact is too small. With p and q the ends of an edge and n the normals there, the surface
    rises over the edge by about (q - p) . (n_q - n_p) / 8, two thirds of it on average; over a
    face the mean gap is the sum over its edges of (q - p) . (n_q - n_p) / 24. Each vertex moves
    along its normal by the area-weighted mean gap of its faces, which is never more than a
    quarter of their longest edge. Normals are weighted as is exact on spheres, but for slivers,
    whose normals are nothing to go by.

    References
    ----------
    N. Max, Weights for computing vertex normals from facet normals, J. Graphics Tools 4 (1999),
    doi:10.1080/10867651.1999.10487501.
    """
    crosses = cross_edges(vertices[faces])
    steps = np.full(1, step) if exponents is None else np.ldexp(step, exponents)
    normals = _vertex_normals(vertices, faces, crosses, _SLIVER * steps * steps)
    gaps = np.zeros(len(faces))  # (f,): 24 times the mean gap of each face
    for p, q in ((0, 1), (1, 2), (2, 0)):
        tail, head = faces[:, p], faces[:, q]
        rise = (normals[head] - normals[tail]) * (vertices[head] - vertices[tail])
        gaps += rise.sum(axis=1)
    areas = np.linalg.norm(crosses, axis=1)  # (f,): twice the areas, which is as good a weight
    weights = np.maximum(_gather(faces, areas, len(vertices)), 1e-300)
    shifts = _gather(faces, areas * (gaps / 24.0), len(vertices)) / weights
    return _hold_folds(vertices, vertices + normals * shifts[:, None], faces, crosses)


def _vertex_normals(
    vertices: FloatArray, faces: IntArray, crosses: FloatArray, excess: FloatArray
) -> FloatArray:
    """Return unit normals, each face counting 1 / (product of its two squared edges there)."""
    # Edge k runs from corner k to the next: corner k has the edges k and k - 1.
    edges = [vertices[faces[:, k - 2]] - vertices[faces[:, k]] for k in range(3)]
    squares = [(edge**2).sum(axis=1) for edge in edges]
    squares = [square + np.maximum(excess, 1e-150) for square in squares]
    weights = np.stack([1.0 / (squares[k] * squares[k - 1]) for k in range(3)], axis=1)
    corners = faces.reshape(-1)
    sums = [
        np.bincount(corners, (weights * cross[:, None]).reshape(-1), len(vertices))
        for cross in crosses.T
    ]
    normals: FloatArray = np.stack(sums, axis=1, dtype=np.float64)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    return normals


def _gather(faces: IntArray, values: FloatArray, vertices: int) -> FloatArray:
    """Sum a value of the faces at each of their vertices, in the order of the faces."""
    sums = np.bincount(faces.reshape(-1), np.repeat(values, 3), vertices)
    return sums.astype(np.float64, copy=False)


def _hold_folds(
    vertices: FloatArray, moved: FloatArray, faces: IntArray, crosses: FloatArray
) -> FloatArray:
    """Put the vertices of faces that turn over back, a few times: what is held may turn others."""
    is_held = np.zeros(len(vertices), np.bool_)
    for _ in range(_ROUNDS):
        folded = (crosses * cross_edges(moved[faces])).sum(axis=1) <= 0.0
        folded &= ~is_held[faces].all(axis=1)
        if not folded.any():
            break
        is_held[faces[folded]] = True
        moved = np.where(is_held[:, None], vertices, moved)
    return moved
