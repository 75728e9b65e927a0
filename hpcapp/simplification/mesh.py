"""Fewer triangles for a mesh that stays manifold: quadric edge collapse by the library pyfqmr.

::

    mesh ──> collapse ──> is it still manifold? ──> mesh
               ^                     │ no
               └─ all but the places that broke

The library knows nothing of topology: a collapse may leave an edge with four faces. Where it did,
the faces around the place are set aside as they were, with their rim fixed, and the rest is
simplified again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import frexp, inf
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface import kernels
from hpcapp.applications.surface.types.mesh import Mesh
from hpcapp.applications.surface.types.points import FloatArray, IntArray
from hpcapp.extras import how_to_install
from hpccomponent.errors import MissingLibraryError, UsageError

__all__ = ["Target", "simplify_faces", "simplify_mesh", "unite_vertices"]

_PASSES, _GROWTH, _OFFSET, _FIRST = 100, 7, 3, 1e-9
"""The library's thresholds, of squared edges: first * (pass + offset)^growth, its own defaults."""
_TOLERANCE_PASSES = 40
"""Up to the threshold that a tolerance stands for."""
_LIBRARY = Lock()  # it has one mesh for the whole process


@dataclass(frozen=True, slots=True)
class Target:
    """When to stop: at whichever comes first.

    Parameters
    ----------
    faces : int or None
        No fewer faces than that, but for one.
    tolerance : float or None
        How far the surface may move, in length units of the mesh.
    """

    faces: int | None = None
    tolerance: float | None = None

    @property
    def is_something(self) -> bool:
        """Whether anything is asked for."""
        return self.faces is not None or self.tolerance is not None

    def check(self) -> None:
        """Find out before the work whether it can be done.

        Raises
        ------
        UsageError
            A number is out of its range.
        MissingLibraryError
            pyfqmr is not installed.
        """
        if self.faces is not None and not self.faces >= 4:
            raise UsageError(f"faces is {self.faces!r}", "give 4 or more")
        if self.tolerance is not None and not 0.0 < self.tolerance < inf:
            raise UsageError(f"tolerance is {self.tolerance!r}", "give a length greater than zero")
        if self.is_something:
            try:
                import pyfqmr  # noqa: F401
            except ImportError:
                raise MissingLibraryError(
                    "fewer faces need pyfqmr", how_to_install("light")
                ) from None


def simplify_mesh(mesh: Mesh, target: Target) -> Mesh:
    """Simplify a mesh in memory.

    Parameters
    ----------
    mesh : Mesh
        Closed, or open: the vertices of its boundary stay where they are.

    Returns
    -------
    Mesh
        Manifold and closed where `mesh` is. Its normals, colours and attributes are those of the
        nearest vertices of `mesh`.

    Notes
    -----
    Edges go in the order of their errors, in passes with growing thresholds; a new vertex lies
    where the sum of the squared distances from the planes of the faces that it stands for is
    least [1]_. Each of these distances is below `Target.tolerance`.

    References
    ----------
    .. [1] M. Garland, P. S. Heckbert, Surface simplification using quadric error metrics,
       SIGGRAPH 1997, https://doi.org/10.1145/258734.258849
    """
    target.check()
    if not target.is_something or len(mesh.faces) <= (target.faces or 0):
        return mesh
    vertices, faces, _ = simplify_faces(mesh.vertices, mesh.faces, target)
    light = Mesh(vertices, faces, mesh.origin)
    if mesh.normals is None and mesh.colours is None and not mesh.attributes:
        return light
    from scipy.spatial import cKDTree  # scipy takes its time

    _, nearest = cKDTree(mesh.vertices).query(vertices)
    return replace(
        light,
        normals=None if mesh.normals is None else mesh.normals[nearest],
        colours=None if mesh.colours is None else mesh.colours[nearest],
        attributes={name: column[nearest] for name, column in mesh.attributes.items()},
    )


def unite_vertices(
    vertices: FloatArray, faces: IntArray, names: IntArray
) -> tuple[FloatArray, IntArray, IntArray]:
    """Make one of the vertices that have one name, and leave out those that no face uses.

    Parameters
    ----------
    vertices : ndarray of float64, shape (v, 3)
    faces : ndarray of int64, shape (f, 3)
    names : ndarray of int64, shape (v,)
        Those of vertices that have none are -1.

    Returns
    -------
    vertices, faces, names
        Of the same kind.
    """
    named = np.flatnonzero(names >= 0)
    _, first, which = np.unique(names[named], return_index=True, return_inverse=True)
    same = np.arange(len(vertices))
    same[named] = named[first][which]
    used, rows = np.unique(same[faces], return_inverse=True)
    return vertices[used], rows.reshape(-1, 3).astype(np.int64), names[used]


def simplify_faces(
    vertices: FloatArray, faces: IntArray, target: Target
) -> tuple[FloatArray, IntArray, IntArray]:
    """Simplify a part of a mesh, whose rim stays as it is.

    Parameters
    ----------
    vertices : ndarray of float64, shape (v, 3)
    faces : ndarray of int64, shape (f, 3)

    Returns
    -------
    vertices : ndarray of float64, shape (w, 3)
    faces : ndarray of int64, shape (g, 3)
    names : ndarray of int64, shape (w,)
        Which vertex of the input each is, where it stayed as it was: all of the rim; else -1.
    """
    scale = _find_scale(vertices, faces)
    is_kept = np.zeros(len(faces), np.bool_)
    radius = 4.0 * scale
    rim = _find_rim(faces)
    can_break = not len(_find_broken(faces, np.isin(np.arange(len(vertices)), rim)))
    while True:
        fixed = faces[is_kept]
        goal = max(4, (target.faces or 0) - len(fixed))
        moved, corners, names = _collapse(vertices, faces[~is_kept], target, goal, scale)
        if len(fixed):
            fixed_vertices = np.unique(fixed)
            moved, corners, names = unite_vertices(
                np.concatenate([moved, vertices[fixed_vertices]]),
                np.concatenate([corners, np.searchsorted(fixed_vertices, fixed) + len(moved)]),
                np.concatenate([names, fixed_vertices]),
            )
        broken = _find_broken(corners, np.isin(names, rim)) if can_break else corners[:0, 0]
        if not len(broken):
            return moved, corners, names
        is_kept |= _find_near(vertices, faces, moved[broken], radius)
        radius *= 2.0


def _collapse(
    vertices: FloatArray, faces: IntArray, target: Target, goal: int, scale: float
) -> tuple[FloatArray, IntArray, IntArray]:
    """Have the library collapse edges; vertices on the rim stay, and come first."""
    import pyfqmr

    if not len(faces):
        return vertices[:0], faces, np.empty(0, np.int64)
    rim = _find_rim(faces)
    order = np.concatenate([rim, np.setdiff1d(faces, rim)])
    rank = np.empty(len(vertices), np.int32)
    rank[order] = np.arange(len(order))
    passes, first = _PASSES, _FIRST
    if target.tolerance is not None:
        passes = _TOLERANCE_PASSES
        steps = target.tolerance / scale
        last = steps * steps  # infinite at worst
        first = min(first, last / (passes - 1 + _OFFSET) ** _GROWTH)
    with _LIBRARY:
        library = pyfqmr.Simplify()
        library.setMesh(vertices[order] / scale, rank[faces])
        library.simplify_mesh(
            goal if target.faces is not None else 4,
            aggressiveness=_GROWTH,
            max_iterations=passes,
            verbose=False,
            alpha=first,
            K=_OFFSET,
            preserve_border=True,
        )
        moved, corners, _ = library.getMesh()
    names = np.full(len(moved), -1, np.int64)
    names[: len(rim)] = rim
    return moved * scale, corners.astype(np.int64), names


def _find_scale(vertices: FloatArray, faces: IntArray) -> float:
    """Return the power of two at the mean length of an edge: division by it is exact."""
    sides = vertices[faces[:, 0]] - vertices[faces[:, 1]]
    return float(2.0 ** (frexp(float(np.sqrt((sides**2).sum(axis=1).mean())))[1] - 1))


def _count_edges(faces: IntArray) -> tuple[IntArray, IntArray]:
    """Return the edges of a mesh as pairs of vertices, and how many faces each has."""
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    wide = int(faces.max(initial=0)) + 1
    keys, counts = np.unique(sides[:, 0] * wide + sides[:, 1], return_counts=True)
    return np.stack(np.divmod(keys, wide), axis=1), counts


def _find_rim(faces: IntArray) -> IntArray:
    """Return the vertices on the boundary, sorted."""
    edges, counts = _count_edges(faces)
    return np.unique(edges[counts == 1])


def _find_broken(faces: IntArray, is_rim: NDArray[np.bool_]) -> IntArray:
    """Return the vertices where a mesh is no manifold, or open at other places than its rim."""
    edges, counts = _count_edges(faces)
    is_open = (counts == 1) & ~is_rim[edges].all(axis=1)
    corners = np.sort(faces, axis=1)
    _, which, copies = np.unique(corners, axis=0, return_inverse=True, return_counts=True)
    twins = faces[copies[which.reshape(-1)] > 1]  # two faces back to back
    broken = np.unique(np.concatenate([edges[(counts > 2) | is_open].ravel(), twins.ravel()]))
    return broken if len(broken) else _find_pinches(faces)


def _find_pinches(faces: IntArray) -> IntArray:
    """Return the vertices around which the faces of an edge-manifold mesh form several fans."""
    used, rows = np.unique(faces, return_inverse=True)
    if not len(used):
        return used
    rows = rows.reshape(-1, 3)
    if kernels.survey_mesh(rows, len(used)).fans == len(used):
        return used[:0]
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    # Corner 3 f + c of face f; across a shared edge the corners at each of its ends are one piece.
    corner = np.arange(rows.size).reshape(-1, 3)
    # (3 f, 2): the vertices of each side, and the corners of its face there
    ends = rows[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    at = corner[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    turned = ends[:, 0] > ends[:, 1]
    ends[turned], at[turned] = ends[turned][:, ::-1], at[turned][:, ::-1]
    # sides of the same edge side by side: their corners at either end belong together
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    ends, at = ends[order], at[order]
    pairs = np.flatnonzero((ends[1:] == ends[:-1]).all(axis=1))
    left, right = at[pairs].ravel(), at[pairs + 1].ravel()
    joined = coo_array((np.ones(len(left), np.int8), (left, right)), (rows.size, rows.size))
    _, piece = connected_components(joined, directed=False)
    # each pair of vertex and fan once: a vertex met twice is pinched
    pieces = np.unique(np.stack([rows.ravel(), piece], axis=1), axis=0)[:, 0]
    return used[np.bincount(pieces) > 1]


def _find_near(
    vertices: FloatArray, faces: IntArray, places: FloatArray, radius: float
) -> NDArray[np.bool_]:
    """Tell which faces have a vertex that is near one of some places."""
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(places).query(vertices, distance_upper_bound=radius)
    is_near: NDArray[np.bool_] = np.isfinite(distance)[faces].any(axis=1)
    return is_near
