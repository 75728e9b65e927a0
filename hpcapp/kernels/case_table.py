"""The 256 cases of marching cubes, derived from one rule instead of typed in.

On every face of a cell the inside corners are cut off from one another, so that the two cells at
a face always agree on the segments in it; the segments close to loops, and the loops become
triangles without a diagonal that lies in a face of the cell, where the neighbour's diagonal could
coincide with it. Every mesh made from this table is closed, edge-manifold and vertex-manifold.

Corners are numbered x + 2y + 4z; bit c of a case is set where corner c is inside (negative).
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

Loop = tuple[int, ...]
Triangle = tuple[int, int, int]

EDGES: tuple[tuple[int, int], ...] = tuple(
    (axis, corner) for axis in range(3) for corner in range(8) if not corner >> axis & 1
)
"""The 12 edges of a cell as (axis, lower corner)."""

MAX_TRIANGLES = 5


def _face_cycles() -> list[list[int]]:
    """Return the corners of the six faces, anticlockwise as seen from outside the cell."""
    cycles = []
    for axis in range(3):
        b, c = 1 << (axis + 1) % 3, 1 << (axis + 2) % 3
        low = [0, b, b | c, c]
        cycles.append([corner | 1 << axis for corner in low])
        cycles.append(low[::-1])
    return cycles


_FACES = _face_cycles()
_EDGE_OF = {frozenset((c, c | 1 << axis)): e for e, (axis, c) in enumerate(EDGES)}
_FACES_OF = [
    {f for f, cycle in enumerate(_FACES) if c in cycle and c | 1 << axis in cycle}
    for axis, c in EDGES
]


def _segments(case: int) -> dict[int, int]:
    """Return the directed segments (edge to edge) that cut off each run of inside corners."""
    segments = {}
    for cycle in _FACES:
        inside = [bool(case >> corner & 1) for corner in cycle]
        for last in range(4):
            if inside[last] and not inside[(last + 1) % 4]:
                first = last
                while inside[first - 1]:
                    first -= 1
                leaves = _EDGE_OF[frozenset((cycle[last], cycle[(last + 1) % 4]))]
                enters = _EDGE_OF[frozenset((cycle[first], cycle[first - 1]))]
                segments[leaves] = enters
    return segments


def _loops(case: int) -> list[Loop]:
    """Join the segments of a case to closed loops of edges."""
    segments = _segments(case)
    loops = []
    while segments:
        loop = [next(iter(segments))]
        while (following := segments.pop(loop[-1])) != loop[0]:
            loop.append(following)
        loops.append(tuple(loop))
    return loops


def _is_inner(first: int, second: int) -> bool:
    """Tell whether the diagonal between two edges runs inside the cell, off all its faces."""
    return not _FACES_OF[first] & _FACES_OF[second]


def _triangulate(loop: Loop) -> list[Triangle] | None:
    """Cut a loop into triangles by inner diagonals only; None where that is impossible."""
    last = len(loop) - 1
    if last < 2:
        return []
    for apex in range(1, last):
        if apex > 1 and not _is_inner(loop[0], loop[apex]):
            continue
        if apex < last - 1 and not _is_inner(loop[apex], loop[-1]):
            continue
        left, right = _triangulate(loop[: apex + 1]), _triangulate(loop[apex:])
        if left is not None and right is not None:
            return [*left, (loop[0], loop[-1], loop[apex]), *right]
    return None


@cache
def case_triangles() -> NDArray[np.int8]:
    """Return the triangles of every case, (256, MAX_TRIANGLES, 3).

    They are edge numbers (see `EDGES`), anticlockwise as seen from outside; unused rows hold -1.
    Loops have three to seven edges, and each has a triangulation by inner diagonals.
    """
    table = np.full((256, MAX_TRIANGLES, 3), -1, np.int8)
    for case in range(256):
        triangles = [t for loop in _loops(case) for t in _triangulate(loop) or []]
        table[case, : len(triangles)] = np.array(triangles, np.int8).reshape(-1, 3)
    table.flags.writeable = False
    return table


@cache
def triangle_counts() -> NDArray[np.int64]:
    """Return how many triangles each case has, (256,)."""
    counts: NDArray[np.int64] = (case_triangles()[:, :, 0] >= 0).sum(axis=1)
    return counts
