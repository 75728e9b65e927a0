"""What is known of the points in the cells of a level: the points themselves, or their moments.

A row of moments is larger than a handful of points. So the finest level has none: moments are
summed where a batch needs them, and only for the cells of that batch. Those of the level above
it, which has most of the rest, are kept in single precision; of every other level in double.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hpcapp import kernels
from hpcapp.geometry.lattice import BITS, ancestor_keys, number_keys, unique_keys
from hpcapp.geometry.points import BoolArray, Float32Array, FloatArray, IntArray, PointCloud
from hpcapp.kernels import COLUMNS
from hpcapp.kernels.parallel import run_batches
from hpcapp.kernels.types.grid import Grid
from hpccomponent.dataclass import dataclass

_SLAB = 1 << 11  # cells whose moments are summed at once: 0.7 MB, which stays in the cache
_AT_ONCE = 64  # slabs whose sums wait to be put together


@dataclass(frozen=True, slots=True, eq=False)
class CellMoments:
    """The moments of each cell of a level.

    Each of the `pieces` (k, 44) is of some cells, one piece after the other: about the centres of
    the cells, in their units. They are of some megabytes and lie where other arrays have been: in
    one piece the moments of a tile would find no place there that is large enough.
    """

    pieces: list[FloatArray | Float32Array]

    @property
    def counts(self) -> FloatArray:
        """Points in each cell."""
        counts = [np.empty(0), *(piece[:, 0] for piece in self.pieces)]
        return np.concatenate(counts, dtype=np.float64)

    def sum(self, cells: slice) -> FloatArray:
        """Return the moments of a run of cells, which has a start and a stop: (k, 44)."""
        pieces: list[FloatArray | Float32Array] = [np.empty((0, COLUMNS))]
        start = 0
        for piece in self.pieces:
            first, stop = max(cells.start - start, 0), min(cells.stop - start, len(piece))
            if first < stop:
                pieces.append(piece[first:stop])
            start += len(piece)
        if len(pieces) == 2:
            return pieces[1].astype(np.float64, copy=False)
        return np.concatenate(pieces, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class PartMoments:
    """The moments of each cell of a level, as several have found them: of some cells each.

    Put together they would be as much memory again. Of the `parts` (k, 44), `rows` (k,) are the
    cells of each, sorted; every cell is in one of them.
    """

    parts: list[FloatArray]
    rows: list[IntArray]

    @property
    def counts(self) -> FloatArray:
        """Points in each cell."""
        counts = np.empty(sum(map(len, self.rows)))
        for moments, rows in zip(self.parts, self.rows, strict=True):
            counts[rows] = moments[:, 0]
        return counts

    def sum(self, cells: slice) -> FloatArray:
        """Return the moments of a run of cells, which has a start and a stop: (k, 44)."""
        sums = np.empty((cells.stop - cells.start, COLUMNS))
        for moments, rows in zip(self.parts, self.rows, strict=True):
            first, end = np.searchsorted(rows, (cells.start, cells.stop))
            sums[rows[first:end] - cells.start] = moments[first:end]
        return sums


class CellRows(Protocol):
    """Points in the order of their cells, wherever they are held: here, or packed."""

    def __len__(self) -> int: ...

    def place(
        self, rows: slice, origin: FloatArray, cell_size: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return positions relative to the centres of their cells, in cells, and normals."""

    def take(self, rows: IntArray) -> CellRows:
        """Return some of the points, in another order."""

    def seed_bricks(self, grid: Grid, offsets: IntArray, wanted: BoolArray) -> IntArray:
        """Return the sorted, unique keys (b,) of bricks with a point of the `wanted` cells (c,).

        Cell i holds the points offsets[i] to offsets[i + 1], and these are all.
        """


@dataclass(frozen=True, slots=True, eq=False)
class CloudRows:
    """`CellRows` of a cloud with normals: its `rows` (n,), in the order of their cells."""

    cloud: PointCloud
    rows: NDArray[np.uint32]

    def __len__(self) -> int:
        return len(self.rows)

    def place(
        self, rows: slice, origin: FloatArray, cell_size: float
    ) -> tuple[FloatArray, FloatArray]:
        """See `CellRows`."""
        positions, normals = self.cloud.positions, self.cloud.normals
        assert normals is not None  # noqa: S101 - checked by the method, at its border
        return kernels.gather_points(positions, normals, self.rows[rows], origin, cell_size)

    def take(self, rows: IntArray) -> CellRows:
        """See `CellRows`."""
        return CloudRows(self.cloud, self.rows[rows])

    def seed_bricks(self, grid: Grid, offsets: IntArray, wanted: BoolArray) -> IntArray:
        """See `CellRows`."""
        rows = self.rows[np.repeat(wanted, np.diff(offsets))]
        return kernels.seed_bricks(grid, self.cloud.positions.take(rows, axis=0))


@dataclass(frozen=True, slots=True, eq=False)
class SortedPoints:
    """The points of each cell of the finest level.

    Cell i holds those from offsets[i] to offsets[i + 1]; what is `held` may have points of other
    cells, too. Corner (0, 0, 0) of the lattice lies at `origin` (3,); by `weights` (n,) points do
    not count alike.
    """

    held: CellRows
    origin: FloatArray
    cell_size: float
    offsets: IntArray
    weights: FloatArray | None = None

    @property
    def counts(self) -> FloatArray:
        """Points in each cell."""
        return np.diff(self.offsets).astype(np.float64)

    def sum(self, cells: slice) -> FloatArray:
        """Return the moments of a run of cells, which has a start and a stop: (k, 44)."""
        local, normals, offsets = self.place(cells)
        start, stop = self.offsets[cells.start], self.offsets[cells.stop]
        weights = None if self.weights is None else self.weights[start:stop]
        return kernels.accumulate_moments(local, normals, offsets, weights)

    def run(self, cells: slice) -> SortedPoints:
        """Return the points in a run of cells alone; nothing is copied."""
        return replace(self, offsets=self.offsets[cells.start : cells.stop + 1])

    def gather(self, rows: IntArray, cells: IntArray, depth: int) -> tuple[IntArray, SortedPoints]:
        """Sort the points of the cells in `rows` (k,) by larger ones that these lie in.

        `cells` (c,) are the keys of all; the larger ones are halved `depth` times for these. Return
        the sorted keys (p,) of the larger ones, and the points in them.
        """
        larger, number = number_keys(ancestor_keys(cells[rows], depth))
        order = np.argsort(number, kind="stable")
        starts, counts = self.offsets[rows][order], np.diff(self.offsets)[rows][order]
        ends = np.cumsum(counts)
        # (m,): each point's row, cell after cell
        held = np.arange(int(counts.sum())) + np.repeat(starts - (ends - counts), counts)
        of_larger = np.bincount(number[order], counts, len(larger)).astype(np.int64)
        offsets = np.append(0, np.cumsum(of_larger))
        size = self.cell_size * 2.0**depth
        return larger, SortedPoints(self.held.take(held), self.origin, size, offsets)

    def place(self, cells: slice) -> tuple[FloatArray, FloatArray, IntArray]:
        """Return the points (n, 3) in a run of cells, their normals (n, 3), and offsets (k + 1,).

        Points are relative to the centre of their cell, in cells; cell i of the run holds those
        from offsets[i] to offsets[i + 1].
        """
        offsets = self.offsets[cells.start : cells.stop + 1]
        rows = slice(int(offsets[0]), int(offsets[-1]))
        local, normals = self.held.place(rows, self.origin, self.cell_size)
        return local, normals, offsets - offsets[0]


def sort_cloud(
    cloud: PointCloud, origin: FloatArray, cell_size: float
) -> tuple[IntArray, SortedPoints]:
    """Sort points with normals by the cell that they lie in; return the cells' sorted keys too."""
    cells, offsets, rows = kernels.sort_points(cloud.positions, origin, cell_size)
    return cells, SortedPoints(CloudRows(cloud, rows), origin, cell_size, offsets)


def merge_parents(
    cells: IntArray, points: SortedPoints | CellMoments | PartMoments, threads: int = 1
) -> tuple[IntArray, CellMoments]:
    """Sum the moments of the parents of a level's cells (c,), which are sorted keys.

    Return the parents' sorted keys (p,), and moments, which are rounded to float32 where `points`
    are those of the finest level.
    """
    rounded = isinstance(points, SortedPoints)
    slabs = _cut_slabs(cells, max(threads, -(-len(cells) // _SLAB)))
    parents: list[IntArray] = []
    pieces: list[FloatArray | Float32Array] = []
    for start in range(0, len(slabs), _AT_ONCE):
        merged = run_batches(
            lambda slab: kernels.merge_cells(cells[slab], points.sum(slab)),
            slabs[start : start + _AT_ONCE],
            threads,
        )
        parents += [keys for keys, _ in merged]
        sums = [moments for _, moments in merged]
        pieces.append(_put_together(sums, rounded))
    return np.concatenate(parents), CellMoments(pieces)


def _put_together(sums: list[FloatArray], rounded: bool) -> FloatArray | Float32Array:
    """Join moments of runs of cells, in single precision if asked for."""
    if rounded:
        return np.concatenate(sums, dtype=np.float32, casting="same_kind")
    return np.concatenate(sums)


def _cut_slabs(cells: IntArray, parts: int) -> list[slice]:
    """Cut sorted cells into about so many runs that part no children of one parent.

    The slowest coordinate of a key is x: between two layers of parents lies no parent.
    """
    layers = np.flatnonzero(np.diff(cells >> (2 * BITS + 1))) + 1
    # Where equal runs would end; each run goes on to the end of its layer of parents.
    wanted = np.arange(1, parts) * len(cells) // parts
    cuts = unique_keys(np.append(layers, len(cells))[np.searchsorted(layers, wanted)])
    bounds = [0, *cuts[cuts < len(cells)].tolist(), len(cells)]
    return [slice(a, b) for a, b in pairwise(bounds)]
