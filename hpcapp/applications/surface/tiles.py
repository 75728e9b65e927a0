"""Tiles: ranges of coarse cells along a Morton curve, equal in estimated work.

The paper's equal batches, by work instead of by count. Who may import it: the default method.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface import kernels
from hpccomponent.surface.arranged_cloud import ArrangedCloud
from hpccomponent.surface.disk_cloud import DiskCloud
from hpccomponent.surface.lattice import BITS, find_keys, unique_keys, unpack_keys
from hpccomponent.surface.points import IntArray
from hpccomponent.surface.reach import HALO_STEPS, surround
from hpccomponent.surface.region import Plan
from hpccomponent.surface.tile_points import CellPoints, pack_cloud, read_cells

__all__ = ["Tiling", "cut_tiles", "halo_cells", "morton_codes"]

_POINTS_AT_ONCE = 2_000_000
_SPREAD = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def morton_codes(keys: IntArray) -> NDArray[np.uint64]:
    """Return where places lie along a Morton curve (z-order).

    Parameters
    ----------
    keys : ndarray of int64, shape (c,)
        Packed places.

    Returns
    -------
    ndarray of uint64, shape (c,)

    References
    ----------
    G. M. Morton, A computer oriented geodetic data base and a new technique in file sequencing,
    IBM, 1966.
    """
    codes = np.zeros(len(keys), np.uint64)
    biased = (unpack_keys(keys) + (1 << (BITS - 1))).astype(np.uint64)
    for axis, column in enumerate(biased.T):
        bits = column
        for shift, mask in _SPREAD:
            bits = (bits | bits << np.uint64(shift)) & np.uint64(mask)
        codes |= bits << np.uint64(axis)
    return codes


class Tiling:
    """A cloud cut into tiles.

    Parameters
    ----------
    cloud : ArrangedCloud
    plan : Plan
    count : int
        How many tiles there shall be; fewer where there are fewer coarse cells.
    share : callable, optional
        What offers a tile's own points to all workers, where they are sent with the tasks.

    Attributes
    ----------
    cells : ndarray of int64, shape (c,)
        Sorted keys of the coarse cells that hold points.
    """

    def __init__(
        self,
        cloud: ArrangedCloud,
        plan: Plan,
        count: int,
        share: Callable[[Any], Any] | None,
    ) -> None:
        self.cells, self._counts = _count_cells(cloud, plan)
        self._cloud = cloud
        self._plan = plan
        self._tile_of = cut_tiles(self.cells, self._counts, count)
        self._share = share
        self._cores: dict[int, Any] = {}

    def __len__(self) -> int:
        return int(self._tile_of.max()) + 1

    def own(self, index: int) -> IntArray:
        """Return the coarse cells of a tile."""
        own: IntArray = self.cells[self._tile_of == index]
        return own

    def core(self, index: int) -> CellPoints:
        """Return the points of a tile, as a task is given them."""
        return self._give([self.own(index)], index)

    def groups(self, index: int) -> list[IntArray]:
        """Return the cells of a tile, and of its halo: those of tiles before and after it."""
        own = self.own(index)
        around = self.near(own)
        before, after = around & (self._tile_of < index), around & (self._tile_of > index)
        return [own, self.cells[before], self.cells[after]]

    def tile(self, index: int) -> CellPoints:
        """Return the points in the `groups` of a tile, as a task is given them."""
        return self._give(self.groups(index), index)

    def around(self, cells: IntArray) -> CellPoints:
        """Return the points in some coarse cells."""
        return self._give([cells], None)

    def near(self, cells: IntArray) -> NDArray[np.bool_]:
        """Tell which coarse cells with points lie around some cells, near enough to matter."""
        reached = surround(cells, halo_cells(self._plan))
        found: NDArray[np.bool_] = np.less(find_keys(reached, self.cells), len(reached))
        return found

    def _give(self, groups: list[IntArray], index: int | None) -> CellPoints:
        if self._share is None:
            there = self._cloud
            return ("there", str(there.folder) if isinstance(there, DiskCloud) else there, *groups)
        plan = self._plan
        clouds = read_cells(self._cloud, plan.origin, plan.coarse_size, groups)
        packed = [pack_cloud(plan.arrangement, cloud) for cloud in clouds]
        if index is not None and not isinstance(self._cloud, DiskCloud):
            packed[0] = self._cores.setdefault(index, self._share(packed[0]))
        return ("sent", *packed)


def _count_cells(cloud: ArrangedCloud, plan: Plan) -> tuple[IntArray, IntArray]:
    """Return the coarse cells that hold points, and how many."""
    keys, counts = [], []
    for positions, _ in cloud.groups(_POINTS_AT_ONCE):
        cells, offsets, _ = kernels.sort_points(positions, plan.origin, plan.coarse_size)
        keys.append(cells)
        counts.append(np.diff(offsets))
    every = unique_keys(np.concatenate(keys))
    rows = np.searchsorted(every, np.concatenate(keys))
    return every, np.bincount(rows, np.concatenate(counts), len(every)).astype(np.int64)


def cut_tiles(cells: IntArray, work: IntArray, count: int) -> IntArray:
    """Cut cells along a Morton curve into runs of equal work.

    Parameters
    ----------
    cells : ndarray of int64, shape (c,)
        Keys of coarse cells.
    work : ndarray of int64, shape (c,)
        Estimated work of each, in any unit: their points.
    count : int
        Of tiles, one or more.

    Returns
    -------
    ndarray of int64, shape (c,)
        The tile of each cell: numbers from 0 on, none left out.
    """
    order = np.argsort(morton_codes(cells))
    before = np.cumsum(work[order]) - 0.5 * work[order]
    wanted = np.floor(before * (count / work.sum())).astype(np.int64)
    tiles = np.empty(len(cells), np.int64)
    tiles[order] = np.unique(np.clip(wanted, 0, count - 1), return_inverse=True)[1]
    return tiles


def halo_cells(plan: Plan) -> int:
    """Return how many coarse cells around a tile its quadrics depend on.

    Nodes of its bricks lie up to `HALO_STEPS` from its points. Quadrics there ask for vertices
    and parents up to half a coarse cell away, these for points half a coarse cell further on, and
    for cells whose corners exist because of points two finest cells beyond.
    """
    reach = HALO_STEPS * plan.step + plan.coarse_size + 2.0 * plan.cell_size
    return int(np.ceil(reach / plan.coarse_size))
