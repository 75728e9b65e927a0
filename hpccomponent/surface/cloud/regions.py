"""Regions of an arranged cloud: whole blocks, and what of their surroundings a task must know."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hpccomponent.surface.cloud.arrangement import Arrangement, PackedPoints, unpack_near
from hpccomponent.surface.cloud.disk import DiskCloud, open_disk_cloud
from hpccomponent.surface.cloud.outliers import EDGE, ISLAND_LEVEL
from hpccomponent.surface.types.lattice import cells_of, find_keys, pack_places, unpack_keys
from hpccomponent.surface.types.points import BoolArray, Float32Array, FloatArray, IntArray

__all__ = ["DroppedCells", "Region", "RegionPoints", "find_kept", "pack_region", "take_region"]


RegionPoints = tuple[Any, ...]
"""``("there", folder)`` where the worker sees the folder of a `DiskCloud`, or ``("sent",
arrangement, packed)`` with the values of an `Arrangement` and of a `PackedPoints`; and then the
sorted keys of the region's own blocks, the width of the margin in length units of the input, and
`DroppedCells`."""

DroppedCells = tuple[Any, ...]
"""Cells whose points are as if they were not there: the least coordinates of the cloud and its
spacing, from which the cells follow, and the sorted keys of `Judgement.stray_cells` and of
`Judgement.island_cells`; or nothing."""


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
        """
        own = np.flatnonzero(self.own)
        rows = self.rows.take(own)
        records = self.packed.to_records().take(rows, axis=0)
        records[np.flatnonzero(turned.take(own)), 3:] *= -1.0
        ends = np.cumsum(self.packed.counts)
        counts = np.diff(np.searchsorted(rows, ends), prepend=0)
        held = counts > 0
        return PackedPoints.from_records(self.packed.keys[held], counts[held], records)


def pack_region(cloud: DiskCloud, blocks: IntArray, margin: float) -> tuple[Any, ...]:
    """Return what a worker is sent of a region: the first three of `RegionPoints`.

    Parameters
    ----------
    cloud : DiskCloud
    blocks : ndarray of int64, shape (k,)
        Sorted keys.
    margin : float
        In length units of the input.
    """
    packed = _take_near(cloud, blocks, margin)
    arrangement = cloud.arrangement
    return "sent", (arrangement.origin, arrangement.edge), packed.to_values()


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
    *where, blocks, margin, dropped = points
    if where[0] == "there":
        cloud = open_disk_cloud(Path(where[1]))
        arrangement, packed = cloud.arrangement, _take_near(cloud, blocks, margin)
    else:
        arrangement, packed = Arrangement(*where[1]), PackedPoints(*where[2])
    positions, rows = unpack_near(arrangement, packed, *_bound(arrangement, blocks, margin))
    own = np.repeat(find_keys(blocks, packed.keys) < len(blocks), packed.counts)
    own = own[rows] if len(rows) < len(own) else own
    owned = int(own.sum())
    if dropped:
        kept = np.flatnonzero(find_kept(dropped, positions))
        if len(kept) < len(positions):
            positions, own, rows = positions.take(kept, axis=0), own[kept], rows[kept]
    return Region(positions, own, arrangement, packed, rows, int(own.sum()) < owned)


def find_kept(dropped: DroppedCells, positions: FloatArray) -> BoolArray:
    """Tell which points do not lie in dropped cells.

    Parameters
    ----------
    dropped : tuple
        `DroppedCells`.
    positions : ndarray of float64, shape (n, 3)
    """
    if not dropped:
        return np.ones(len(positions), np.bool_)
    low, spacing, strays, islands = dropped
    cells = np.floor(cells_of(positions, low, EDGE * spacing)).astype(np.int64)
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
