"""Packed points: sorted, counted, unpacked and placed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.lattice import cells_of, find_keys, merge_counts, pack_places, unique_keys
from hpcapp.geometry.points import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from hpcapp.kernels.constants import QUANTA
from hpcapp.kernels.portable.lattice.points import sort_points
from hpcapp.kernels.portable.surface.bricks import seed_bricks
from hpcapp.kernels.types.grid import Grid

__all__ = [
    "count_packed",
    "pack_records",
    "place_packed",
    "seed_packed",
    "sort_packed",
    "unpack_records",
    "unpack_within",
]

_ROWS_AT_ONCE = 1 << 14  # what is made of them stays in the cache


def pack_records(
    positions: FloatArray, normals: FloatArray, origin: FloatArray, edge: float
) -> tuple[IntArray, IntArray, Float32Array]:
    """Sort points (n, 3) by blocks and pack them.

    Corner (0, 0, 0) of the blocks lies at `origin` (3,). Return their sorted keys and counts (b,),
    and records (n, 6): the offset and normal of each point, which keep their order within a block.
    Offsets are the middles of 2^23 quanta along a block.
    """
    keys, offsets, rows = sort_points(positions, origin, edge)
    records = np.empty((len(rows), 6), np.float32)
    for start in range(0, len(rows), _ROWS_AT_ONCE):
        chunk = slice(start, start + _ROWS_AT_ONCE)
        places = (positions[chunk] - origin) / edge
        quanta = np.floor((places - np.floor(places)) * QUANTA)
        records[chunk, :3] = (quanta + 0.5) / QUANTA  # 0 to 1 within the block
        records[chunk, 3:] = normals[chunk]
    return keys, np.diff(offsets), records.take(rows, axis=0)


def unpack_records(
    records: Float32Array, counts: IntArray, corners: FloatArray, edge: float
) -> tuple[FloatArray, FloatArray]:
    """Return the positions and normals (n, 3) of points that were packed.

    Records (n, 6) are the offset and normal of each point, block after block; each block, of that
    edge, holds `counts` (b,) points, and has its corner at `corners` (b, 3).
    """
    block_of = np.repeat(np.arange(len(corners)), counts)
    positions = np.empty((len(block_of), 3))
    for start in range(0, len(block_of), _ROWS_AT_ONCE):
        chunk = slice(start, start + _ROWS_AT_ONCE)
        part = positions[chunk]
        np.multiply(records[chunk, :3], edge, out=part, dtype=np.float64)
        part += corners.take(block_of[chunk], axis=0)
    return positions, records[:, 3:].astype(np.float64)


def unpack_within(
    records: Float32Array,
    counts: IntArray,
    corners: FloatArray,
    edge: float,
    low: FloatArray,
    high: FloatArray,
) -> tuple[FloatArray, IntArray]:
    """Return the packed positions (m, 3) in a box, and their rows (m,), rising.

    The corners of the box, `low` and `high` (3,), belong to it.
    """
    positions, _ = unpack_records(records, counts, corners, edge)
    rows = np.flatnonzero(((positions >= low) & (positions <= high)).all(axis=1))
    return positions[rows], rows


def count_packed(
    records: Float32Array,
    counts: IntArray,
    corners: FloatArray,
    edge: float,
    origin: FloatArray,
    cell_size: float,
) -> tuple[IntArray, IntArray]:
    """Count packed points in the occupied cells of a lattice: sorted keys and counts, (c,).

    `origin` (3,) is the corner of a cell. Cells are to be few.
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
    """Sort packed points by the finest cell, as `packed_cells.sort_tile` describes.

    Corner (0, 0, 0) of the lattice lies at `origin` (3,), and `cell_size` is that of finest cells.
    `wanted` (w,) are sorted keys of coarse cells, so many levels further up, with `numbers` (w,).

    Returns
    -------
    cells : ndarray of int64, shape (c,)
        Sorted keys of the occupied finest cells.
    offsets : ndarray of int64, shape (c + 1,)
        Cell i holds the points offsets[i] to offsets[i + 1].
    taken, blocks : ndarray of float32, shape (m, 6), and of uint32, shape (m,)
        The records of these points, and the block that each lies in: a row of `corners`.
    groups : ndarray of uint8, shape (c,)
        The number of the coarse cell that each lies in.
    """
    positions, _ = unpack_records(records, counts, corners, edge)
    places = np.floor(cells_of(positions, origin, cell_size)).astype(np.int64)
    coarse = find_keys(wanted, pack_places(places >> depth))  # (n,): of each point's coarse cell
    kept = np.flatnonzero(coarse < len(wanted))
    keys = pack_places(places[kept])
    order = np.argsort(keys, kind="stable")
    cells, rows = unique_keys(keys), kept[order]  # (c,) and (m,): cells, and points by cell
    starts = np.searchsorted(keys[order], cells)
    block_of = np.repeat(np.arange(len(counts), dtype=np.uint32), counts)
    groups = numbers[coarse[rows[starts]]]
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
    """Return packed points relative to the centres of their cells, and their normals, both (n, 3).

    Positions are in cells; `origin` and `cell_size` are as for `points.gather_points`.
    """
    places = cells_of(_unpack_rows(records, blocks, corners, edge), origin, cell_size)
    return places - np.floor(places) - 0.5, records[:, 3:].astype(np.float64)


def seed_packed(
    records: Float32Array,
    blocks: NDArray[np.uint32],
    corners: FloatArray,
    edge: float,
    offsets: IntArray,
    wanted: BoolArray,
    grid: Grid,
) -> IntArray:
    """Return the bricks that hold a point in cells that are wanted, (c,): sorted, unique keys (b,).

    By `offsets` (c + 1,), cell i holds the points offsets[i] to offsets[i + 1].
    """
    rows = np.flatnonzero(np.repeat(wanted, np.diff(offsets)))
    return seed_bricks(grid, _unpack_rows(records[rows], blocks[rows], corners, edge))


def _unpack_rows(
    records: Float32Array, blocks: NDArray[np.uint32], corners: FloatArray, edge: float
) -> FloatArray:
    """Return the positions of packed points, which stand in any order."""
    positions: FloatArray = np.multiply(records[:, :3], edge, dtype=np.float64)
    positions += corners[blocks]
    return positions
