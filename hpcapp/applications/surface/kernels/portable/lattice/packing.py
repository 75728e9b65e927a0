"""Packed points: sorted, counted, unpacked and placed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface.kernels.constants import QUANTA
from hpcapp.applications.surface.kernels.portable.lattice.points import sort_points
from hpcapp.applications.surface.kernels.portable.surface.bricks import seed_bricks
from hpcapp.applications.surface.types.grid import Grid
from hpcapp.geometry.lattice import (
    cells_of,
    find_keys,
    merge_counts,
    pack_places,
    unique_keys,
)
from hpcapp.geometry.points import (
    BoolArray,
    ByteArray,
    Float32Array,
    FloatArray,
    IntArray,
)

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
    """Sort points by blocks and pack them.

    Parameters
    ----------
    positions, normals : ndarray of float64, shape (n, 3)
    origin : ndarray of float64, shape (3,)

    Returns
    -------
    keys, counts : ndarray of int64, shape (b,)
        Of the blocks, sorted.
    records : ndarray of float32, shape (n, 6)
        Offset and normal of each point; within a block the points keep their order. Offsets are
        the middles of 2^23 quanta along a block.
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
    """Return the positions and normals of points that were packed.

    Parameters
    ----------
    records : ndarray of float32, shape (n, 6)
        Offset and normal of each point, block after block.
    counts : ndarray of int64, shape (b,)
        Points in each block.
    corners : ndarray of float64, shape (b, 3)
        Of the blocks, in length units of the input.
    edge : float
        Of a block, likewise.

    Returns
    -------
    positions, normals : ndarray of float64, shape (n, 3)
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
    """Return the packed positions in a box, and which they are.

    Parameters
    ----------
    low, high : ndarray of float64, shape (3,)
        Corners of the box, which belong to it; in length units of the input.

    Returns
    -------
    positions : ndarray of float64, shape (m, 3)
    rows : ndarray of int64, shape (m,)
        Rising.
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
    """Count packed points in the occupied cells of a lattice.

    Parameters
    ----------
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
    """Sort packed points by the finest cell, as `packed_cells.sort_tile` describes.

    Parameters
    ----------
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

    Returns
    -------
    cells : ndarray of int64, shape (c,)
        Sorted keys of the occupied finest cells.
    offsets : ndarray of int64, shape (c + 1,)
        Cell i holds the points offsets[i] to offsets[i + 1].
    taken : ndarray of float32, shape (m, 6)
        The records of these points.
    blocks : ndarray of uint32, shape (m,)
        The block that each lies in: a row of `corners`.
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
    """Return packed points relative to the centres of their cells.

    Parameters
    ----------
    origin, cell_size
        See `points.gather_points`, whose results these are.

    Returns
    -------
    local, normals : ndarray of float64, shape (n, 3)
        The positions in cells.
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
    """Return the bricks that hold a point in some cells.

    Parameters
    ----------
    offsets : ndarray of int64, shape (c + 1,)
        Cell i holds the points offsets[i] to offsets[i + 1].
    wanted : ndarray of bool, shape (c,)
        Which cells.

    Returns
    -------
    ndarray of int64, shape (b,)
        Sorted, unique keys.
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
