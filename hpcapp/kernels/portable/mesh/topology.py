"""The connectivity of meshes in numpy and scipy: components, edges, fans.

Everything is counted on sorted arrays of edges and with connected components of sparse graphs:
no step visits faces one by one.
"""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import BoolArray, FloatArray, Int32Array, IntArray
from hpcapp.kernels.types.brick_mesh import Survey
from hpccomponent.dataclass import dataclass

__all__ = ["label_components", "signed_volume", "survey_mesh"]


@dataclass(frozen=True, slots=True, eq=False)
class _Edges:
    """The 3 f sides of the faces, grouped into edges.

    ``order`` lists the sides edge by edge (side s belongs to face s // 3 and runs from its
    corner s % 3 to the next); ``starts`` and ``counts`` say where an edge's sides begin in
    ``order`` and how many they are; ``ends`` holds its two vertices, the lower first.
    """

    order: IntArray
    starts: IntArray
    counts: IntArray
    ends: IntArray
    backward: BoolArray


def label_components(faces: IntArray, vertices: int) -> tuple[int, Int32Array]:
    """Find the pieces of a mesh, faces (f, 3) and v vertices, that share no vertex.

    Return how many there are, and the component of each vertex, (v,), numbered in the order of
    their first vertices. A vertex without a face is a component of its own.
    """
    first, second = faces[:, :2].T, faces[:, 1:].T
    count, label = join_nodes(np.concatenate(first), np.concatenate(second), vertices)
    _, order = np.unique(label, return_index=True)
    rank = np.empty(count, np.int32)
    rank[np.argsort(order, kind="stable")] = np.arange(count, dtype=np.int32)
    return count, rank[label]


def survey_mesh(faces: IntArray, vertices: int) -> Survey:
    """Count what is to know about the edges of a mesh and the corners at them.

    It has v vertices and faces (f, 3), one at least. A vertex is manifold where the corners of the
    faces around it, joined across shared edges, are one piece; so a mesh is vertex-manifold where
    there are as many fans as used vertices.
    """
    edges = _group_edges(faces, vertices)
    backward = np.add.reduceat(edges.backward.astype(np.int64), edges.starts)
    misoriented = (backward > 1) | (edges.counts - backward > 1)
    return Survey(
        int((edges.counts == 1).sum()),
        int((edges.counts > 2).sum()),
        int((edges.ends[:, 0] == edges.ends[:, 1]).sum()),
        int(misoriented.sum()),
        _count_fans(faces, edges),
        np.bincount(edges.ends[:, 0], minlength=vertices).astype(np.int32),
    )


def signed_volume(vertices: FloatArray, faces: IntArray, reference: FloatArray) -> float:
    """Return the volume inside a closed mesh, negative if its faces look inwards.

    In cubed length units of the input, of vertices (v, 3) and faces (f, 3); of no meaning for an
    open mesh. `reference` (3,) is a point near: a mesh far from the origin loses no digits.
    """
    local = vertices - reference
    a, b, c = (local[faces[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def _group_edges(faces: IntArray, vertices: int) -> _Edges:
    """Sort the sides of the faces by the edge that they lie on."""
    # (3 f,): both ends of each side, and one number for the edge that it lies on.
    tail, head = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    key = np.minimum(tail, head) * vertices + np.maximum(tail, head)
    order = np.argsort(key, kind="stable")
    ranked = key[order]
    starts = np.flatnonzero(np.r_[True, ranked[1:] != ranked[:-1]])
    counts = np.diff(np.r_[starts, len(ranked)])
    ends = np.stack(np.divmod(ranked[starts], vertices), axis=1)
    return _Edges(order, starts, counts, ends, (tail > head)[order])


def _count_fans(faces: IntArray, edges: _Edges) -> int:
    """Count the pieces that the corners of all faces form when joined across shared edges."""
    # Of each edge with two sides or more: the first two, and the corners at their ends.
    inner = edges.starts[edges.counts >= 2]
    first, second = edges.order[inner], edges.order[inner + 1]
    flat = faces.ravel()
    first_head, second_head = _next_corner(first), _next_corner(second)
    runs_back = flat[first] == flat[second_head]
    left = np.r_[first, first_head]
    right = np.r_[
        np.where(runs_back, second_head, second), np.where(runs_back, second, second_head)
    ]
    return join_nodes(left, right, len(flat))[0]


def _next_corner(side: IntArray) -> IntArray:
    """Return the corner at which a side ends; sides begin at the corner of their own number."""
    return np.where(side % 3 == 2, side - 2, side + 1)


def join_nodes(left: IntArray, right: IntArray, nodes: int) -> tuple[int, IntArray]:
    """Return the count and labels (nodes,), from 0, of the components of an undirected graph.

    `left` and `right` (e,) are the ends of each edge, from 0.
    """
    from scipy.sparse import coo_array  # heavy modules: the native build does without them
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(left), dtype=np.int8), (left, right)), shape=(nodes, nodes))
    count, label = connected_components(graph.tocsr(), directed=False)
    return int(count), label
