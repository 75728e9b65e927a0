"""Regions of an arranged cloud: whole blocks, and what of their surroundings a task must know."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hpccomponent.protocol.records import record
from hpccomponent.surface.cloud.arrangement import Arrangement, PackedPoints, unpack_near
from hpccomponent.surface.cloud.disk import DiskCloud, open_disk_cloud
from hpccomponent.surface.cloud.outliers import EDGE, ISLAND_LEVEL
from hpccomponent.surface.types.lattice import cells_of, find_keys, pack_places, unpack_keys
from hpccomponent.surface.types.points import BoolArray, Float32Array, FloatArray, IntArray

__all__ = [
    "DroppedCells",
    "Region",
    "RegionPoints",
    "SentBlocks",
    "find_kept",
    "pack_region",
    "take_region",
]


@record("surface.dropped_cells")
@dataclass(frozen=True, slots=True, eq=False)
class DroppedCells:
    """Cells whose points are as if they were not there.

    Parameters
    ----------
    low : ndarray of float64, shape (3,)
        The least coordinates of the cloud.
    spacing : float
        Of the cloud: from both the cells follow.
    strays, islands : ndarray of int64
        The sorted keys of `Judgement.stray_cells` and of `Judgement.island_cells`.
    """

    low: FloatArray
    spacing: float
    strays: IntArray
    islands: IntArray


@record("surface.sent_blocks")
@dataclass(frozen=True, slots=True, eq=False)
class SentBlocks:
    """Points in blocks that a worker is sent.

    Parameters
    ----------
    arrangement : Arrangement
    packed : PackedPoints
    """

    arrangement: Arrangement
    packed: PackedPoints


RegionPoints = tuple[str | SentBlocks, IntArray, float, DroppedCells | None]
"""The folder of a `DiskCloud` that the worker sees, or what it is sent; the sorted keys of the
region's own blocks; the width of the margin in length units of the input; what is dropped."""


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """The points in some blocks and around them, in the order of the cloud.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
    own : ndarray of bool, shape (n,)
        Which of them lie in these blocks.
    arrangement : Arrangement
    packed : PackedPoints
        Those points and others.
    rows : ndarray of int64, shape (n,)
        Where they are among these.
    has_lost_own : bool
        Whether points in these blocks are left out.
    """

    positions: FloatArray
    own: BoolArray
    arrangement: Arrangement
    packed: PackedPoints
    rows: IntArray
    has_lost_own: bool

    @property
    def normals(self) -> Float32Array:
        """Of the points, of shape (n, 3)."""
        normals = self.packed.normals
        return normals if len(normals) == len(self.rows) else normals[self.rows]

    def pack_own(self, turned: BoolArray) -> PackedPoints:
        """Return the points in its blocks, with some normals turned round.

        Parameters
        ----------
        turned : ndarray of bool, shape (n,)

        Returns
        -------
        PackedPoints
        """
        records = self._take_own()
        records[np.flatnonzero(turned[self.own]), 3:] *= -1.0
        return self._pack(records)

    def pack_with(self, normals: Float32Array) -> PackedPoints:
        """Return the points in its blocks, with other normals.

        Parameters
        ----------
        normals : ndarray of float32, shape (m, 3)
            Of its own points, in their order.

        Returns
        -------
        PackedPoints
        """
        records = self._take_own()
        records[:, 3:] = normals
        return self._pack(records)

    def _take_own(self) -> Float32Array:
        rows = self.rows.take(np.flatnonzero(self.own))
        return self.packed.to_records().take(rows, axis=0)

    def _pack(self, records: Float32Array) -> PackedPoints:
        """Put the records of its own points into blocks."""
        rows = self.rows.take(np.flatnonzero(self.own))
        ends = np.cumsum(self.packed.counts)
        counts = np.diff(np.searchsorted(rows, ends), prepend=0)
        held = counts > 0
        return PackedPoints.from_records(self.packed.keys[held], counts[held], records)


def pack_region(cloud: DiskCloud, blocks: IntArray, margin: float) -> SentBlocks:
    """Return what a worker is sent of a region.

    Parameters
    ----------
    cloud : DiskCloud
    blocks : ndarray of int64, shape (k,)
        Sorted keys.
    margin : float
        In length units of the input.

    Returns
    -------
    SentBlocks
    """
    return SentBlocks(cloud.arrangement, _take_near(cloud, blocks, margin))


def take_region(points: RegionPoints) -> Region:
    """Take the points in some blocks of a cloud, and those around them.

    Parameters
    ----------
    points : tuple
        `RegionPoints`.

    Returns
    -------
    Region
        No point of the cloud within the margin is missing.

    Raises
    ------
    JobError
        The folder is not there any more, or not whole.
    """
    where, blocks, margin, dropped = points
    if isinstance(where, SentBlocks):
        arrangement, packed = where.arrangement, where.packed
    else:
        cloud = open_disk_cloud(Path(where))
        arrangement, packed = cloud.arrangement, _take_near(cloud, blocks, margin)
    positions, rows = unpack_near(arrangement, packed, *_bound(arrangement, blocks, margin))
    own = np.repeat(find_keys(blocks, packed.keys) < len(blocks), packed.counts)
    own = own[rows] if len(rows) < len(own) else own
    owned = int(own.sum())
    if dropped is not None:
        kept = np.flatnonzero(find_kept(dropped, positions))
        if len(kept) < len(positions):
            positions, own, rows = positions.take(kept, axis=0), own[kept], rows[kept]
    return Region(positions, own, arrangement, packed, rows, int(own.sum()) < owned)


def find_kept(dropped: DroppedCells | None, positions: FloatArray) -> BoolArray:
    """Tell which points do not lie in dropped cells.

    Parameters
    ----------
    dropped : DroppedCells or None
    positions : ndarray of float64, shape (n, 3)

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    if dropped is None:
        return np.ones(len(positions), np.bool_)
    edge = EDGE * dropped.spacing
    cells = np.floor(cells_of(positions, dropped.low, edge)).astype(np.int64)
    strays, islands = dropped.strays, dropped.islands
    kept: BoolArray = find_keys(strays, pack_places(cells)) == len(strays)
    kept &= find_keys(islands, pack_places(cells >> ISLAND_LEVEL)) == len(islands)
    return kept


def _bound(
    arrangement: Arrangement, blocks: IntArray, margin: float
) -> tuple[FloatArray, FloatArray]:
    """Return the box around some blocks and a margin."""
    places = unpack_keys(blocks)
    corners = places.min(axis=0), places.max(axis=0) + 1
    low, high = (arrangement.origin + arrangement.edge * corner for corner in corners)
    return low - margin - arrangement.quantum, high + margin + arrangement.quantum


def _take_near(cloud: DiskCloud, blocks: IntArray, margin: float) -> PackedPoints:
    steps = int(np.ceil(margin / cloud.arrangement.edge))
    return cloud.take_packed(_find_near(cloud.keys, blocks, steps))


def _find_near(keys: IntArray, blocks: IntArray, steps: int) -> IntArray:
    """Return those of a cloud's blocks that lie so many steps from some of them, or fewer."""
    places, wanted = unpack_keys(keys), unpack_keys(blocks)
    low = places.min(axis=0)
    sides = places.max(axis=0) - low + 1  # some 64 at most: see `choose_arrangement`
    near = np.zeros(sides, np.int64)
    near[tuple((wanted - low).T)] = 1
    for axis, side in enumerate(sides):
        summed = np.insert(np.cumsum(near, axis=axis), 0, 0, axis=axis)
        at = np.arange(side)
        above = summed.take(np.minimum(at + steps + 1, side), axis=axis)
        near = np.sign(above - summed.take(np.maximum(at - steps, 0), axis=axis))
    is_near: BoolArray = near[tuple((places - low).T)] > 0
    return keys[is_near]
