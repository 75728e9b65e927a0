"""Where the vertices and faces of a part go in the whole mesh."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.mesh_part import Int32Array, MeshPart
from hpccomponent.surface.points import FloatArray, IntArray

__all__ = ["PartPlaces", "place_faces", "place_vertices", "starts_of"]


@dataclass(frozen=True, slots=True, eq=False)
class PartPlaces:
    """The share of a part in the whole mesh; b bricks, g foreign vertices.

    Parameters
    ----------
    vertex_starts : ndarray of int64, shape (b,)
        The number of each brick's first vertex in the whole mesh.
    face_starts : ndarray of int64, shape (b,)
        The number of each brick's first face; -1 where another part gives the brick.
    dropped : ndarray of int32, shape (d,)
        Vertices (rows of the part, sorted) of components that are dropped.
    foreign : ndarray of int64, shape (g,)
        The number of each foreign vertex in the whole mesh, -1 where it is dropped.
    """

    vertex_starts: IntArray
    face_starts: IntArray
    dropped: Int32Array
    foreign: IntArray

    def to_values(self) -> tuple[Any, ...]:
        """Return the arrays, in the order of the parameters: what a task may be called with."""
        return tuple(getattr(self, field.name) for field in fields(self))

    @classmethod
    def from_values(cls, values: tuple[Any, ...]) -> PartPlaces:
        """Return what `to_values` took apart."""
        return cls(*values)


def place_vertices(
    part: MeshPart, places: PartPlaces, bricks: IntArray
) -> tuple[FloatArray, IntArray]:
    """Return the vertices that some bricks give to the mesh.

    Parameters
    ----------
    part : MeshPart
    places : PartPlaces
    bricks : ndarray of int64, shape (k,)
        Rows of bricks that are taken from this part, sorted.

    Returns
    -------
    vertices : ndarray of float64, shape (m, 3)
    numbers : ndarray of int64, shape (m,)
        In the whole mesh; rising.
    """
    starts = starts_of(part.vertex_counts)
    rows = _spread(starts, bricks)
    numbers = _number(starts, places, rows)
    kept = numbers >= 0
    return part.vertices[rows[kept]], numbers[kept]


def place_faces(
    part: MeshPart, places: PartPlaces, bricks: IntArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Return the faces that some bricks give to the mesh.

    Parameters
    ----------
    part : MeshPart
    places : PartPlaces
    bricks : ndarray of int64, shape (k,)
        Rows of bricks that are taken from this part, sorted.

    Returns
    -------
    rows : ndarray of int64, shape (m,)
        Of `part.faces`.
    faces : ndarray of int64, shape (m, 3)
        Over the vertices of the whole mesh.
    numbers : ndarray of int64, shape (m,)
        Of the faces in the whole mesh; rising.
    """
    starts = starts_of(part.face_counts)
    rows = _spread(starts, bricks)
    local = part.faces[rows]
    corners = _number_corners(part, places, local)
    kept = corners[:, 0] >= 0
    brick_of = np.repeat(bricks, part.face_counts[bricks])
    first = np.repeat(_first_of(part.face_counts[bricks]), part.face_counts[bricks])
    before: IntArray = np.cumsum(kept) - kept  # faces that are kept, of all the rows before
    numbers = places.face_starts[brick_of] + before - before[first]
    return rows[kept], corners[kept], numbers[kept]


def starts_of(counts: NDArray[np.integer[Any] | np.bool_]) -> IntArray:
    """Return where each brick's rows begin, and the last one's end, shape (b + 1,)."""
    starts = np.zeros(len(counts) + 1, np.int64)
    np.cumsum(counts, out=starts[1:])
    return starts


def _first_of(counts: Int32Array) -> IntArray:
    return np.cumsum(counts, dtype=np.int64) - counts


def _spread(starts: IntArray, bricks: IntArray) -> IntArray:
    """Return the rows of some bricks."""
    counts = starts[bricks + 1] - starts[bricks]
    return np.arange(counts.sum()) + np.repeat(starts[bricks] - _first_of(counts), counts)


def _number_corners(part: MeshPart, places: PartPlaces, faces: Int32Array) -> IntArray:
    """Return the numbers of the corners in the whole mesh, -1 for dropped ones."""
    own = faces[faces >= 0]
    low, high = (int(own.min()), int(own.max()) + 1) if len(own) else (0, 0)
    rows = np.arange(low, high)
    # The own vertices that are in reach, then the foreign ones.
    table = np.concatenate([_number(starts_of(part.vertex_counts), places, rows), places.foreign])
    numbers: IntArray = table[np.where(faces >= 0, faces - low, high - low + ~faces)]
    return numbers


def _number(starts: IntArray, places: PartPlaces, rows: IntArray) -> IntArray:
    """Return the numbers of vertices (rising rows) in the whole mesh, -1 for dropped ones."""
    if not len(rows):
        return np.empty(0, np.int64)
    first = int(np.searchsorted(starts, rows[0], side="right")) - 1
    last = int(np.searchsorted(starts, rows[-1], side="right"))
    counts = np.diff(starts[first : last + 1])
    shift = places.vertex_starts[first:last] - starts[first:last]
    if len(places.dropped):
        shift = shift + np.searchsorted(places.dropped, starts[first:last])
    numbers: IntArray = np.repeat(shift, counts)[rows - starts[first]] + rows
    if len(places.dropped):
        before = np.searchsorted(places.dropped, rows)
        is_dropped = places.dropped[np.minimum(before, len(places.dropped) - 1)] == rows
        numbers = np.where(is_dropped, -1, numbers - before)
    return numbers
