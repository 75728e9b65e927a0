"""The borders of a mesh: which of them are holes, and which are where a sheet ends.

::

    faces ──> edges with one face ──> loops ── size, what lies within ──> holes
"""

from __future__ import annotations

import numpy as np

from hpcapp import kernels
from hpcapp.geometry.lattice import number_keys
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, IntArray
from hpcapp.mending.pieces import measure_pieces
from hpccomponent.dataclass import dataclass

SHEET = 0.5
"""Of a piece's area: around a loop that spans more, the piece is a sheet, and the loop its end. It
is the length of the mean normal of a half sphere (see `boundary.drive`): a piece that shows less
than half of an object is a view of it."""


@dataclass(frozen=True, slots=True, eq=False)
class Loops:
    """Borders of a mesh that may be filled.

    Holes are the vertices, (n,) each, in the order in which the faces that fill one run along its
    border. Tangled are borders of that size that no face can be joined to: they touch themselves or
    each other, or edges of more than two faces, or faces of which one is turned.
    """

    holes: list[IntArray]
    tangled: int


def find_holes(mesh: Mesh, size: float) -> Loops:
    """Find the holes of a mesh, of a face at least, up to a size.

    It is the diagonal of the box around a border, in length units of the mesh.
    """
    count = len(mesh.vertices)
    heads, tails = mesh.faces.reshape(-1), np.roll(mesh.faces, -1, axis=1).reshape(-1)
    beside, is_odd = count_faces(tails, heads)
    # Sides with one face, as the face on their other side would run through them.
    border = np.flatnonzero(beside == 1)
    start, end = tails[border], heads[border]
    if not len(border):
        return Loops([], 0)
    may_close = np.bincount(start, minlength=count) <= 1
    may_close &= np.bincount(end, minlength=count) <= 1
    may_close[np.concatenate([tails[is_odd], heads[is_odd]])] = False
    labels = kernels.label_components(np.stack([start, end, end], axis=1), count)[1]
    names, loop = number_keys(labels[start].astype(np.int64))
    is_small = _measure(mesh, start, loop, len(names)) <= size
    is_tangled = np.bincount(loop, ~(may_close[start] & may_close[end]), len(names)) > 0
    is_hole = is_small & ~is_tangled & ~_find_sheets(mesh, border // 3, start, end, loop)
    after = np.full(count, -1, np.int64)
    after[start] = end
    _, first = np.unique(loop, return_index=True)
    holes = [_walk(int(start[first[one]]), after) for one in np.flatnonzero(is_hole)]
    return Loops(holes, int((is_small & is_tangled).sum()))


def count_faces(tails: IntArray, heads: IntArray) -> tuple[IntArray, BoolArray]:
    """Return how many faces the edge of each side has, (s,), and which are of no solid's edge.

    Sides run from tails to heads, (s,) each. Such an edge has more than two faces, or two that run
    one way.
    """
    keys = np.minimum(tails, heads) * (int(tails.max(initial=0)) + 1) + np.maximum(tails, heads)
    edges, number = number_keys(keys)
    faces = np.bincount(number, minlength=len(edges))
    ways = np.bincount(number, tails < heads, len(edges))
    is_odd = (faces > 2) | ((faces == 2) & (ways != 1))
    return faces[number], is_odd[number]


def pair_sides(faces: IntArray, count: int) -> tuple[IntArray, IntArray, IntArray]:
    """Return the pairs of sides that lie on one edge; side s of face f is 3 f + s.

    Faces (f, 3) are manifold: no edge has more than two of them. Both sides, (e,) each, come with
    the key (e,) of the edge: the lower vertex, times `count`, which is more than any, and the
    higher one.
    """
    tails, heads = faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)
    keys = np.minimum(tails, heads) * count + np.maximum(tails, heads)
    order = np.argsort(keys, kind="stable")
    same = np.flatnonzero(np.diff(keys[order]) == 0)
    return order[same], order[same + 1], keys[order[same]]


def _measure(mesh: Mesh, start: IntArray, loop: IntArray, count: int) -> IntArray:
    """Return the diagonal of the box around each loop."""
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, loop, mesh.vertices[start])
    np.maximum.at(high, loop, mesh.vertices[start])
    diagonals: IntArray = np.linalg.norm(high - low, axis=1)
    return diagonals


def _find_sheets(
    mesh: Mesh, face: IntArray, start: IntArray, end: IntArray, loop: IntArray
) -> BoolArray:
    """Tell which loops are where a sheet ends: what they span is much of what hangs on them."""
    pieces, areas = measure_pieces(mesh)
    count = int(loop.max()) + 1
    of_loop = np.empty(count, np.int64)
    of_loop[loop] = pieces[face]
    # (l, 3): half the sum of p x q along a loop is the directed area of whatever it spans. Seen
    # from the first vertex, so that nothing is lost where the mesh lies far from zero.
    eye = np.empty((count, 3))
    eye[loop[::-1]] = mesh.vertices[start[::-1]]
    p, q = (mesh.vertices[ends] - eye[loop] for ends in (start, end))
    spanned = np.zeros((count, 3))
    np.add.at(spanned, loop, 0.5 * np.cross(p, q))
    is_sheet: BoolArray = np.linalg.norm(spanned, axis=1) > SHEET * areas[of_loop]
    return is_sheet


def _walk(first: int, after: IntArray) -> IntArray:
    """Return the vertices of a loop from the first on."""
    loop = [first]
    while (vertex := int(after[loop[-1]])) != first:
        loop.append(vertex)
    return np.array(loop)
