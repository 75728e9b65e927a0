"""The open seams of a part of a mesh, and what its bricks hold.

A part is cut into units, and a node is a vertex as one of them sees it. A vertex is closed where
its faces stand around it in one ring: every edge at it has two sides that run in opposite
directions, and nothing more is to know of it. All others are open: their corners, joined into
pieces across edges with a closed end, and the sides between open nodes are what other parts must
be compared with.
"""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import BoolArray, FloatArray, Int32Array, IntArray
from hpcapp.kernels.portable.mesh.topology import join_nodes, label_components
from hpcapp.kernels.types.brick_mesh import BrickSums, Seams

__all__ = ["find_seams", "sum_bricks"]


def find_seams(
    faces: Int32Array, counts: tuple[int, int], vertex_of: Int32Array, is_open: BoolArray
) -> Seams:
    """Find the open vertices of a part and what lies between them.

    A corner i >= 0 of the faces (f, 3) is a node, i < 0 the foreign vertex ~i. `counts` are the
    part's own vertices and foreign ones, which are numbered after its own; v together. `vertex_of`
    (n,) is the vertex of each node; node i < v is vertex i. Nodes of `is_open` (n,) are open
    however their faces stand.
    """
    count = len(is_open)
    # (f, 3) and (3 f,): the node at each corner, and those after and before it in its face.
    nodes = np.where(faces < 0, counts[0] + ~faces, faces)
    flat = nodes.reshape(-1).astype(np.int64)
    after, before = (np.roll(nodes, step, axis=1).reshape(-1).astype(np.int64) for step in (-1, 1))
    # (3 f,): the corner that comes next around the same node, across the edge that arrives; a
    # corner is bad if it has none, or follows none or several.
    follower = _follow(flat * count + after, flat * count + before)
    hits = np.bincount(follower[follower >= 0], minlength=len(flat))
    bad = (follower < 0) | (hits != 1) | (after == flat) | (before == flat)
    # (n,): nodes all of whose corners are good, and make one ring.
    is_closed = np.bincount(flat, minlength=count) > 0
    is_closed[flat[bad]] = False
    is_closed &= ~is_open
    ringed = np.flatnonzero(is_closed[flat])
    rings = _join_corners(ringed, follower[ringed], len(flat))
    is_closed &= np.bincount(flat[np.unique(rings[ringed])], minlength=count) == 1

    # Corners at open nodes, joined across the edges whose other end is closed: `first` is the
    # first corner of each one's piece, and pieces are numbered by node, then by that.
    open_corners = np.flatnonzero(~is_closed[flat])
    inner = open_corners[is_closed[before[open_corners]]]
    first = _join_corners(inner, follower[inner], len(flat))
    heads = np.unique(first[open_corners])
    heads = heads[np.lexsort((heads, flat[heads]))]
    piece = np.full(len(flat), -1, np.int32)
    piece[heads] = np.arange(len(heads))
    piece[open_corners] = piece[first[open_corners]]
    # (q,): sides between open nodes, by the corner that each begins at and the one it ends at.
    loose = open_corners[~is_closed[after[open_corners]]]
    ends = np.where(loose % 3 == 2, loose - 2, loose + 1)
    sides = np.stack([loose, piece[loose], piece[ends]], axis=1).astype(np.int32)
    bare = np.flatnonzero((np.bincount(flat, minlength=count) == 0) & ~is_open)
    components, labels = label_components(vertex_of[nodes].astype(np.int64), sum(counts))
    return Seams(components, labels, flat[heads].astype(np.int32), sides, bare.astype(np.int32))


def sum_bricks(
    vertices: FloatArray,
    faces: Int32Array,
    counts: tuple[Int32Array, Int32Array],
    labels: Int32Array,
    components: int,
) -> BrickSums:
    """Sum over the vertices and faces of each component in each brick.

    Vertices (v, 3) and faces (f, 3) stand brick by brick, of which each has as many as `counts`
    (b,) say; a corner i < 0 is a foreign vertex. `labels` (v + g,) are the components, c in number,
    of all vertices, foreign ones too.
    """
    brick_of = [np.repeat(np.arange(len(each)), each) for each in counts]
    own = len(vertices)
    heads = np.where(faces[:, 0] < 0, own + ~faces[:, 0], faces[:, 0])
    # (v + f,): brick and component of each vertex and each face, as one number.
    pairs = np.concatenate(
        [
            brick_of[0] * components + labels[:own],
            brick_of[1] * components + labels[heads],
        ]
    )
    # (e,): the entries, in the order in which the vertices and then the faces of a brick come to
    # them; and (v + f,): which entry each vertex and each face belongs to.
    entries, first, entry = np.unique(pairs, return_index=True, return_inverse=True)
    order = np.lexsort((first, entries // max(components, 1)))
    rank = np.empty(len(entries), np.int64)
    rank[order] = np.arange(len(entries))
    entry, entries = rank[entry], entries[order]
    of_vertex, of_face = entry[:own], entry[own:]
    bricks = np.bincount(entries // max(components, 1), minlength=len(counts[0]))

    # Faces with foreign vertices have no volume and no area here: their corners' places are not
    # known.
    known = (faces >= 0).all(axis=1)
    a, b, c = (vertices[faces[known, k]] for k in range(3))
    volumes = (a * np.cross(b, c)).sum(axis=1)
    areas = 0.5 * np.sqrt((np.cross(b - a, c - a) ** 2).sum(axis=1))
    sums = np.empty((len(entries), 5))
    sums[:, 0] = np.bincount(of_face[known], volumes, len(entries))
    for column, values in enumerate(vertices.T, start=1):
        sums[:, column] = np.bincount(of_vertex, values, len(entries))
    sums[:, 4] = np.bincount(of_face[known], areas, len(entries))
    bounds = np.tile(np.repeat([np.inf, -np.inf], 3), (components, 1))
    np.minimum.at(bounds[:, :3], labels[:own], vertices)
    np.maximum.at(bounds[:, 3:], labels[:own], vertices)
    return BrickSums(
        np.r_[0, np.cumsum(bricks)].astype(np.int32),
        (entries % max(components, 1)).astype(np.int32),
        np.bincount(of_vertex, minlength=len(entries)).astype(np.int32),
        np.bincount(of_face, minlength=len(entries)).astype(np.int32),
        sums,
        bounds,
    )


def _follow(leaving: IntArray, arriving: IntArray) -> IntArray:
    """Return for each corner the one across its last edge, -1 where there is none.

    ``leaving`` and ``arriving`` name the edges of its first and its last side, seen from its node.
    """
    order = np.argsort(leaving, kind="stable")
    ranked = leaving[order]
    at = np.minimum(np.searchsorted(ranked, arriving), len(ranked) - 1)
    followers: IntArray = np.where(ranked[at] == arriving, order[at], -1) if len(ranked) else at
    return followers


def _join_corners(left: IntArray, right: IntArray, corners: int) -> IntArray:
    """Return for each corner the first of those that it is joined with."""
    _, label = join_nodes(left, right, corners)
    _, first = np.unique(label, return_index=True)
    return first[label]
