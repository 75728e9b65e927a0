"""The tiles of a cloud that is not in memory: the same points, read when a tile is asked for.

Who may import it: the default method.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface.tiles import Tiling, cut_tiles, halo_cells
from hpccomponent.surface import kernels
from hpccomponent.surface.arranged_cloud import ArrangedCloud
from hpccomponent.surface.arrangement import PackedPoints, pack_points
from hpccomponent.surface.lattice import cells_of, find_keys, pack_places, unique_keys, unpack_keys
from hpccomponent.surface.points import FloatArray, IntArray
from hpccomponent.surface.region import Plan

__all__ = ["DiskTiling"]

_POINTS_AT_ONCE = 1 << 21
_SLACK = 1e-9  # of a box's edge: what rounding may put on its other side


class DiskTiling(Tiling):
    """An arranged cloud, wherever it lies, cut into the tiles of `Tiling`.

    Parameters
    ----------
    cloud : ArrangedCloud
    plan : Plan
    count : int
        How many tiles there shall be; fewer where there are fewer coarse cells.
    """

    def __init__(self, cloud: ArrangedCloud, plan: Plan, count: int) -> None:
        self._arranged = cloud
        self._plan = plan
        self._size = plan.cell_size * 2.0**plan.coarse
        self.cells, counts = self._count_cells()
        self._tile_of = cut_tiles(self.cells, counts, count)
        self._halo = halo_cells(plan)

    def take(self, chosen: NDArray[np.bool_]) -> PackedPoints:
        """See `Tiling.take`; blocks that reach into the chosen cells are read for it."""
        cells = self.cells[chosen]
        if not len(cells):
            return super().take(chosen)
        positions, normals = self._arranged.take_blocks(self._find_blocks(cells))
        own = find_keys(cells, self._cells_of(positions)) < len(cells)
        return pack_points(self._plan.arrangement, positions[own], normals[own])

    def _count_cells(self) -> tuple[IntArray, IntArray]:
        """Return the coarse cells that hold points, and how many."""
        found = []
        for positions, _ in self._arranged.groups(_POINTS_AT_ONCE):
            keys, offsets, _ = kernels.sort_points(positions, self._plan.origin, self._size)
            found.append((keys, np.diff(offsets)))
        every, counts = (np.concatenate(columns) for columns in zip(*found, strict=True))
        keys = unique_keys(every)
        summed = np.bincount(np.searchsorted(keys, every), counts, len(keys))
        return keys, summed.astype(np.int64)

    def _cells_of(self, positions: FloatArray) -> IntArray:
        places = np.floor(cells_of(positions, self._plan.origin, self._size))
        return pack_places(places.astype(np.int64))

    def _find_blocks(self, cells: IntArray) -> IntArray:
        """Return the blocks that have space in common with some cells, and perhaps neighbours."""
        blocks = self._arranged.arrangement
        cell_lattice = self._plan.origin, self._size
        block_lattice = blocks.origin, blocks.edge
        if self._size <= blocks.edge:
            return unique_keys(_cover(cells, cell_lattice, block_lattice).reshape(-1))
        held = self._arranged.keys
        covered = _cover(held, block_lattice, cell_lattice)
        return held[(find_keys(cells, covered) < len(cells)).any(axis=1)]


def _cover(
    keys: IntArray, lattice: tuple[FloatArray, float], other: tuple[FloatArray, float]
) -> IntArray:
    """Return the places of a lattice, of boxes as large or larger, that some boxes reach into.

    Each lattice is its corner and its edge.

    Returns
    -------
    ndarray of int64, shape (n, 27)
    """
    (corner, edge), (other_corner, other_edge) = lattice, other
    places = unpack_keys(keys)
    at = [np.array(steps) for steps in product((-_SLACK, 0.5, 1.0 + _SLACK), repeat=3)]
    points = corner + edge * (places[:, None] + np.stack(at))
    return pack_places(np.floor(cells_of(points, other_corner, other_edge)).astype(np.int64))
