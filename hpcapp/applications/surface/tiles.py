"""Tiles: ranges of coarse cells along a Morton curve, equal in estimated work.

The paper's equal batches, by work instead of by count. Who may import it: the default method.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface import kernels
from hpccomponent.surface.arrangement import PackedPoints, pack_points
from hpccomponent.surface.lattice import BITS, find_keys, unpack_keys
from hpccomponent.surface.points import IntArray, PointCloud
from hpccomponent.surface.reach import HALO_STEPS, surround
from hpccomponent.surface.region import Plan

__all__ = ["Tile", "Tiling", "cut_tiles", "halo_cells", "morton_codes"]

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


@dataclass(frozen=True, slots=True, eq=False)
class Tile:
    """The points that one region is made from.

    Parameters
    ----------
    core : PackedPoints
        Its own.
    before, after : PackedPoints
        Those around it, of tiles before and after it.
    cells : ndarray of int64, shape (c,)
        Sorted keys of its own coarse cells.
    """

    core: PackedPoints
    before: PackedPoints
    after: PackedPoints
    cells: IntArray


class Tiling:
    """A cloud in memory, cut into tiles.

    Parameters
    ----------
    cloud : PointCloud
        Arranged (see `arrangement`), with normals.
    plan : Plan
    count : int
        How many tiles there shall be; fewer where there are fewer coarse cells.
    """

    def __init__(self, cloud: PointCloud, plan: Plan, count: int) -> None:
        size = plan.cell_size * 2.0**plan.coarse
        self.cells, self._offsets, self._rows = kernels.sort_points(
            cloud.positions, plan.origin, size
        )
        self._cloud = cloud
        self._plan = plan
        self._tile_of = cut_tiles(self.cells, np.diff(self._offsets), count)
        self._halo = halo_cells(plan)

    def __len__(self) -> int:
        return int(self._tile_of.max()) + 1

    def core(self, index: int) -> PackedPoints:
        """Return the points of a tile."""
        return self.take(self._tile_of == index)

    def tile(self, index: int) -> Tile:
        """Return the points of a tile and of its halo."""
        own = self.cells[self._tile_of == index]
        around = self.near(own)
        return Tile(
            self.core(index),
            self.take(around & (self._tile_of < index)),
            self.take(around & (self._tile_of > index)),
            own,
        )

    def near(self, cells: IntArray) -> NDArray[np.bool_]:
        """Tell which coarse cells with points lie around some cells, near enough to matter."""
        reached = surround(cells, self._halo)
        return find_keys(reached, self.cells) < len(reached)

    def take(self, chosen: NDArray[np.bool_]) -> PackedPoints:
        """Return the points in some of the coarse cells."""
        runs = np.flatnonzero(chosen)
        if not len(runs):
            none = np.empty(0, np.int64)
            return PackedPoints(none, none, *np.empty((2, 0, 3), np.float32))
        rows = np.concatenate([self._rows[self._offsets[c] : self._offsets[c + 1]] for c in runs])
        rows.sort()
        some = self._cloud.take(rows)
        assert some.normals is not None  # noqa: S101 - checked by the method, at its border
        return pack_points(self._plan.arrangement, some.positions, some.normals)


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
    size = plan.cell_size * 2.0**plan.coarse
    return int(np.ceil((HALO_STEPS * plan.step + size + 2.0 * plan.cell_size) / size))
