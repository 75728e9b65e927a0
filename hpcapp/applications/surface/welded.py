"""The mesh that parts are: in memory, or brick after brick for a file.

Parts come from a callable, one at a time and more than once: they may be in memory, or arrays on
disk that are mapped.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hpcapp.applications.surface.weld import WeldPlan
from hpccomponent.surface.mesh import Mesh
from hpccomponent.surface.mesh_part import MeshPart
from hpccomponent.surface.part_places import place_faces, place_vertices
from hpccomponent.surface.points import FloatArray

__all__ = ["LoadPart", "assemble_mesh"]

LoadPart = Callable[[int], MeshPart]


def assemble_mesh(plan: WeldPlan, load: LoadPart, origin: FloatArray) -> Mesh:
    """Put the whole mesh together in memory.

    Parameters
    ----------
    plan : WeldPlan
    load : callable
        Returns the part of an index.
    origin : ndarray of float64, shape (3,)
        Of the local frame that the parts' vertices are in.

    Returns
    -------
    Mesh
    """
    vertices = np.empty((plan.vertex_count, 3))
    faces = np.empty((plan.face_count, 3), np.int64)
    for index in range(len(plan.summaries)):
        part, places = load(index), plan.places(index)
        bricks = np.flatnonzero(places.face_starts >= 0)
        found, numbers = place_vertices(part, places, bricks)
        vertices[numbers] = found
        _, found_faces, numbers = place_faces(part, places, bricks)
        faces[numbers] = found_faces
    return Mesh(vertices, faces, origin)
