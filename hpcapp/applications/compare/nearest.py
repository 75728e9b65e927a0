"""The distance from points to the triangles of a mesh, in float64, with numpy and scipy alone."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from hpcapp.geometry.faces import unit_normals
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray

_CHUNK_ROWS = 300_000  # of point-triangle pairs: about 100 MB
ROUNDING = 1e-12
"""Of a squared distance; from afar, no two places of a mesh differ by more."""


class NearestFace:
    """An index over the faces of a mesh, of which there is at least one.

    Notes
    -----
    A place in a triangle with sides of at most e is at a distance d from a point with
    d^2 >= v^2 - e^2 / 3, where v is the distance to the nearest corner: by Lagrange's identity, as
    barycentric coordinates have sum(w_i w_j) <= 1/3. So only faces with a corner within
    sqrt(d^2 + e^2 / 3) can be nearer than d: from far away hardly more than one. Faces of other
    sizes have trees of their own, so that a few large ones widen no search among the small.
    """

    def __init__(self, mesh: Mesh) -> None:
        triangles = mesh.vertices[mesh.faces]
        sides = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(axis=1)
        sizes = _class_sizes(sides)
        self._classes = [
            _SizeClass(mesh, np.flatnonzero(sizes == size), float(sides[sizes == size].max()))
            for size in np.unique(sizes)
        ]

    def query(self, points: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return distances (n,) from points (n, 3) to the nearest face, and its numbers (n,)."""
        distances = np.full(len(points), np.inf)
        faces = np.zeros(len(points), dtype=np.int64)
        for size in self._classes:
            size.improve(points, distances, faces)
        return distances, faces


class _SizeClass:
    """Faces of about one size, and a tree of their corners."""

    def __init__(self, mesh: Mesh, faces: IntArray, longest: float) -> None:
        self._triangles, self._faces = mesh.vertices[mesh.faces[faces]], faces
        self._margin = longest**2 / 3.0
        vertices, corners = np.unique(mesh.faces[faces], return_inverse=True)
        self._tree = KDTree(mesh.vertices[vertices])
        # the faces around vertex v: _around[_starts[v]:_starts[v + 1]]
        self._around = np.argsort(corners.ravel(), kind="stable") // 3
        self._starts = np.r_[0, np.cumsum(np.bincount(corners.ravel()))]

    def improve(self, points: FloatArray, distances: FloatArray, faces: IntArray) -> None:
        """Lower the distances of points where one of these faces is nearer."""
        every = np.arange(len(points))
        for rows in np.array_split(every, 1 + 8 * len(every) // _CHUNK_ROWS):
            nearest = self._tree.query(points[rows], eps=ROUNDING)[1]
            self._try(points, rows, nearest, distances, faces)
        # from afar, the nearest corner is as near as any face
        open_rows = np.flatnonzero(self._margin > ROUNDING * distances**2)
        reach = np.sqrt(distances[open_rows] ** 2 + self._margin) * (1.0 + ROUNDING)
        counts = self._tree.query_ball_point(points[open_rows], reach, return_length=True)
        batches = np.cumsum(8 * counts) // _CHUNK_ROWS
        for part in np.split(np.arange(len(open_rows)), np.flatnonzero(np.diff(batches)) + 1):
            rows = open_rows[part]
            near = self._tree.query_ball_point(points[rows], reach[part], return_sorted=False)
            vertices = np.array([v for some in near for v in some], dtype=np.int64)
            self._try(points, np.repeat(rows, counts[part]), vertices, distances, faces)

    def _try(
        self,
        points: FloatArray,
        rows: IntArray,
        vertices: IntArray,
        distances: FloatArray,
        faces: IntArray,
    ) -> None:
        """Measure points, in ascending rows, against the faces around a vertex of each."""
        counts = self._starts[vertices + 1] - self._starts[vertices]
        # (p,): pairs of a point and a face, each once
        first = np.repeat(self._starts[vertices] - (np.cumsum(counts) - counts), counts)
        face = self._around[first + np.arange(counts.sum())]
        keys = np.unique(np.repeat(rows, counts) * len(self._faces) + face)
        row, face = np.divmod(keys, len(self._faces))
        pairs = distance_to_triangles(points[row], self._triangles[face])
        # the nearest of each row comes first; (r,): where it stands
        order = np.lexsort((pairs, row))
        best = order[np.unique(row[order], return_index=True)[1]]
        best = best[pairs[best] < distances[row[best]]]
        distances[row[best]], faces[row[best]] = pairs[best], self._faces[face[best]]


def face_normals(mesh: Mesh) -> FloatArray:
    """Return the unit normal of every face, shape (f, 3); zero for a face without area."""
    return unit_normals(mesh.vertices[mesh.faces])


def _class_sizes(sides: FloatArray) -> IntArray:
    """Return a number for each length: 0 up to twice the median, and one more for each four times.

    Most meshes have one class, and none has more than there are powers of 4 in a float.
    """
    usual = 2.0 * float(np.median(sides)) or 1.0
    classes: IntArray = np.ceil(np.log2(np.maximum(sides / usual, 1.0)) / 2.0).astype(np.int64)
    return classes


def distance_to_triangles(points: FloatArray, triangles: FloatArray) -> FloatArray:
    """Return the distance from each point to its own triangle.

    The foot is either inside the triangle or on one of its three sides.
    """
    # (3, m, 3): corner by corner; (m,): whether the foot can be inside: not without area
    corners = triangles.transpose(1, 0, 2)
    normal = unit_normals(triangles)
    inside = np.einsum("ij,ij->i", normal, normal) > 0.5
    nearest = np.full(len(triangles), np.inf)
    for k in range(3):
        # (m, 3): side k and the point about its start; inside is left of all three sides
        start, along = corners[k], corners[(k + 1) % 3] - corners[k]
        offset = points - start
        inside &= np.einsum("ij,ij->i", np.cross(along, offset), normal) >= 0.0
        length = np.einsum("ij,ij->i", along, along)
        # (m,): where on the side the foot is, 0 to 1; (m, 3): from there to the point
        part = np.einsum("ij,ij->i", offset, along) / np.where(length > 0.0, length, 1.0)
        away = offset - np.clip(part, 0.0, 1.0)[:, None] * along
        nearest = np.minimum(nearest, np.einsum("ij,ij->i", away, away))
    # (m,): the distance to the plane, which counts where the foot is inside
    height = np.abs(np.einsum("ij,ij->i", points - corners[0], normal))
    distance: FloatArray = np.where(inside, height, np.sqrt(nearest))
    return distance
