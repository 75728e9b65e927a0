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

import numpy as np

from hpcapp import kernels
from hpcapp.geometry.lattice import number_keys, pack_places
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.mending.loops import pair_sides

BOX = 8.0
"""Sides of faces: the edge of the boxes that a handle must fit into to be small. See
``benchmarks/decisions.py``."""
_SHIFTS = tuple(np.ndindex(2, 2, 2))  # by half a box: one of these holds any that is half as wide


def find_small_handles(faces: IntArray, corners: FloatArray, width: float) -> list[IntArray]:
    """Find small handles of a manifold mesh, such as fit into a box of some width.

    The vertices of the faces are at `corners` (f, 3, 3). Returned are the faces of each piece with
    handles that a box cuts out, of all lattices: they overlap.
    """
    links = pair_sides(faces, int(faces.max(initial=0)) + 1)[:2]
    centres = corners.mean(axis=1)
    low = centres.min(axis=0, initial=np.inf)
    found = []
    for shift in _SHIFTS:
        # (f, 3): boxes that part a handle in one lattice hold all of it in a shifted one.
        places = np.floor((centres - low) / width + 0.5 * np.array(shift)).astype(np.int64)
        handles, piece = _count_handles(len(faces), links, pack_places(places))
        found += [np.flatnonzero(piece == one) for one in np.flatnonzero(handles)]
    return found


def find_suspects(faces: IntArray) -> tuple[bool, list[IntArray]]:
    """Tell whether a manifold mesh has handles at all, and which faces each closed piece has.

    Where all of it has none, no box has some.
    """
    links = pair_sides(faces, int(faces.max(initial=0)) + 1)[:2]
    handles, piece = _count_handles(len(faces), links, np.zeros(len(faces), np.int64))
    sides = 3 * np.bincount(piece) - 2 * np.bincount(piece[links[0] // 3], minlength=len(handles))
    return bool(handles.any()), [np.flatnonzero(piece == one) for one in np.flatnonzero(sides == 0)]


def is_hollow(corners: FloatArray, width: float) -> bool:
    """Tell whether a closed piece, (f, 3, 3), looks inwards and is no wider than a width."""
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    if (high - low).max() > width:
        return False
    a, b, c = (corners - corners[0, 0]).transpose(1, 0, 2)
    return float(np.einsum("ij,ij->", a, np.cross(b, c))) < 0.0


def measure_side(corners: FloatArray) -> float:
    """Return how long a side of most faces is, of corners (f, 3, 3)."""
    sides = corners - np.roll(corners, -1, axis=1)
    return float(np.median(np.sqrt(np.square(sides).sum(axis=2))))


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
