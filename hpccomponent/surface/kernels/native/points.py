"""Points and the cells that they lie in: boxes, counts, sorting, normals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.kernels.native.arrays import floats, integers, native, singles
from hpccomponent.surface.types.points import (
    ByteArray,
    Float32Array,
    FloatArray,
    Int32Array,
    IntArray,
)

__all__ = [
    "bound_points",
    "count_boxes",
    "count_cells",
    "gather_points",
    "label_cells",
    "poll_normals",
    "sample_boxes",
    "sort_points",
    "sum_neighbours",
    "take_cells",
]


def bound_points(positions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the corners of the box around some points."""
    bounds: tuple[FloatArray, FloatArray] = native.bound_points(floats(positions))
    return bounds


def count_boxes(
    positions: FloatArray, low: FloatArray, edge: float, one_in: int
) -> tuple[int, int]:
    """Count points and occupied boxes over a sample of the boxes."""
    counts: tuple[int, int] = native.count_boxes(floats(positions), floats(low), edge, one_in)
    return counts


def sample_boxes(positions: FloatArray, low: FloatArray, edge: float, one_in: int) -> IntArray:
    """Return the points in a sample of boxes."""
    rows: IntArray = native.sample_boxes(floats(positions), floats(low), edge, one_in)
    return rows


def count_cells(
    positions: FloatArray, low: FloatArray, edge: float
) -> tuple[IntArray, IntArray, IntArray]:
    """Count the points in each occupied cell."""
    result: tuple[IntArray, IntArray, IntArray] = native.count_cells(
        floats(positions), floats(low), edge
    )
    return result


def sum_neighbours(keys: IntArray, values: IntArray, wanted: IntArray) -> IntArray:
    """Sum values over the 27 cells around some cells."""
    result: IntArray = native.sum_neighbours(integers(keys), integers(values), integers(wanted))
    return result


def label_cells(keys: IntArray) -> tuple[int, Int32Array]:
    """Number the pieces of cells that touch."""
    result: tuple[int, Int32Array] = native.label_cells(integers(keys))
    return result


def sort_points(
    positions: FloatArray, origin: FloatArray, cell_size: float
) -> tuple[IntArray, IntArray, NDArray[np.uint32]]:
    """Sort points by the cell that they lie in."""
    result: tuple[IntArray, IntArray, NDArray[np.uint32]] = native.sort_points(
        floats(positions), floats(origin), cell_size
    )
    return result


def gather_points(
    positions: FloatArray,
    normals: FloatArray,
    rows: NDArray[np.uint32],
    origin: FloatArray,
    cell_size: float,
) -> tuple[FloatArray, FloatArray]:
    """Return some points relative to the centres of their cells."""
    points = (floats(positions), floats(normals))
    result: tuple[FloatArray, FloatArray] = native.gather_points(
        *points, rows, floats(origin), cell_size
    )
    return result


def take_cells(
    positions: FloatArray,
    normals: FloatArray,
    origin: FloatArray,
    cell_size: float,
    wanted: IntArray,
    groups: ByteArray,
) -> tuple[FloatArray, FloatArray, ByteArray]:
    """Return the points in some cells."""
    result: tuple[FloatArray, FloatArray, ByteArray] = native.take_cells(
        positions, normals, origin, cell_size, wanted, groups
    )
    return result


def poll_normals(
    positions: FloatArray,
    normals: FloatArray | Float32Array,
    keys: IntArray,
    cell_of: IntArray,
    asked: ByteArray,
    reach: float,
    tolerance: float,
    drift: float,
    threads: int = 1,
) -> ByteArray:
    """Ask the neighbours of each point about its normal."""
    narrow = normals.dtype == np.float32
    points = (floats(positions), singles(normals) if narrow else floats(normals))
    cells = (integers(keys), integers(cell_of))
    lengths = (reach, tolerance, drift)
    result: ByteArray = native.poll_normals(*points, *cells, asked, *lengths, threads)
    return result
