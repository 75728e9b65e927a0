"""A patch that goes on as the surface around its hole bends.

Its vertices lie where the integral of the squared curvature is least, as of a thin plate that is
clamped to the surface (Botsch and Kobbelt 2004, https://doi.org/10.1145/1015706.1015772).
"""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.faces import cross_edges
from hpcapp.geometry.points import FloatArray, IntArray

_WEIGHTS = 0.01, 4.0
"""Cotangents of flat triangles, and of needles, are beyond: there the plate would tear."""
_LEAST_AREA = 0.3  # of the usual one around a vertex; likewise


def bend(places: FloatArray, faces: IntArray, border: int, end: int) -> FloatArray:
    """Return the places of all vertices, with those of a patch where it is bent the least.

    Places (m, 3) are the loop, the vertices within from `border` on, and from `end` on those of the
    mesh around the loop. Faces (f, 3) are the patch's, and the mesh's with a vertex of the loop.
    """
    from scipy.sparse import csr_matrix  # scipy takes its time
    from scipy.sparse.linalg import splu

    rows, columns, weights, areas = _weigh(places, faces)
    count = len(places)
    off = csr_matrix((weights, (rows, columns)), shape=(count, count))
    degrees = np.asarray(off.sum(axis=1)).reshape(-1)
    # (end, m): by how much each vertex is off the mean of those around it, for its area.
    bending = _diagonal(1.0 / np.sqrt(areas[:end])) @ (off - _diagonal(degrees))[:end]
    inner = np.zeros(count, np.bool_)
    inner[border:end] = True
    free, fixed = bending[:, inner], bending[:, ~inner]
    bent = places.copy()
    known = np.asarray(free.T @ (fixed @ places[~inner]))
    bent[inner] = splu((free.T @ free).tocsc()).solve(-known)
    return bent


def _diagonal(values: FloatArray) -> object:
    from scipy.sparse import diags

    return diags(values).tocsr()


def _weigh(
    places: FloatArray, faces: IntArray
) -> tuple[IntArray, IntArray, FloatArray, FloatArray]:
    """Return the cotangent weight of each side both ways, and the area around each vertex."""
    corners = places[faces]
    rows: list[IntArray] = []
    columns: list[IntArray] = []
    weights: list[FloatArray] = []
    doubled = np.linalg.norm(cross_edges(corners), axis=1)
    doubled = np.maximum(doubled, 1e-12 * doubled.mean())  # not to divide by nothing
    for tip, one, other in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        first, second = (corners[:, k] - corners[:, tip] for k in (one, other))
        weight = np.clip(0.5 * np.einsum("ij,ij->i", first, second) / doubled, *_WEIGHTS)
        rows += [faces[:, one], faces[:, other]]
        columns += [faces[:, other], faces[:, one]]
        weights += [weight, weight]
    areas = np.zeros(len(places))
    np.add.at(areas, faces.reshape(-1), np.repeat(doubled / 6.0, 3))
    areas = np.maximum(areas, _LEAST_AREA * np.median(areas))
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(weights), areas
