"""A patch that goes on as the surface around its hole bends.

Its vertices lie where the integral of the squared curvature is least, as of a thin plate that is
clamped to the surface (Botsch and Kobbelt 2004, https://doi.org/10.1145/1015706.1015772).
"""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.mending.refinement import relax

_PASSES = 3  # each with the weights of the shape before it
_LEAST_WEIGHT = 1e-3  # of an edge: cotangents of flat triangles are negative


def fair(
    places: FloatArray, faces: IntArray, around: IntArray, border: int, taken: IntArray
) -> tuple[FloatArray, IntArray]:
    """Bend a patch as the surface around it bends.

    Parameters
    ----------
    places : ndarray of float64, shape (m, 3)
        The loop, then the vertices within, then those of the mesh that stand around the loop.
    faces : ndarray of int64, shape (f, 3)
        Of the patch.
    around : ndarray of int64, shape (g, 3)
        Those of the mesh that have a vertex of the loop.
    border : int
        Vertices of the loop.
    taken : ndarray of int64, shape (t, 2)
        Vertices of the loop that edges of the mesh join, the lower first.

    Returns
    -------
    places : ndarray of float64, shape (m, 3)
    faces : ndarray of int64, shape (f, 3)
    """
    end = int(faces.max()) + 1  # of the vertices within
    if end == border:
        return places, faces
    for _ in range(_PASSES):
        places = _solve(places, np.concatenate([faces, around]), border, end)
        faces = relax(places, faces, taken)
    return places, faces


def _solve(places: FloatArray, faces: IntArray, border: int, end: int) -> FloatArray:
    """Return the places with those from `border` to `end` where the plate is bent the least."""
    from scipy.sparse import csr_matrix  # scipy takes its time
    from scipy.sparse.linalg import splu

    rows, columns, weights, areas = _weigh(places, faces)
    count = len(places)
    off = csr_matrix((weights, (rows, columns)), shape=(count, count))
    degrees = np.asarray(off.sum(axis=1)).reshape(-1)
    bending = (off - _diagonal(degrees))[:end]
    bending = _diagonal(1.0 / np.sqrt(areas[:end])) @ bending
    inner = np.zeros(count, np.bool_)
    inner[border:end] = True
    free, fixed = bending[:, inner], bending[:, ~inner]
    known = -(fixed @ places[~inner])
    solved = places.copy()
    solved[inner] = splu((free.T @ free).tocsc()).solve(np.asarray(free.T @ known))
    return solved


def _diagonal(values: FloatArray) -> object:
    from scipy.sparse import diags

    return diags(values).tocsr()


def _weigh(
    places: FloatArray, faces: IntArray
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """Return the cotangent weight of each side both ways, and the area around each vertex."""
    corners = [places[column] for column in faces.T]
    rows, columns, weights = [], [], []
    doubled = np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]), axis=1)
    doubled = np.maximum(doubled, 1e-12 * doubled.mean())
    for tip, one, other in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        first, second = corners[one] - corners[tip], corners[other] - corners[tip]
        weight = np.maximum(0.5 * np.einsum("ij,ij->i", first, second) / doubled, _LEAST_WEIGHT)
        rows += [faces[:, one], faces[:, other]]
        columns += [faces[:, other], faces[:, one]]
        weights += [weight, weight]
    areas = np.bincount(faces.reshape(-1), np.repeat(doubled / 6.0, 3), len(places))
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(weights), areas
