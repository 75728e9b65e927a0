"""The connected pieces of a mesh in memory."""

from __future__ import annotations

import numpy as np

from hpcapp import kernels
from hpcapp.geometry.faces import cross_edges
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.pieces import round_areas
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.io.meshes.mesh_stream import find_vertices, make_mesh


def measure_pieces(mesh: Mesh) -> tuple[IntArray, FloatArray]:
    """Return the piece of each face, (f,), of which there is one at least, and the areas (p,).

    Pieces are numbered in the order of their first vertices; faces that share a vertex are one.
    Areas are in squared units of the mesh, rounded as those of `StitchingPlan.pieces`.
    """
    labels = kernels.label_components(mesh.faces, len(mesh.vertices))[1]
    _, pieces = np.unique(labels[mesh.faces[:, 0]], return_inverse=True)
    sizes = 0.5 * np.linalg.norm(cross_edges(mesh.vertices[mesh.faces]), axis=1)
    return pieces, round_areas(np.bincount(pieces, sizes).astype(np.float64))


def keep_faces(mesh: Mesh, stays: BoolArray) -> Mesh:
    """Return the faces of a mesh that stay, and the vertices that these have."""
    if stays.all():
        return mesh
    used, corners = np.unique(mesh.faces[stays], return_inverse=True)
    return make_mesh(find_vertices(mesh).take(used), corners.reshape(-1, 3), mesh.origin)
