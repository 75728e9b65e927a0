"""Fewer triangles for a mesh that stays manifold: quadric edge collapse."""

from __future__ import annotations

import logging
from dataclasses import replace
from math import frexp, inf

import numpy as np

from hpcapp.applications.surface import kernels
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError

log = logging.getLogger("hpcapp")

_LIMITS = 1e-200, 1e200
"""Of a squared tolerance, in squared edges."""


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
        """
        if self.faces is not None and not self.faces >= 4:
            raise UsageError(f"faces is {self.faces!r}", "give 4 or more")
        if self.tolerance is not None and not 0.0 < self.tolerance < inf:
            raise UsageError(f"tolerance is {self.tolerance!r}", "give a length greater than zero")


def simplify_mesh(mesh: Mesh, target: Target, *, keeps_border: bool = False) -> Mesh:
    """Simplify a mesh in memory.

    Parameters
    ----------
    mesh : Mesh
        Closed or open.
    keeps_border : bool
        Whether the vertices of its boundary stay where they are, and not its shape alone.

    Returns
    -------
    Mesh
        Manifold and closed where `mesh` is. Its normals, colours and attributes are those of the
        nearest vertices of `mesh`.

    Notes
    -----
    See `kernels.portable.mesh.collapse`: edges go in the order of their errors. Each distance of a
    new vertex from the planes of the faces that it stands for is below `Target.tolerance`.
    """
    target.check()
    if not target.is_something or len(mesh.faces) <= (target.faces or 0):
        return mesh
    vertices, faces, _ = simplify_faces(
        mesh.vertices, mesh.faces, target, keeps_border=keeps_border
    )
    return carry_nearest(Mesh(vertices, faces, mesh.origin), mesh)


def carry_nearest(light: Mesh, mesh: Mesh) -> Mesh:
    """Return a mesh with what the nearest vertices of another one carry.

    Parameters
    ----------
    light : Mesh
        In the frame of `mesh`.
    mesh : Mesh
    """
    if mesh.normals is None and mesh.colours is None and not mesh.attributes:
        return light
    from scipy.spatial import cKDTree  # scipy takes its time

    _, nearest = cKDTree(mesh.vertices).query(light.vertices)
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
    vertices: FloatArray, faces: IntArray, target: Target, *, keeps_border: bool
) -> tuple[FloatArray, IntArray, IntArray]:
    """Simplify a mesh, or a part of one whose border stays as it is.

    Parameters
    ----------
    vertices : ndarray of float64, shape (v, 3)
    faces : ndarray of int64, shape (f, 3)

    Returns
    -------
    vertices : ndarray of float64, shape (w, 3)
    faces : ndarray of int64, shape (g, 3)
    names : ndarray of int64, shape (w,)
        Which vertex of the input each is, where it stayed as it was; else -1.
    """
    scale = _find_scale(vertices, faces)
    limit = inf
    if target.tolerance is not None:
        steps = target.tolerance / scale
        limit = min(max(steps * steps, _LIMITS[0]), _LIMITS[1])
    moved, corners, sources, dropped = kernels.collapse_edges(
        vertices / scale, faces, target.faces or 4, limit, keeps_border
    )
    if dropped:
        log.info("dropped %d closed piece(s) that were down to 4 faces", dropped)
    moved *= scale
    stayed = (moved == vertices[sources]).all(axis=1)
    return moved, corners, np.where(stayed, sources, -1)


def _find_scale(vertices: FloatArray, faces: IntArray) -> float:
    """Return the power of two at the mean length of an edge: division by it is exact."""
    with np.errstate(over="ignore", invalid="ignore"):
        squares = ((vertices[faces[:, 0]] - vertices[faces[:, 1]]) ** 2).sum(axis=1)
    squares = squares[np.isfinite(squares)]
    return float(2.0 ** (frexp(float(np.sqrt(squares.mean())))[1] - 1)) if len(squares) else 1.0
