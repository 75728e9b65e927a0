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
    rows = _rows_of(starts_of(part.vertex_counts), bricks)
    numbers = _number(part, places, rows)
    vertices = _take(part.vertices, rows)
    if not len(places.dropped):
        return vertices, numbers
    kept = numbers >= 0
    return vertices[kept], numbers[kept]


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
    rows = _rows_of(starts_of(part.face_counts), bricks)
    corners = _number_corners(part, places, _take(part.faces, rows))
    counts = part.face_counts[bricks]
    first = np.cumsum(counts, dtype=np.int64) - counts
    kept = corners[:, 0] >= 0
    if kept.all():
        return (
            rows,
            corners,
            np.repeat(places.face_starts[bricks] - first, counts) + np.arange(len(rows)),
        )
    before = starts_of(kept)  # how many faces are kept, of all the rows before
    shift = places.face_starts[bricks] - before[first]
    return rows[kept], corners[kept], (np.repeat(shift, counts) + before[:-1])[kept]


def starts_of(counts: NDArray[np.integer[Any] | np.bool_]) -> IntArray:
    """Return where each brick's rows begin, and the last one's end, shape (b + 1,)."""
    starts = np.zeros(len(counts) + 1, np.int64)
    np.cumsum(counts, out=starts[1:])
    return starts


def _rows_of(starts: IntArray, bricks: IntArray) -> IntArray:
    """Return the rows of some bricks."""
    counts = starts[bricks + 1] - starts[bricks]
    first = np.cumsum(counts) - counts
    return np.repeat(starts[bricks] - first, counts) + np.arange(int(counts.sum()))


def _take(values: NDArray[Any], rows: IntArray) -> NDArray[Any]:
    """Return some rows (sorted); of all rows, no copy."""
    return values if len(rows) == len(values) else values[rows]


def _number_corners(part: MeshPart, places: PartPlaces, faces: Int32Array) -> IntArray:
    """Return the numbers of the corners in the whole mesh, -1 for dropped ones."""
    high = int(faces.max(initial=-1)) + 1
    low = int(faces.view(np.uint32).min(initial=high)) if high else 0  # negative ones look large
    own = _number(part, places, np.arange(low, high))
    # The own vertices in reach; the foreign ones stand where negative indices find them.
    table = np.concatenate([own, places.foreign[::-1]])
    numbers: IntArray = table[np.where(faces < 0, faces, faces - low) if low else faces]
    return numbers


def _number(part: MeshPart, places: PartPlaces, rows: IntArray) -> IntArray:
    """Return the numbers of vertices (rising rows) in the whole mesh, -1 for dropped ones."""
    if not len(rows):
        return np.empty(0, np.int64)
    starts = starts_of(part.vertex_counts)
    first = int(np.searchsorted(starts, rows[0], side="right")) - 1
    last = int(np.searchsorted(starts, rows[-1], side="right"))
    shift = places.vertex_starts[first:last] - starts[first:last]
    shift += np.searchsorted(places.dropped, starts[first:last])
    shifts = np.repeat(shift, part.vertex_counts[first:last])
    shifts = _take(shifts, rows - starts[first])
    if not len(places.dropped):
        return shifts + rows
    before = np.searchsorted(places.dropped, rows)
    is_dropped = places.dropped[np.minimum(before, len(places.dropped) - 1)] == rows
    return np.where(is_dropped, -1, shifts + rows - before)
