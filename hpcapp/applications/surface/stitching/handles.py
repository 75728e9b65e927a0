"""Small handles of a closed mesh: tunnels and bridges as narrow as a few of its faces.

::

    faces of a box ──> pieces ── corners, sides, loops of their border ──> handles of each piece

A surface that its points determine has handles as wide as what was scanned. Where noise, thin
walls or relief finer than the points leave it undetermined, its sheets grow together and holes
break through, about as wide as a face or two. A handle that lies in a small box, both around and
through, is found there by Euler's formula for a piece with borders, V - E + F = 2 - 2 g - b. A
hole through a plate is none: the way around it leads around the plate.
"""

from __future__ import annotations

from itertools import islice

import numpy as np

from hpcapp.applications.surface import kernels
from hpcapp.geometry.lattice import number_keys, pack_places
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.io.meshes.mesh_stream import MeshStream
from hpccomponent.dataclass import dataclass

BOX = 8.0
"""Sides of faces: the edge of the boxes that a handle must fit into to be small. See
``benchmarks/decisions.py``."""
_SHIFTS = tuple(np.ndindex(2, 2, 2))  # by half a box: one of these holds any that is half as wide
_MOST_FACES = 1 << 21  # of a mesh that are looked at, about, in blocks from all over it


@dataclass(frozen=True, slots=True, eq=False)
class SmallHandles:
    """What `find_small_handles` has found.

    Parameters
    ----------
    count : int
        At least so many there are.
    place : ndarray of float64, shape (3,)
        The middle of the piece with the most of them, in the frame of the mesh.
    width : float
        They are no wider, in length units of the input.
    """

    count: int
    place: FloatArray
    width: float


def find_small_handles(stream: MeshStream, box: float = BOX) -> SmallHandles:
    """Find small handles of a mesh, block by block.

    Parameters
    ----------
    stream : MeshStream
        Closed and manifold, the faces of a block near one another. Of very many blocks some are
        looked at.
    box : float
        See `BOX`.
    """
    every = max(1, -(-stream.face_count // _MOST_FACES))
    blocks = islice(zip(stream.faces(), stream.corners(), strict=True), 0, None, every)
    found = [_search(faces, corners, box) for faces, corners in blocks if len(faces)]
    if not found:
        return SmallHandles(0, np.zeros(3), 0.0)
    count, width = sum(one.count for one in found), max(one.width for one in found)
    return SmallHandles(count, max(found, key=lambda one: one.count).place, width)


def _search(faces: IntArray, corners: FloatArray, box: float) -> SmallHandles:
    """Find those of a block: as many as the lattice of boxes cuts out that cuts out most.

    `faces` are of shape (f, 3), `corners` where their vertices lie, (f, 3, 3).
    """
    # (f, 3, 3): the sides as vectors, of whose lengths the median is the unit of the boxes.
    sides = corners - np.roll(corners, -1, axis=1)
    edge = box * float(np.median(np.sqrt(np.square(sides).sum(axis=2))))
    centres = corners.mean(axis=1)
    low, links = centres.min(axis=0), _link_sides(faces)
    best = SmallHandles(0, low, edge)
    for shift in _SHIFTS:
        # (f, 3): boxes that part a handle in one lattice hold all of it in a shifted one.
        places = np.floor((centres - low) / edge + 0.5 * np.array(shift)).astype(np.int64)
        handles, piece = _count_handles(len(faces), links, pack_places(places))
        if int(handles.sum()) > best.count:
            place = centres[piece == int(handles.argmax())].mean(axis=0)
            best = SmallHandles(int(handles.sum()), place, edge)
    return best


def _link_sides(faces: IntArray) -> tuple[IntArray, IntArray]:
    """Return the pairs of sides that lie on one edge; side s of face f is 3 f + s."""
    tails, heads = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
    low, high = np.minimum(tails, heads), np.maximum(tails, heads)
    keys = low * (int(high.max()) + 1) + high
    order = np.argsort(keys, kind="stable")
    # The mesh is closed and manifold: two sides with one key, side by side, are an edge.
    same = np.flatnonzero(np.diff(keys[order]) == 0)
    return order[same], order[same + 1]


def _count_handles(
    faces: int, links: tuple[IntArray, IntArray], box: IntArray
) -> tuple[IntArray, IntArray]:
    """Return how many handles the pieces have that boxes cut out, and the piece of each face."""
    first, second = links
    inside = box[first // 3] == box[second // 3]
    first, second = first[inside], second[inside]
    # (f,): faces that hang together within a box are a piece.
    pieces, piece = _join(first // 3, second // 3, faces)
    # (3 f,): the corner at each side's tail; one vertex of the mesh may be one of several pieces.
    # Two faces run through their edge in opposite directions: where one begins, the other ends.
    left = np.concatenate([first, _next(first)])
    right = np.concatenate([_next(second), second])
    vertices, vertex = _join(left, right, 3 * faces)
    piece_of = np.zeros(vertices, np.int64)
    piece_of[vertex] = np.repeat(piece, 3)
    # Sides with nothing beyond them in the box; those that meet at corners are a border's loop.
    bare: BoolArray = np.ones(3 * faces, np.bool_)
    bare[first] = bare[second] = False
    border = np.flatnonzero(bare)
    ends, numbers = number_keys(np.concatenate([vertex[border], vertex[_next(border)]]))
    loops, loop = _join(numbers[: len(border)], numbers[len(border) :], len(ends))
    loop_piece = np.zeros(loops, np.int64)
    loop_piece[loop] = piece_of[ends]
    # Of each piece V - E + F + b.
    counts = [
        np.bincount(piece_of, minlength=pieces),
        np.bincount(piece[first // 3], minlength=pieces),  # three sides a face, these only once
        -2 * np.bincount(piece, minlength=pieces),
        np.bincount(loop_piece, minlength=pieces),
    ]
    handles: IntArray = (2 - np.sum(counts, axis=0)) // 2
    return handles, piece


def _next(sides: IntArray) -> IntArray:
    """Return the side at whose tail another ends."""
    return np.where(sides % 3 == 2, sides - 2, sides + 1)


def _join(left: IntArray, right: IntArray, nodes: int) -> tuple[int, IntArray]:
    """Return how many components a graph has, and the one of each node."""
    joined = np.stack([left, right, right], axis=1)  # edges as faces with a corner twice
    count, labels = kernels.label_components(joined, nodes)
    return count, labels.astype(np.int64)
