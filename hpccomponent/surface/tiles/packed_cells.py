"""Packed points in the order of the finest cells that they lie in, as a tile holds them.

::

    blocks of a cloud ── those in wanted coarse cells, sorted ──> 28 bytes a point
                            │ some cells of them, when they are asked for
                            └──> positions and normals: 48 bytes, bit for bit those of the cloud

The functions of arrays are kernels. Who may import it: the tasks of a tile, and those of blocks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.build import load_native
from hpccomponent.surface.cloud.arrangement import (
    Arrangement,
    PackedPoints,
    unpack_records,
    unpacking_arguments,
)
from hpccomponent.surface.extraction import bricks
from hpccomponent.surface.fitting.field import BRICK, Grid
from hpccomponent.surface.types.lattice import (
    cells_of,
    find_keys,
    merge_counts,
    pack_places,
    unique_keys,
)
from hpccomponent.surface.types.points import FloatArray, IntArray

__all__ = ["PackedRows", "count_packed", "count_points", "place_packed", "sort_packed", "sort_tile"]

BoolArray = NDArray[np.bool_]
ByteArray = NDArray[np.uint8]
Float32Array = NDArray[np.float32]

_native: Any = load_native()


@dataclass(frozen=True, slots=True, eq=False)
class PackedRows:
    """Packed points in the order of their cells; see `cell_points.CellRows`.

    Parameters
    ----------
    records : ndarray of float32, shape (n, 6)
        Offset within its block, in blocks, and normal of each point.
    blocks : ndarray of uint32, shape (n,)
        Where the corner of each point's block stands.
    corners : ndarray of float64, shape (b, 3)
        Of the blocks, in length units of the input.
    edge : float
        Of a block, likewise.
    """

    records: Float32Array
    blocks: NDArray[np.uint32]
    corners: FloatArray
    edge: float

    def __len__(self) -> int:
        return len(self.records)

    def place(
        self, rows: slice, origin: FloatArray, cell_size: float
    ) -> tuple[FloatArray, FloatArray]:
        """See `cell_points.CellRows`."""
        given = self.records[rows], self.blocks[rows], self.corners, self.edge, origin, cell_size
        place = place_packed if _native is None else _native.place_packed
        placed: tuple[FloatArray, FloatArray] = place(*given)
        return placed

    def seed_bricks(self, grid: Grid, offsets: IntArray, wanted: BoolArray) -> IntArray:
        """See `cell_points.CellRows`."""
        if _native is None:
            rows = np.flatnonzero(np.repeat(wanted, np.diff(offsets)))
            positions = _unpack_rows(self.records[rows], self.blocks[rows], self.corners, self.edge)
            return bricks.seed_bricks(grid, positions)
        given = self.records, self.blocks, self.corners, self.edge, offsets, wanted
        sides = np.array(grid.bricks, np.int64)
        seeds: IntArray = _native.seed_packed(*given, grid.origin, BRICK * grid.step, sides)
        return seeds


def sort_tile(
    arrangement: Arrangement,
    packed: PackedPoints,
    origin: FloatArray,
    cell_size: float,
    depth: int,
    wanted: IntArray,
    numbers: ByteArray,
) -> tuple[IntArray, IntArray, PackedRows, ByteArray]:
    """Sort those of some packed points that lie in some coarse cells by the finest cells.

    Parameters
    ----------
    arrangement : Arrangement
    packed : PackedPoints
    origin, cell_size, depth, wanted, numbers
        See `sort_packed`.

    Returns
    -------
    cells : ndarray of int64, shape (c,)
        Sorted keys of the occupied finest cells.
    offsets : ndarray of int64, shape (c + 1,)
        Cell i holds the points offsets[i] to offsets[i + 1].
    rows : PackedRows
        Within a cell the points keep their order.
    groups : ndarray of uint8, shape (c,)
        The number of the coarse cell that each lies in.
    """
    sort = sort_packed if _native is None else _native.sort_packed
    records, counts, corners, edge = unpacking_arguments(arrangement, packed)
    lattice = origin, cell_size, depth, wanted, numbers
    cells, offsets, taken, blocks, groups = sort(records, counts, corners, edge, *lattice)
    return cells, offsets, PackedRows(taken, blocks, corners, edge), groups


def count_points(
    arrangement: Arrangement, packed: PackedPoints, origin: FloatArray, cell_size: float
) -> tuple[IntArray, IntArray]:
    """Count packed points in the occupied cells of a lattice.

    Parameters
    ----------
    arrangement : Arrangement
    packed : PackedPoints
    origin, cell_size
        See `count_packed`, whose results these are.
    """
    count = count_packed if _native is None else _native.count_packed
    counted: tuple[IntArray, IntArray] = count(
        *unpacking_arguments(arrangement, packed), origin, cell_size
    )
    return counted


def count_packed(
    records: Float32Array,
    counts: IntArray,
    corners: FloatArray,
    edge: float,
    origin: FloatArray,
    cell_size: float,
) -> tuple[IntArray, IntArray]:
    """Count packed points in the occupied cells of a lattice, in numpy.

    Parameters
    ----------
    records, counts, corners, edge
        See `arrangement.unpack_records`.
    origin : ndarray of float64, shape (3,)
        Corner of a cell.
    cell_size : float
        In length units of the input. Cells are to be few.

    Returns
    -------
    cells, counts : ndarray of int64, shape (c,)
        Sorted keys, and the points in each.
    """
    positions, _ = unpack_records(records, counts, corners, edge)
    keys = pack_places(np.floor(cells_of(positions, origin, cell_size)).astype(np.int64))
    return merge_counts(keys, np.ones(len(keys), np.int64))


def sort_packed(
    records: Float32Array,
    counts: IntArray,
    corners: FloatArray,
    edge: float,
    origin: FloatArray,
    cell_size: float,
    depth: int,
    wanted: IntArray,
    numbers: ByteArray,
) -> tuple[IntArray, IntArray, Float32Array, NDArray[np.uint32], ByteArray]:
    """Sort packed points by the finest cell, in numpy; see `sort_tile`, whose results these are.

    Parameters
    ----------
    records, counts, corners, edge
        See `arrangement.unpack_records`.
    origin : ndarray of float64, shape (3,)
        Where corner (0, 0, 0) of the lattice lies.
    cell_size : float
        Of the finest cells, in length units of the input.
    depth : int
        So many levels further up are the coarse cells.
    wanted : ndarray of int64, shape (w,)
        Sorted keys of coarse cells.
    numbers : ndarray of uint8, shape (w,)
        A number of each.
    """
    positions, _ = unpack_records(records, counts, corners, edge)
    places = np.floor(cells_of(positions, origin, cell_size)).astype(np.int64)
    found = find_keys(wanted, pack_places(places >> depth))
    kept = np.flatnonzero(found < len(wanted))
    keys = pack_places(places[kept])
    order = np.argsort(keys, kind="stable")
    cells, rows = unique_keys(keys), kept[order]
    starts = np.searchsorted(keys[order], cells)
    block_of = np.repeat(np.arange(len(counts), dtype=np.uint32), counts)
    groups = numbers[found[rows[starts]]]
    offsets = np.append(starts, len(rows)).astype(np.int64)
    return cells, offsets, records[rows], block_of[rows], groups


def place_packed(
    records: Float32Array,
    blocks: NDArray[np.uint32],
    corners: FloatArray,
    edge: float,
    origin: FloatArray,
    cell_size: float,
) -> tuple[FloatArray, FloatArray]:
    """Return packed points relative to the centres of their cells, in numpy.

    Parameters
    ----------
    records, blocks, corners, edge
        See `PackedRows`.
    origin, cell_size
        See `cells.gather_points`, whose results these are.
    """
    places = cells_of(_unpack_rows(records, blocks, corners, edge), origin, cell_size)
    return places - np.floor(places) - 0.5, records[:, 3:].astype(np.float64)


def _unpack_rows(
    records: Float32Array, blocks: NDArray[np.uint32], corners: FloatArray, edge: float
) -> FloatArray:
    """Return the positions of packed points, which stand in any order."""
    positions: FloatArray = np.multiply(records[:, :3], edge, dtype=np.float64)
    positions += corners[blocks]
    return positions
