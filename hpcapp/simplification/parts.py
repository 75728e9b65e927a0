"""Parts of a mesh, simplified so that they fit together: quadric edge collapse."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from math import frexp, inf

import numpy as np

from hpcapp import kernels
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.io.batches import join_points
from hpcapp.io.meshes.mesh_stream import find_vertices, make_mesh
from hpcapp.simplification.target import Target

log = logging.getLogger("hpcapp")

_LIMITS = 1e-200, 1e200
"""Of a squared tolerance, in squared edges."""


def collapse(mesh: Mesh, target: Target, *, keeps_border: bool) -> tuple[Mesh, IntArray]:
    """Collapse edges of a mesh; see `kernels.portable.mesh.collapse`.

    Where the vertices of its border stay, and not its shape alone, `join_parts` makes a manifold,
    closed mesh of the parts of one. It is manifold and closed where `mesh` is; its vertices carry
    what the nearest ones of `mesh` do. Return, too, which vertex of `mesh` each is, (w,), where it
    stayed; else -1.
    """
    scale = _find_scale(mesh.vertices, mesh.faces)
    limit = inf
    if target.tolerance is not None:
        steps = target.tolerance / scale
        limit = min(max(steps * steps, _LIMITS[0]), _LIMITS[1])
    scaled = mesh.vertices / scale
    vertices, faces, sources, dropped = kernels.collapse_edges(
        scaled, mesh.faces, target.faces or 4, limit, keeps_border
    )
    if dropped:
        log.info("dropped %d closed piece(s) that were down to 4 faces", dropped)
    stayed = (vertices == scaled[sources]).all(axis=1)
    vertices *= scale
    vertices[stayed] = mesh.vertices[sources[stayed]]  # the scale rounds what is next to nothing
    light = _carry_nearest(Mesh(vertices, faces, mesh.origin), mesh)
    return light, np.where(stayed, sources, -1)


def join_parts(parts: Sequence[Mesh], names: Sequence[IntArray]) -> tuple[Mesh, IntArray]:
    """Join parts of a mesh, one or more, at the vertices that have one name; -1 is none.

    Return the mesh, without vertices that no face uses, and the names of its vertices, (w,).
    """
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([p.faces + start for p, start in zip(parts, starts, strict=False)])
    every = np.concatenate(names)
    named = np.flatnonzero(every >= 0)
    _, first, which = np.unique(every[named], return_index=True, return_inverse=True)
    same = np.arange(len(every))
    same[named] = named[first][which]
    used, corners = np.unique(same[faces], return_inverse=True)
    vertices = join_points([find_vertices(part) for part in parts]).take(used)
    return make_mesh(vertices, corners.reshape(-1, 3), parts[0].origin), every[used]


def _carry_nearest(light: Mesh, mesh: Mesh) -> Mesh:
    """Return a mesh with what the nearest vertices of another one, in one frame, carry."""
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


def _find_scale(vertices: FloatArray, faces: IntArray) -> float:
    """Return the power of two at the mean length of an edge: division by it is exact."""
    with np.errstate(over="ignore", invalid="ignore"):
        squares = ((vertices[faces[:, 0]] - vertices[faces[:, 1]]) ** 2).sum(axis=1)
    squares = squares[np.isfinite(squares)]
    return float(2.0 ** (frexp(float(np.sqrt(squares.mean())))[1] - 1)) if len(squares) else 1.0
