"""Closed, manifold meshes of any shape, for tests of what must leave them so."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from level_sets import mesh_level_set

from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray

_CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
_CUBE_FACES = np.array([
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
])  # fmt: skip
_TIP_FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def join_meshes(*meshes: Mesh) -> Mesh:
    """Return meshes as one, each with vertices of its own."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def _repeat(places: FloatArray, faces: IntArray, at: FloatArray) -> Mesh:
    starts = len(places) * np.arange(len(at))[:, None, None]
    return Mesh((at[:, None] + places).reshape(-1, 3), (faces + starts).reshape(-1, 3))


def make_closed(seed: int, thin: bool = False) -> Mesh:
    """Blobs with handles, cubes that touch at corners, edges and sides, tiny tetrahedra, a copy."""
    random = np.random.default_rng(seed)

    def field(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        values = random.normal(size=x.shape)
        reach = np.maximum(np.maximum(abs(x), abs(y)), abs(z))
        return np.where(reach > 0.9, 1.0, values)

    cubes = np.unique(random.integers(2, 5, (int(random.integers(1, 12)), 3)), axis=0)
    tips = random.random((int(random.integers(1, 20)), 3))
    parts = [_repeat(_CUBE, _CUBE_FACES, cubes.astype(float)),
             _repeat(1e-3 * np.eye(4, 3, -1), _TIP_FACES, tips)]  # fmt: skip
    blobs = mesh_level_set(field, 1.0, 6)
    if check_mesh(blobs).watertight:
        parts += [blobs] * int(random.integers(1, 3))
    mesh = join_meshes(*parts)
    faces = mesh.faces[random.permutation(len(mesh.faces))] if random.random() < 0.5 else mesh.faces
    return Mesh(mesh.vertices * [1.0, 1.0, 1e-5 if thin else 1.0], faces)


closed_meshes = st.builds(make_closed, st.integers(0, 2**32), st.booleans())


def is_closed(mesh: Mesh) -> bool:
    """Tell whether a mesh is closed and manifold, without two faces back to back."""
    corners = np.sort(mesh.faces, axis=1)
    return check_mesh(mesh).watertight and len(np.unique(corners, axis=0)) == len(corners)
