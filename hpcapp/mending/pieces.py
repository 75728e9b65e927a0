"""The connected pieces of a mesh in memory."""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface import kernels
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.pieces import round_areas
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.io.meshes.mesh_stream import find_vertices, make_mesh


def measure_pieces(mesh: Mesh) -> tuple[IntArray, FloatArray]:
    """Return the piece of each face, and the area of each piece.

    Parameters
    ----------
    mesh : Mesh
        With a face.

    Returns
    -------
    pieces : ndarray of int64, shape (f,)
        Numbered in the order of their first vertices. Faces that share a vertex are one piece.
    areas : ndarray of float64, shape (p,)
        In squared length units of the mesh, rounded as those of `StitchingPlan.pieces`.
    """
    labels = kernels.label_components(mesh.faces, len(mesh.vertices))[1]
    _, pieces = np.unique(labels[mesh.faces[:, 0]], return_inverse=True)
    a, b, c = (mesh.vertices[column] for column in mesh.faces.T)
    sizes = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return pieces, round_areas(np.bincount(pieces, sizes).astype(np.float64))


def keep_faces(mesh: Mesh, stays: BoolArray) -> Mesh:
    """Return some of the faces of a mesh, and the vertices that these have.

    Parameters
    ----------
    mesh : Mesh
    stays : ndarray of bool, shape (f,)
    """
    if stays.all():
        return mesh
    used, corners = np.unique(mesh.faces[stays], return_inverse=True)
    return make_mesh(find_vertices(mesh).take(used), corners.reshape(-1, 3), mesh.origin)
