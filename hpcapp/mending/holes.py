"""The holes of a mesh, filled as the surface around each bends.

::

    loop ── triangulate ──> least area ── refine ──> even triangles ── bend ──> patch
                                             └──────── again ──────────┘
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from hpcapp.geometry.faces import cross_edges
from hpcapp.geometry.lattice import number_keys, unique_keys
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.geometry.vertex_normals import add_face_normals, scale_normals
from hpcapp.io.meshes.mesh_stream import find_vertices, make_mesh
from hpcapp.mending.fairing import bend
from hpcapp.mending.loops import find_holes
from hpcapp.mending.refinement import refine, relax
from hpcapp.mending.triangulation import triangulate
from hpccomponent.dataclass import dataclass

_PASSES = 5  # each bends the patch by the shape that the one before has given it


@dataclass(frozen=True, slots=True, eq=False)
class Filled:
    """A mesh whose holes were filled.

    `holes` counts those that were, `left` the borders of that size that could not be.
    """

    mesh: Mesh
    holes: int
    left: int


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """What fills a hole: faces over the vertices of its loop, and new ones behind these."""

    loop: IntArray
    places: FloatArray
    faces: IntArray
    nearest: IntArray


def fill_holes(
    mesh: Mesh, size: float, advance: Callable[[int, int], object] = lambda *_: None
) -> Filled:
    """Fill the holes of a mesh up to a size, the diagonal of the box around their border.

    `advance` is told (vertices on borders that are done, in all), hole by hole.
    Old vertices and faces, at least one, stay as they are. New vertices carry what the nearest one
    on the border of their hole does, and normals of their own.
    """
    loops = find_holes(mesh, size)
    patches = [patch for patch in _fill(mesh, loops.holes, advance) if patch is not None]
    left = loops.tangled + len(loops.holes) - len(patches)
    if not patches:
        return Filled(mesh, 0, left)
    count, faces = len(mesh.vertices), [mesh.faces]
    for patch in patches:
        rows = np.concatenate([patch.loop, count + np.arange(len(patch.places))])
        faces.append(rows[patch.faces])
        count += len(patch.places)
    sources = np.concatenate([patch.nearest for patch in patches])
    every = np.concatenate([np.arange(len(mesh.vertices)), sources])
    vertices = find_vertices(mesh).take(every)
    places = np.concatenate([mesh.vertices, *(patch.places for patch in patches)])
    filled = make_mesh(replace(vertices, positions=places), np.concatenate(faces), mesh.origin)
    if filled.normals is not None:
        filled = replace(filled, normals=_add_normals(filled, len(mesh.vertices)))
    return Filled(filled, len(patches), left)


def _add_normals(mesh: Mesh, first: int) -> FloatArray:
    """Return the normals, of vertices from the first on by the faces around them."""
    assert mesh.normals is not None  # noqa: S101 - who calls has looked
    faces = mesh.faces[(mesh.faces >= first).any(axis=1)]
    sums = np.zeros((3, len(mesh.vertices)))
    add_face_normals(sums, faces, mesh.vertices[faces])
    normals = mesh.normals.astype(np.float64)
    normals[first:] = scale_normals(sums[:, first:])
    return normals


def _fill(
    mesh: Mesh, holes: list[IntArray], advance: Callable[[int, int], object]
) -> Iterator[Patch | None]:
    """Fill holes; yield None where no faces can."""
    if not holes:
        return
    count = len(mesh.vertices)
    number = np.full(count, -1, np.int64)
    for index, loop in enumerate(holes):
        number[loop] = index
    faces = mesh.faces[(number[mesh.faces] >= 0).any(axis=1)]
    tails, heads = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    edges, _ = number_keys(np.minimum(tails, heads) * count + np.maximum(tails, heads))
    ends = np.stack([edges // count, edges % count])
    # How long edges at each vertex are; those of vertices far from holes are not whole, nor used.
    lengths = np.linalg.norm(mesh.vertices[ends[0]] - mesh.vertices[ends[1]], axis=1)
    sums, counts = (
        np.bincount(ends.reshape(-1), np.tile(each, 2), count)
        for each in (lengths, np.ones(len(edges)))
    )
    sides = sums / np.maximum(counts, 1.0)
    # (p,): each hole with each face that has a vertex on its border.
    pairs = number[faces] * len(faces) + np.arange(len(faces))[:, None]
    near = unique_keys(pairs[number[faces] >= 0])
    starts = np.searchsorted(near, len(faces) * np.arange(len(holes) + 1))
    ends = np.cumsum([len(loop) for loop in holes]).tolist()
    for index, loop in enumerate(holes):
        around = faces[near[starts[index] : starts[index + 1]] % len(faces)]
        yield fill_loop(mesh.vertices, loop, around, sides[loop])
        advance(ends[index], ends[-1])


def fill_loop(
    vertices: FloatArray, loop: IntArray, around: IntArray, sides: FloatArray
) -> Patch | None:
    """Fill a hole, whose border is a loop (n,), as the faces that fill it run; None where none can.

    Around it are the faces (f, 3) of the mesh with a vertex on it; sides (n,) are the lengths of
    edges at each of its vertices.
    """
    border = len(loop)
    # Rows of all vertices that matter: those of the loop first.
    used = np.concatenate([loop, np.setdiff1d(around, loop)])
    order = np.argsort(used)
    around = order[np.searchsorted(used[order], around)]
    corners = np.sort(np.concatenate([around[:, [0, 1]], around[:, [1, 2]], around[:, [2, 0]]]), 1)
    taken = np.unique(corners[corners[:, 1] < border], axis=0)
    beside = _find_normals(vertices[used], around, border)
    faces = triangulate(vertices[loop], beside, set(map(tuple, taken.tolist())))
    if faces is None:
        return None
    places, beyond = vertices[loop], vertices[used[border:]]
    for _ in range(_PASSES):
        places, faces, sides = refine(places, faces, sides, taken)
        end = len(places)
        if end == border:
            return Patch(loop, places[border:], faces, loop[:0])
        shifted = np.where(around < border, around, around + end - border)
        every = np.concatenate([faces, shifted])
        places = bend(np.concatenate([places, beyond]), every, border, end)[:end]
    faces, inner = relax(places, faces, taken), places[border:]
    from scipy.spatial import cKDTree  # scipy takes its time

    nearest = loop[cKDTree(vertices[loop]).query(inner)[1]]
    return Patch(loop, inner, faces, nearest)


def _find_normals(places: FloatArray, around: IntArray, border: int) -> FloatArray:
    """Return the unit normal of the face at each side of a loop, from its vertex to the next."""
    normals = cross_edges(places[around])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    found = np.zeros((border, 3))
    for k in range(3):
        # The face runs through the side the other way round.
        end, start = around[:, k], around[:, (k + 1) % 3]
        is_side = (start < border) & (end < border) & (end == (start + 1) % border)
        found[start[is_side]] = normals[is_side]
    return found
