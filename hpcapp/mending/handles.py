"""A handle of a mesh, cut along the shortest loop that leads through it or around it.

::

    faces of a piece ──> edges that close no face ──> shortest loop that bounds nothing
        ──> the ring of faces along it taken out ──> two holes ──> filled as the surface bends

A loop that bounds nothing leads around a bridge, or through a tunnel: without the ring along it the
bridge is gone, or the tunnel closed. Such loops are told from others by how often they cross those
dual edges that neither a spanning tree nor one of the dual graph has (Erickson and Whittlesey 2005,
https://dl.acm.org/doi/10.5555/1070432.1070581).
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import breadth_first_order, connected_components, dijkstra

from hpcapp.geometry.lattice import find_keys, number_keys
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.mending.holes import fill_loop
from hpcapp.mending.loops import pair_sides

_MOST_BITS = 62  # of the loops of a piece that are told from one another


class HandleCutter:
    """Faces (f, 3) of a closed mesh around some handles, which are cut one after the other.

    They are manifold; some around them may be missing.

    Attributes
    ----------
    vertices, faces : ndarray
        Those that were given, and behind them new ones.
    is_left : ndarray of bool
        Which of the faces have not been taken out.
    cuts : int
        How many handles were cut.
    uncut : dict
        The places of loops that could not be, by their vertices.
    """

    def __init__(self, vertices: FloatArray, faces: IntArray) -> None:
        self.vertices, self.faces, self.cuts = vertices, faces, 0
        self.uncut: dict[frozenset[int], FloatArray] = {}
        self.is_left: BoolArray = np.ones(len(faces), np.bool_)
        one, other, _ = pair_sides(faces, len(vertices))
        is_bare = np.ones(faces.size, np.bool_)
        is_bare[one] = is_bare[other] = False
        self._border = np.zeros(len(vertices), np.bool_)
        for ends in (faces, np.roll(faces, -1, axis=1)):
            self._border[ends.reshape(-1)[is_bare]] = True

    def cut(self, rows: IntArray) -> None:
        """Cut the narrowest handle of a piece's faces, given by rows (k,), if it can be."""
        loop = find_shortest_loop(self.vertices, self.faces[rows])
        if loop is None:
            return
        if any(self._replace(ring) for ring in self._find_rings(loop)):
            self.cuts += 1
        else:
            self.uncut[frozenset(loop.tolist())] = self.vertices[loop].mean(axis=0)

    def _find_rings(self, loop: IntArray) -> list[IntArray]:
        """Return the faces along a loop: on both of its sides, then on one or the other."""
        ring = self._find_around(loop)
        faces, count = self.faces[ring], len(self.vertices)
        one, other, keys = pair_sides(faces, count)
        ends = np.sort(np.stack([loop, np.roll(loop, -1)]), axis=0)
        is_beside = ~np.isin(keys, ends[0] * count + ends[1])
        pieces, piece = connected_components(
            csr_matrix(
                (np.ones(int(is_beside.sum())), (one[is_beside] // 3, other[is_beside] // 3)),
                shape=(len(faces), len(faces)),
            ),
            directed=False,
        )
        return [ring, *(ring[piece == side] for side in range(pieces if pieces > 1 else 0))]

    def _find_around(self, vertices: IntArray) -> IntArray:
        """Return the rows of the faces that have some of the vertices."""
        is_wanted = np.zeros(len(self.vertices), np.bool_)
        is_wanted[vertices] = True
        return np.flatnonzero(self.is_left & is_wanted[self.faces].any(axis=1))

    def _replace(self, ring: IntArray) -> bool:
        """Take a ring of faces out, and fill the two holes that it leaves; or leave it."""
        borders, is_simple = walk_borders(self.faces[ring])
        corners = self.faces[ring]
        edges = (3 * len(ring) + sum(map(len, borders))) // 2
        is_annulus = len(number_keys(corners.reshape(-1))[0]) - edges + len(ring) == 0
        if not (is_simple and is_annulus and len(borders) == 2):
            return False
        # Beyond a vertex on the border of what is here nobody knows which edges there are.
        if self._border[np.concatenate(borders)].any():
            return False
        before = self.vertices, self.faces, self.is_left.copy(), self._border
        self.is_left[ring] = False
        if all(self._fill(loop) for loop in borders):
            return True
        self.vertices, self.faces, self.is_left, self._border = before
        return False

    def _fill(self, loop: IntArray) -> bool:
        around = self.faces[self._find_around(loop)]
        steps = np.linalg.norm(self.vertices[loop] - self.vertices[np.roll(loop, -1)], axis=1)
        patch = fill_loop(self.vertices, loop, around, 0.5 * (steps + np.roll(steps, 1)))
        if patch is None:
            return False
        first, added = len(self.vertices), len(patch.places)
        rows = np.concatenate([loop, first + np.arange(added)])
        self.vertices = np.concatenate([self.vertices, patch.places])
        self.faces = np.concatenate([self.faces, rows[patch.faces]])
        self.is_left = np.concatenate([self.is_left, np.ones(len(patch.faces), np.bool_)])
        self._border = np.concatenate([self._border, np.zeros(added, np.bool_)])
        return True


def find_shortest_loop(vertices: FloatArray, faces: IntArray) -> IntArray | None:
    """Return the vertices (n,) of the shortest loop of edges that parts a piece of a mesh nowhere.

    Faces (f, 3) are connected, manifold; their border may be any number of loops. None where each
    loop bounds something, or runs along the border.
    """
    nodes, corners = split_corners(faces)
    count = len(nodes)
    borders, is_simple = walk_borders(corners)
    if not is_simple:
        return None
    # Each loop of the border gets a lid, so that whatever parts the piece bounds something.
    lids = [
        np.stack([np.roll(loop, -1), loop, np.full(len(loop), count + tip)], axis=1)
        for tip, loop in enumerate(borders)
    ]
    edges, marks = _mark_edges(np.concatenate([corners, *lids]), count + len(borders))
    is_real = (edges < count).all(axis=1)
    edges, marks = edges[is_real], marks[is_real]
    if not marks.any():
        return None
    places = vertices[nodes]
    lengths = np.linalg.norm(places[edges[:, 0]] - places[edges[:, 1]], axis=1)
    ways, whole = np.concatenate([edges, edges[:, ::-1]]), (count, count)
    graph = csr_matrix((np.tile(lengths, 2), ways.T), shape=whole)
    # Each loop that bounds nothing has a marked edge.
    roots = np.unique(edges[marks != 0])
    distances, before = dijkstra(graph, indices=roots, return_predecessors=True)
    crossed = _follow(before, distances, edges, marks)
    # (r, e): how long the loop is that an edge closes, with the ways from the root to its ends.
    lengths = distances[:, edges[:, 0]] + distances[:, edges[:, 1]] + lengths
    bounds = crossed[:, edges[:, 0]] ^ crossed[:, edges[:, 1]] == marks
    lengths[bounds] = np.inf
    root, edge = np.unravel_index(int(np.argmin(lengths)), lengths.shape)
    if np.isinf(lengths[root, edge]):
        return None
    there, back = (_walk_back(before[root], int(end)) for end in edges[edge])
    loop: IntArray = nodes[np.array([*there[::-1], *back[:-1]])]
    return loop if len(np.unique(loop)) == len(loop) else None


def walk_borders(faces: IntArray) -> tuple[list[IntArray], bool]:
    """Return the loops of edges with one face, as that face runs, and whether each is simple."""
    count = int(faces.max(initial=0)) + 1
    tails, heads = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    # The sides that no face runs through the other way round.
    is_bare = find_keys(np.sort(heads * count + tails), tails * count + heads) == faces.size
    tails, heads = tails[is_bare], heads[is_bare]
    after = dict(zip(tails.tolist(), heads.tolist(), strict=True))
    is_simple = len(after) == len(tails) == len(set(heads.tolist()))
    loops = []
    while after:
        loop, at = [], next(iter(after))
        while at in after:
            loop.append(at)
            at = after.pop(at)
        loops.append(np.array(loop))
    return loops, is_simple


def split_corners(faces: IntArray) -> tuple[IntArray, IntArray]:
    """Number the vertices of a piece, each once for every fan of faces that it has there."""
    one, other, _ = pair_sides(faces, int(faces.max()) + 1)
    after = np.arange(3 * len(faces)).reshape(-1, 3)[:, [1, 2, 0]].reshape(-1)
    joined = np.concatenate([one, after[one]]), np.concatenate([after[other], other])
    whole = (faces.size, faces.size)
    count, label = connected_components(csr_matrix((np.ones(len(joined[0])), joined), shape=whole))
    nodes = np.zeros(count, np.int64)
    nodes[label] = faces.reshape(-1)
    return nodes, label.reshape(faces.shape).astype(np.int64)


def _mark_edges(faces: IntArray, count: int) -> tuple[IntArray, IntArray]:
    """Return the edges of a closed surface, and marks whose sum (exclusive or) tells loops apart.

    A loop bounds something where the marks of its edges sum up to zero.
    """
    one, other, keys = pair_sides(faces, count)
    edges = np.stack([keys // count, keys % count], axis=1)
    graph = csr_matrix((np.ones(len(keys)), edges.T), shape=(count, count))
    nodes, before = breadth_first_order(graph, int(faces[0, 0]), directed=False)
    child = nodes[1:]
    parent = before[child].astype(np.int64)
    is_tree = np.isin(keys, np.minimum(child, parent) * count + np.maximum(child, parent))
    # The dual graph without the tree's edges; of two faces with several edges one counts.
    near, far = one // 3, other // 3
    rest = np.flatnonzero(~is_tree)
    pairs = np.minimum(near, far)[rest] * len(faces) + np.maximum(near, far)[rest]
    names, first = np.unique(pairs, return_index=True)
    across = rest[first]
    dual = csr_matrix(
        (np.ones(len(names)), (names // len(faces), names % len(faces))),
        shape=(len(faces), len(faces)),
    )
    order, parents = breadth_first_order(dual, 0, directed=False)
    above = parents[order[1:]].astype(np.int64)
    below = order[1:].astype(np.int64)
    wanted = np.minimum(above, below) * len(faces) + np.maximum(above, below)
    to_parent = np.full(len(faces), -1, np.int64)
    to_parent[below] = across[np.searchsorted(names, wanted)]
    is_tree[to_parent[below]] = True
    marks = np.zeros(len(keys), np.int64)
    for bit, edge in enumerate(np.flatnonzero(~is_tree)[:_MOST_BITS].tolist()):
        marks[edge] ^= 1 << bit
        for face in (int(near[edge]), int(far[edge])):
            while to_parent[face] >= 0:
                marks[to_parent[face]] ^= 1 << bit
                face = int(parents[face])
    return edges, marks


def _follow(before: IntArray, distances: FloatArray, edges: IntArray, marks: IntArray) -> IntArray:
    """Return the sums of the marks on the ways from roots to all nodes, shape (r, n)."""
    count = distances.shape[1]
    order = np.argsort(edges[:, 0] * count + edges[:, 1])
    keys = (edges[:, 0] * count + edges[:, 1])[order]
    sums = np.zeros(distances.shape, np.int64)
    roots = np.arange(len(distances))
    for at in np.argsort(distances, axis=1).T:  # from near to far
        parent = before[roots, at].astype(np.int64)
        known = parent >= 0
        there, start, root = at[known], parent[known], roots[known]
        steps = np.searchsorted(keys, np.minimum(start, there) * count + np.maximum(start, there))
        sums[root, there] = sums[root, start] ^ marks[order[steps]]
    return sums


def _walk_back(before: IntArray, end: int) -> list[int]:
    """Return the nodes from an end to the root."""
    way = [end]
    while before[way[-1]] >= 0:
        way.append(int(before[way[-1]]))
    return way
