"""The distance from points to the triangles of a mesh, in float64, with numpy and scipy alone."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from hpcapp.applications.surface.types.mesh import Mesh
from hpcapp.applications.surface.types.points import FloatArray, IntArray

__all__ = ["NearestFace", "face_normals"]

_FIRST_CANDIDATES = 8
_MOST_CANDIDATES = 512
_CHUNK_ROWS = 1_000_000  # of point-triangle pairs: about 300 MB


class NearestFace:
    """An index over the faces of a mesh.

    Parameters
    ----------
    mesh : Mesh
        With at least one face.

    Notes
    -----
    A k-d tree over the faces' middles proposes candidates. Faces much larger than the median
    are cut up, so that a bound on their radius holds: once the k-th middle is farther away than
    the best distance and that radius together, no other face can be nearer. For points far from
    the mesh, which 512 candidates do not settle, all middles within that reach are tried.
    """

    def __init__(self, mesh: Mesh) -> None:
        self._triangles, self._face, self._radius = _cut_large(mesh.vertices[mesh.faces])
        self._tree = KDTree(self._triangles.mean(axis=1))

    def query(self, points: FloatArray) -> tuple[FloatArray, IntArray]:
        """Return the distance to the nearest face and that face's number.

        Parameters
        ----------
        points : ndarray of float64, shape (n, 3)

        Returns
        -------
        distances : ndarray of float64, shape (n,)
        faces : ndarray of int64, shape (n,)
        """
        # (n,): the best so far; `open_rows` are those that another face might still beat
        distances = np.full(len(points), np.inf)
        faces = np.zeros(len(points), dtype=np.int64)
        open_rows = np.arange(len(points))
        k = min(_FIRST_CANDIDATES, len(self._triangles))
        while len(open_rows):
            settled = np.empty(len(open_rows), dtype=bool)
            step = max(1, _CHUNK_ROWS // k)
            for start in range(0, len(open_rows), step):
                rows = open_rows[start : start + step]
                # (rows,): the best of k pieces, which it is, and how far the k-th middle is
                best, piece, farthest = self._try(points[rows], k)
                distances[rows], faces[rows] = best, self._face[piece]
                settled[start : start + step] = best <= farthest - self._radius
            if k == len(self._triangles):
                break
            open_rows = open_rows[~settled]
            if k == _MOST_CANDIDATES:
                self._try_all(points, open_rows, distances, faces)
                break
            k = min(4 * k, _MOST_CANDIDATES, len(self._triangles))
        return distances, faces

    def _try_all(
        self, points: FloatArray, rows: IntArray, distances: FloatArray, faces: IntArray
    ) -> None:
        """Settle some points, whose best distances so far bound the search."""
        for row in rows.tolist():
            reach = (distances[row] + self._radius) * (1.0 + 1e-9)
            pieces = np.array(self._tree.query_ball_point(points[row], reach))
            pairs = _distance_to_triangles(points[row : row + 1], self._triangles[pieces])
            best = int(pairs.argmin())
            if pairs[best] < distances[row]:
                distances[row], faces[row] = pairs[best], self._face[pieces[best]]

    def _try(self, points: FloatArray, k: int) -> tuple[FloatArray, IntArray, FloatArray]:
        """Return the best of k candidates, which it is, and how far the last middle is."""
        # (n, k): the k nearest middles of each point, and the pieces that they belong to
        away, piece = (column.reshape(len(points), k) for column in self._tree.query(points, k=k))
        pairs = _distance_to_triangles(np.repeat(points, k, axis=0), self._triangles[piece.ravel()])
        # (n, k): exact distances; (n,): which piece is nearest
        pairs = pairs.reshape(len(points), k)
        choice = pairs.argmin(axis=1)
        rows = np.arange(len(points))
        return pairs[rows, choice], piece[rows, choice], away[:, -1]


def face_normals(mesh: Mesh) -> FloatArray:
    """Return the unit normal of every face, shape (f, 3); zero for a face without area."""
    return _unit_normals(mesh.vertices[mesh.faces])


def _unit_normals(triangles: FloatArray) -> FloatArray:
    """Return the unit normals of triangles, shape (m, 3, 3)."""
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    normals: FloatArray = cross / np.where(length > 0.0, length, 1.0)
    return normals


def _cut_large(triangles: FloatArray) -> tuple[FloatArray, IntArray, float]:
    """Cut triangles in four until none is much larger than the median.

    Returns
    -------
    triangles : ndarray of float64, shape (m, 3, 3)
    face : ndarray of int64, shape (m,)
        The triangle that each one is a piece of.
    radius : float
        No piece's corner is farther from its middle.
    """
    face = np.arange(len(triangles))
    limit = 2.0 * float(np.median(_radii(triangles)))
    for _ in range(12):
        large = _radii(triangles) > limit
        if not large.any() or len(triangles) > 2_000_000:
            break
        # (l, 3) each: the corners of large triangles, and the middles of their sides
        a, b, c = triangles[large].transpose(1, 0, 2)
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        pieces = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        cut = [np.stack(piece, axis=1) for piece in pieces]
        # (m + 3 l, 3, 3): small ones, then the four pieces of each large one, corner pieces first
        triangles = np.concatenate([triangles[~large], *cut])
        face = np.concatenate([face[~large], np.tile(face[large], 4)])
    return triangles, face, float(_radii(triangles).max())


def _radii(triangles: FloatArray) -> FloatArray:
    """Return how far each triangle's farthest corner is from its middle."""
    # (m, 3, 3): corners about their middle; (m,): the longest of the three
    offset = triangles - triangles.mean(axis=1, keepdims=True)
    radii: FloatArray = np.sqrt(np.einsum("ijk,ijk->ij", offset, offset).max(axis=1))
    return radii


def _distance_to_triangles(points: FloatArray, triangles: FloatArray) -> FloatArray:
    """Return the distance from each point to its own triangle; one point serves all.

    Notes
    -----
    The foot is either inside the triangle or on one of its three sides.
    """
    # (3, m, 3): corner by corner; (m,): whether the foot can be inside: not without area
    corners = triangles.transpose(1, 0, 2)
    normal = _unit_normals(triangles)
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
