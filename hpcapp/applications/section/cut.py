"""Where planes cut a mesh: exact, joined by the edges of its faces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hpcapp.applications.section.planes import Cut, Plane
from hpcapp.applications.section.sections import Outline, Section
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpccomponent.dataclass import dataclass

_SAME = 1e-10  # of the extent of a mesh: places nearer than that are one


@dataclass(frozen=True, slots=True, eq=False)
class _Pieces:
    """Straight pieces of outlines, one a face.

    Parameters
    ----------
    places : ndarray of float64, shape (m, 2, 3)
        Their ends, in the frame of the mesh; what is solid lies to the left in the drawing.
    flat : ndarray of float64, shape (m, 2, 2)
        The same in the drawing.
    keys : ndarray of int64, shape (m, 2)
        Equal where two pieces meet; on the border of a strip less than zero, by its corner.
    """

    places: FloatArray
    flat: FloatArray
    keys: IntArray


def cut_mesh(mesh: Mesh, cut: Cut) -> Section:
    """Return the outlines of one section, in the coordinates of the input.

    They are closed where the mesh is. A vertex in a plane counts as before it, so that a face in it
    has the outline of what lies behind.
    """
    size = float(np.ptp(mesh.vertices, axis=0).max())
    parts = [_cut_faces(mesh, plane, k) for k, plane in enumerate(cut.planes)]
    keys = np.concatenate([part.keys for part in parts]).ravel()
    places = np.concatenate([part.places for part in parts]).reshape(-1, 3)
    flat = np.concatenate([part.flat for part in parts]).reshape(-1, 2)
    _tell_ends(keys, flat[:, 1], _SAME * size)
    _, first, number = np.unique(keys, return_index=True, return_inverse=True)
    outlines = []
    for chain in _join(number.reshape(-1, 2)):
        rows = first[chain]
        moved = np.linalg.norm(np.diff(places[rows], axis=0), axis=1) > _SAME * size
        rows = rows[np.append(True, moved)]
        if len(rows) > 1:
            # what is dropped may be the end, which is where the start of a closed one is
            is_closed = chain[0] == chain[-1]
            rows[-1] = rows[0] if is_closed else rows[-1]
            outlines.append(Outline(places[rows] + mesh.origin, flat[rows], bool(is_closed)))
    return Section(cut.name, cut.station, cut.line, tuple(outlines))


def _cut_faces(mesh: Mesh, plane: Plane, number: int) -> _Pieces:
    """Return what a plane cuts of the faces; the number tells its keys from those of others."""
    place, axes = plane.place - mesh.origin, plane.axes
    ahead = np.einsum("ij,j->i", mesh.vertices - place, plane.towards)
    is_front: BoolArray = ahead > 0.0
    sides = is_front[mesh.faces]
    count = np.count_nonzero(sides, axis=1)
    face = np.flatnonzero((count == 1) | (count == 2))
    corners, sides = mesh.faces[face], sides[face]
    # the corner that is alone on its side, and the two others in turn
    is_lone = sides == (count[face] == 1)[:, None]
    lone = is_lone.argmax(axis=1)
    rows = np.arange(len(face))
    alone, after, before = (corners[rows, (lone + k) % 3] for k in range(3))
    edges = np.stack([np.stack([alone, after], 1), np.stack([alone, before], 1)], axis=1)
    # front to the right of the way along the surface, whose faces look out
    edges = np.where((count[face] == 1)[:, None, None], edges[:, ::-1], edges)
    edges = np.sort(edges, axis=2)
    start, end = mesh.vertices[edges[..., 0]], mesh.vertices[edges[..., 1]]
    share = ahead[edges[..., 0]] / (ahead[edges[..., 0]] - ahead[edges[..., 1]])
    places = start + share[..., None] * (end - start)
    flat = np.einsum("mej,kj->mek", places - place, axes)
    # each edge has one place: both of its faces name it alike
    edge = edges[..., 0] * len(mesh.vertices) + edges[..., 1]
    keys = np.unique(edge, return_inverse=True)[1].reshape(-1, 2).astype(np.int64)
    keys += number * (3 * len(mesh.faces) + 1)
    return _clip(_Pieces(places, flat, keys), plane)


def _clip(pieces: _Pieces, plane: Plane) -> _Pieces:
    """Return what lies in the strip, where the plane has its place in the drawing."""
    places, flat, keys = pieces.places, pieces.flat, pieces.keys
    for side, (border, corner) in enumerate(zip(plane.span, plane.ends, strict=True)):
        beyond = (border - flat[..., 0]) * (1.0 if side == 0 else -1.0)
        kept = (beyond <= 0.0).any(axis=1)
        places, flat, keys, beyond = places[kept], flat[kept], keys[kept], beyond[kept]
        for end in (0, 1):
            out = np.flatnonzero(beyond[:, end] > 0.0)
            share = (beyond[out, end] / (beyond[out, end] - beyond[out, 1 - end]))[:, None]
            places[out, end] += share * (places[out, 1 - end] - places[out, end])
            flat[out, end] += share * (flat[out, 1 - end] - flat[out, end])
            keys[out, end] = -1 - corner
    return _Pieces(places, flat + np.array(plane.start), keys)


def _tell_ends(keys: IntArray, heights: FloatArray, same: float) -> None:
    """Give ends on borders of strips their keys: one where corner and height are the same."""
    ends = np.flatnonzero(keys < 0)
    ends = ends[np.lexsort((heights[ends], keys[ends]))]
    is_new = (np.diff(keys[ends]) != 0) | (np.diff(heights[ends]) > same)
    keys[ends] = -1 - np.cumsum(np.append(0, is_new))[: len(ends)]


def _join(pieces: IntArray) -> list[IntArray]:
    """Return chains of the ends of pieces (m, 2); one that is closed ends where it starts.

    A chain ends where another number of pieces meets than two: at a border, or where sheets meet.
    """
    rows: Sequence[list[int]] = pieces[pieces[:, 0] != pieces[:, 1]].tolist()
    touching: list[list[int]] = [[] for _ in range(int(pieces.max(initial=-1)) + 1)]
    for row, ends in enumerate(rows):
        for end in ends:
            touching[end].append(row)
    is_free = [True] * len(rows)

    def follow(row: int, at: int) -> IntArray:
        chain = [at]
        while is_free[row]:
            is_free[row] = False
            at = sum(rows[row]) - at
            chain.append(at)
            if len(touching[at]) == 2:
                row = sum(touching[at]) - row
        return np.array(chain)

    chains = []
    # those that begin at a border come first, in their own way; the others have no end
    for end, is_any in ((0, False), (1, False), (0, True)):
        for row, ends in enumerate(rows):
            if is_free[row] and (is_any or len(touching[ends[end]]) != 2):
                chains.append(follow(row, ends[end]))
    return chains
