"""Where the vertices and faces of a part go in the whole mesh."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface.extraction.parts import MeshPart
from hpcapp.geometry.points import BoolArray, FloatArray, Int32Array, IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.records import record

Row = TypeVar("Row", bound=np.generic)
Counts = Int32Array | IntArray | BoolArray


@record("surface.part_places")
@dataclass(frozen=True, slots=True, eq=False)
class PartPlaces:
    """The share of a part in the whole mesh; b bricks, g foreign vertices.

    `vertex_starts` (b,) and `face_starts` (b,) number each brick's first vertex and face in the
    whole mesh; -1 where another part gives the faces. `dropped` (d,) are vertices, rows of the
    part, sorted, of components that are dropped; `foreign` (g,) numbers the foreign vertices, -1
    where one is.
    """

    vertex_starts: IntArray
    face_starts: IntArray
    dropped: Int32Array
    foreign: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """Rows that stay together on their way into the mesh; k runs.

    `starts` (k + 1,) are where each begins among the rows, and the last one's end: none is empty;
    `numbers` (k,) which row of the mesh the first of each run is, rising.
    """

    starts: IntArray
    numbers: IntArray

    def __iter__(self) -> Iterator[tuple[int, int, int]]:
        """Yield first row, last row and first number of each run."""
        starts = self.starts.tolist()
        return zip(starts, starts[1:], self.numbers.tolist(), strict=False)

    def put(self, rows: NDArray[Row], mesh: NDArray[Row], before: int = 0) -> None:
        """Put rows, in the order of the runs, into a mesh, or a piece of it after `before` rows."""
        for first, last, number in self:
            mesh[number - before : number - before + last - first] = rows[first:last]


def place_vertices(part: MeshPart, places: PartPlaces, bricks: IntArray) -> tuple[FloatArray, Runs]:
    """Return the vertices (m, 3) that some bricks give to the mesh, and where they go.

    `bricks` (k,) are sorted rows of bricks that are taken from this part.
    """
    starts, counts = starts_of(part.vertex_counts), part.vertex_counts[bricks]
    vertices = _take(part.vertices, starts, bricks)
    if len(places.dropped):
        kept = np.ones(len(part.vertices), np.bool_)
        kept[places.dropped] = False
        vertices = vertices[_take(kept, starts, bricks)]
        counts = np.diff(starts_of(kept)[starts])[bricks]
    return vertices, _join(counts, places.vertex_starts[bricks])


def place_faces(
    part: MeshPart, places: PartPlaces, bricks: IntArray
) -> tuple[Int32Array, IntArray, Runs]:
    """Return the faces (m, 3) that some bricks give to the mesh, and where they go.

    They come as the part names their vertices, and as the whole mesh numbers them. `bricks` (k,)
    are sorted rows of bricks that are taken from this part.
    """
    counts = part.face_counts[bricks]
    faces = _take(part.faces, starts_of(part.face_counts), bricks)
    corners = _number_corners(part, places, faces)
    if len(places.dropped) or places.foreign.min(initial=0) < 0:
        kept = corners[:, 0] >= 0
        counts = np.diff(starts_of(kept)[starts_of(counts)])
        faces, corners = faces[kept], corners[kept]
    return faces, corners, _join(counts, places.face_starts[bricks])


def find_kept(part: MeshPart, places: PartPlaces, brick: int) -> IntArray:
    """Return which of the faces of a brick go to the mesh, (k,): their numbers in the brick.

    `brick` is the row of one that is taken from this part.
    """
    first, last = starts_of(part.face_counts)[[brick, brick + 1]]
    return np.flatnonzero(_number_corners(part, places, part.faces[first:last])[:, 0] >= 0)


def starts_of(counts: Counts) -> IntArray:
    """Return where each brick's rows begin, and the last one's end: (b + 1,) by counts of (b,)."""
    starts = np.zeros(len(counts) + 1, np.int64)
    np.cumsum(counts, out=starts[1:])
    return starts


def _join(counts: Counts, numbers: IntArray) -> Runs:
    """Return the rows of bricks as runs: those of one brick stay together, and often of several."""
    is_filled = counts > 0
    counts, numbers = counts[is_filled], numbers[is_filled]
    starts = starts_of(counts)
    first = np.ones(len(counts), np.bool_)
    np.not_equal(numbers[1:], numbers[:-1] + counts[:-1], out=first[1:])
    return Runs(np.append(starts[:-1][first], starts[-1]), numbers[first])


def _take(values: NDArray[Row], starts: IntArray, bricks: IntArray) -> NDArray[Row]:
    """Return the rows of some bricks; of all bricks, no copy."""
    if len(bricks) == len(starts) - 1:
        return values
    if not len(bricks):
        return values[:0]
    # Bricks that stand side by side make one run of rows.
    cuts = np.flatnonzero(np.diff(bricks) != 1) + 1
    first = starts[bricks[np.r_[0, cuts]]].tolist()
    last = starts[bricks[np.r_[cuts, len(bricks)] - 1] + 1].tolist()
    if len(first) == 1:
        return values[first[0] : last[0]]
    return np.concatenate([values[i:j] for i, j in zip(first, last, strict=True)])


def _number_corners(part: MeshPart, places: PartPlaces, faces: Int32Array) -> IntArray:
    """Return the numbers of the corners in the whole mesh, -1 for dropped ones."""
    high = int(faces.max(initial=-1)) + 1
    low = int(faces.view(np.uint32).min(initial=high)) if high else 0  # negative ones look large
    own = _number(part, places, low, high)
    # The own vertices in reach; the foreign ones stand where negative indices find them.
    table = np.concatenate([own, places.foreign[::-1]])
    if table.max(initial=0) < np.iinfo(np.int32).max:
        table = table.astype(np.int32)  # half as much to move
    numbers: IntArray = table[np.where(faces < 0, faces, faces - low) if low else faces]
    return numbers


def _number(part: MeshPart, places: PartPlaces, first: int, last: int) -> IntArray:
    """Return the numbers of a run of vertices in the whole mesh, -1 for dropped ones."""
    if first >= last:
        return np.empty(0, np.int64)
    starts = starts_of(part.vertex_counts)
    low = int(np.searchsorted(starts, first, side="right")) - 1
    high = int(np.searchsorted(starts, last, side="left"))
    # (k,): from a row of the part to a number of the mesh, brick by brick, as if none of the part's
    # vertices was dropped; those that are, are counted off below.
    shift = places.vertex_starts[low:high] - starts[low:high]
    shift += np.searchsorted(places.dropped, starts[low:high])
    shifts = np.repeat(shift, part.vertex_counts[low:high])
    numbers: IntArray = shifts[first - starts[low] : last - starts[low]]
    numbers += np.arange(first, last)
    if len(places.dropped):
        begin, end = np.searchsorted(places.dropped, [first, last]).tolist()
        is_dropped = np.zeros(last - first, np.bool_)
        is_dropped[places.dropped[begin:end] - first] = True
        numbers -= begin + np.cumsum(is_dropped)
        numbers[is_dropped] = -1
    return numbers
