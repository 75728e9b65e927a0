"""Points on the faces of a mesh, and when they stand for it better than its vertices."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.faces import cross_edges
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.io.points.no_data import sum_coordinates
from hpccomponent.errors import InputError

SAMPLED = 100_000
"""Points on the faces of a mesh whose vertices are too few."""

_NEAR = 2.0  # times the usual distance of a vertex from the next one
_BARE = 0.25
"""Share of a surface that is farther from all vertices, so that these are too few: .17 of a scan
whose base was closed (laurana of the meshes to tune with), .39 of an animal of large triangles
(``ply/Wuson.ply`` of the real files), .5 to 1 of parts from CAD."""
_FEWEST = 200  # vertices of a scan, however even: cubes have 8 to 24, the least scan at hand 5,210
_LOOKED_AT = 10_000  # places on the faces, and vertices


def are_vertices_few(mesh: Mesh) -> bool:
    """Tell whether the vertices of a mesh are too few to stand for its faces."""
    used = np.zeros(len(mesh.vertices), np.bool_)
    used[mesh.faces] = True
    vertices = mesh.vertices[used]
    vertices = vertices[np.unique(sum_coordinates(vertices), return_index=True)[1]]
    if not np.isfinite(vertices).all():
        return False
    if len(vertices) < _FEWEST:
        return True
    from scipy.spatial import cKDTree  # points need none

    tree = cKDTree(vertices, balanced_tree=False, compact_nodes=False)
    some = vertices[:: -(-len(vertices) // _LOOKED_AT)]
    spacing = float(np.median(tree.query(some, k=2)[0][:, 1]))
    places = sample_faces(mesh, _LOOKED_AT).positions
    return bool((tree.query(places)[0] > _NEAR * spacing).mean() > _BARE)


def sample_faces(mesh: Mesh, points: int, seed: int = 0) -> PointCloud:
    """Sample points evenly on the faces of a mesh, with the faces' normals.

    They are in its frame, less its origin; the same mesh, number and seed give the same points.
    Raise InputError where the mesh has no area.
    """
    corners = mesh.vertices[mesh.faces]
    normals = cross_edges(corners)
    doubled = np.linalg.norm(normals, axis=1)
    ends = np.cumsum(doubled)
    if not len(ends) or not ends[-1] > 0:
        raise InputError("the mesh has no area to sample", "check that the right file was exported")
    random = np.random.default_rng(seed)
    # One point in each of as many equal shares of the area: more even than independent ones.
    places = (np.arange(points) + random.random(points)) / points * ends[-1]
    face = np.minimum(np.searchsorted(ends, places, side="right"), len(ends) - 1)
    u, v = random.random((2, points, 1))
    folded = u + v > 1
    u, v = np.where(folded, 1 - u, u), np.where(folded, 1 - v, v)
    a, b, c = corners[face].transpose(1, 0, 2)
    return PointCloud(a + u * (b - a) + v * (c - a), normals[face] / doubled[face][:, None])
