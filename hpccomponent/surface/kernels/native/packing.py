"""Points that are packed by blocks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.kernels.native.arrays import integers, native
from hpccomponent.surface.types.grid import BRICK, Grid
from hpccomponent.surface.types.points import (
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

Blocks = NDArray[np.uint32]


def pack_records(
    positions: FloatArray, normals: FloatArray, origin: FloatArray, edge: float
) -> tuple[IntArray, IntArray, Float32Array]:
    """Sort points by blocks and pack them."""
    result: tuple[IntArray, IntArray, Float32Array] = native.pack_records(
        positions, normals, origin, edge
    )
    return result


def unpack_records(
    records: Float32Array, counts: IntArray, corners: FloatArray, edge: float
) -> tuple[FloatArray, FloatArray]:
    """Return the positions and normals of points that were packed."""
    result: tuple[FloatArray, FloatArray] = native.unpack_records(records, counts, corners, edge)
    return result


def unpack_within(
    records: Float32Array,
    counts: IntArray,
    corners: FloatArray,
    edge: float,
    low: FloatArray,
    high: FloatArray,
) -> tuple[FloatArray, IntArray]:
    """Return the packed positions in a box, and which they are."""
    result: tuple[FloatArray, IntArray] = native.unpack_within(
        records, counts, corners, edge, low, high
    )
    return result


def count_packed(
    records: Float32Array,
    counts: IntArray,
    corners: FloatArray,
    edge: float,
    origin: FloatArray,
    cell_size: float,
) -> tuple[IntArray, IntArray]:
    """Count packed points in the occupied cells of a lattice."""
    result: tuple[IntArray, IntArray] = native.count_packed(
        records, counts, corners, edge, origin, cell_size
    )
    return result


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
    """Sort packed points by the finest cell."""
    result: tuple[IntArray, IntArray, Float32Array, Blocks, ByteArray] = native.sort_packed(
        records, counts, corners, edge, origin, cell_size, depth, wanted, numbers
    )
    return result


def place_packed(
    records: Float32Array,
    blocks: NDArray[np.uint32],
    corners: FloatArray,
    edge: float,
    origin: FloatArray,
    cell_size: float,
) -> tuple[FloatArray, FloatArray]:
    """Return packed points relative to the centres of their cells."""
    result: tuple[FloatArray, FloatArray] = native.place_packed(
        records, blocks, corners, edge, origin, cell_size
    )
    return result


def seed_packed(
    records: Float32Array,
    blocks: NDArray[np.uint32],
    corners: FloatArray,
    edge: float,
    offsets: IntArray,
    wanted: BoolArray,
    grid: Grid,
) -> IntArray:
    """Return the bricks that hold a point in some cells."""
    held = (records, blocks, corners, edge, offsets, wanted)
    result: IntArray = native.seed_packed(
        *held, grid.origin, BRICK * grid.step, integers(grid.bricks)
    )
    return result
