"""Packed points in the order of the finest cells that they lie in, as a tile holds them.

::

    blocks of a cloud ── those in wanted coarse cells, sorted ──> 28 bytes a point
                            │ some cells of them, when they are asked for
                            └──> positions and normals: 48 bytes, bit for bit those of the cloud

The functions of arrays are kernels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpcapp import kernels
from hpcapp.applications.surface.cloud.arrangement import (
    Arrangement,
    PackedPoints,
    unpacking_arguments,
)
from hpcapp.geometry.points import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from hpcapp.kernels.types.grid import Grid
from hpccomponent.dataclass import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class PackedRows:
    """Packed points in the order of their cells; see `cell_points.CellRows`.

    `records` (n, 6) are the offset of each point within its block, in blocks, and its normal;
    `blocks` (n,) tells where the corner of its block stands among `corners` (b, 3), in length units
    of the input, and `edge` is that of a block.
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
        return kernels.place_packed(*given)

    def take(self, rows: IntArray) -> PackedRows:
        """See `cell_points.CellRows`."""
        return PackedRows(self.records[rows], self.blocks[rows], self.corners, self.edge)

    def seed_bricks(self, grid: Grid, offsets: IntArray, wanted: BoolArray) -> IntArray:
        """See `cell_points.CellRows`."""
        packed = self.records, self.blocks, self.corners, self.edge
        return kernels.seed_packed(*packed, offsets, wanted, grid)


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

    Return the sorted keys (c,) of the occupied finest cells; offsets (c + 1,): cell i holds the
    points offsets[i] to offsets[i + 1]; these points, within a cell in their order; and the number
    (c,) of the coarse cell that each finest one lies in.
    """
    records, counts, corners, edge = unpacking_arguments(arrangement, packed)
    lattice = origin, cell_size, depth, wanted, numbers
    cells, offsets, taken, blocks, groups = kernels.sort_packed(
        records, counts, corners, edge, *lattice
    )
    return cells, offsets, PackedRows(taken, blocks, corners, edge), groups
