"""Regions of a cloud: the points that a task works on, wherever they lie, and those around them.

A task is given `RegionPoints`, takes a `CloudRegion` of them, and says what becomes of its own
points in terms of the region: it is written once, for points in memory and for blocks in a folder.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface.cloud.arrangement import (
    Arrangement,
    BlockCounts,
    BlockKeys,
    PackedPoints,
    unpack_near,
)
from hpcapp.applications.surface.cloud.cutting import find_near_blocks
from hpcapp.applications.surface.cloud.folder.disk import DiskCloud, open_disk_cloud
from hpcapp.applications.surface.cloud.folder.parts import write_part
from hpcapp.geometry.lattice import find_keys, unpack_keys
from hpcapp.geometry.points import BoolArray, Float32Array, FloatArray, IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.records import record


@dataclass(frozen=True, slots=True, eq=False)
class ReplacedRows:
    """What becomes of some points in memory: those of the cloud's `rows`, (m,) or a slice.

    A mask `kept` (m,) has those that stay, all by default; `normals` (m, 3) replace those they had.
    """

    rows: IntArray | slice
    kept: BoolArray | None = None
    normals: NDArray[Any] | None = None


Replaced = ReplacedRows | PackedPoints | tuple[BlockKeys, BlockCounts]
"""What becomes of a region's own points: of those in memory, or in a folder those blocks that have
changed, written there (keys and counts) or to be sent. A block of which nothing is left has the
count 0."""


@dataclass(frozen=True, slots=True, eq=False)
class MemoryRegion:
    """A region of a cloud in memory, with the normals that are `given`, (n, 3).

    Positions (n, 3) are in length units of the input. The region's own points, `own` (n,), are the
    cloud's `rows`, (m,) or a slice; a task may take so many `threads`.
    """

    positions: FloatArray
    given: FloatArray | Float32Array | None
    own: BoolArray
    rows: IntArray | slice
    threads: int = 1

    def take(self) -> CloudRegion:
        """Return the region."""
        return self

    @property
    def normals(self) -> FloatArray | Float32Array:
        """Shape (n, 3)."""
        assert self.given is not None  # noqa: S101 - or there is nothing to ask
        return self.given

    def drop(self, dropped: BoolArray) -> Replaced | None:
        """Leave out some of its own points, of shape (m,); None where there are none."""
        return ReplacedRows(self.rows, kept=~dropped) if dropped.any() else None

    def flip(self, is_flipped: BoolArray) -> Replaced | None:
        """Turn round the normals of some of its own points, of shape (m,); None where of none."""
        if not is_flipped.any():
            return None
        own = self.normals if self.own.all() else self.normals[self.own]
        return ReplacedRows(self.rows, normals=np.where(is_flipped[:, None], -own, own))

    def replace_normals(self, normals: FloatArray | Float32Array) -> Replaced:
        """Give its own points other normals, of shape (m, 3)."""
        return ReplacedRows(self.rows, normals=normals)


@record("surface.sent_blocks")
@dataclass(frozen=True, slots=True, eq=False)
class SentBlocks:
    """Points in blocks that a worker is sent."""

    arrangement: Arrangement
    packed: PackedPoints


@record("surface.stored_blocks")
@dataclass(frozen=True, slots=True, eq=False)
class StoredBlocks:
    """Where the points of a region are that is some blocks of a `DiskCloud`.

    `where` is its folder, which the worker sees, or what it is sent: no point is missing that lies
    within the margin of the region's own blocks, whose keys (k,) are sorted. What changes is
    written to `target`, a folder and the number of a part there (see `disk_parts.write_part`); None
    where the worker does not see it.
    """

    where: str | SentBlocks
    blocks: IntArray
    margin: float
    target: tuple[str, int] | None = None

    def take(self) -> CloudRegion:
        """Return the region; JobError where its folder is not there any more, or not whole."""
        if isinstance(self.where, SentBlocks):
            arrangement, packed = self.where.arrangement, self.where.packed
        else:
            cloud = open_disk_cloud(Path(self.where))
            arrangement, packed = cloud.arrangement, _take_near(cloud, self.blocks, self.margin)
        box = _bound(arrangement, self.blocks, self.margin)
        # (n, 3), (n,): of the points in the blocks, those in the box of region and margin.
        positions, rows = unpack_near(arrangement, packed, *box)
        own = np.repeat(find_keys(self.blocks, packed.keys) < len(self.blocks), packed.counts)
        own = own[rows] if len(rows) < len(own) else own
        return _StoredRegion(positions, own, packed, rows, self.target)


@dataclass(frozen=True, slots=True, eq=False)
class _StoredRegion:
    """A region of blocks, see `MemoryRegion`: the points at `rows` (n,) of what is packed."""

    positions: FloatArray
    own: BoolArray
    packed: PackedPoints
    rows: IntArray
    target: tuple[str, int] | None

    @property
    def threads(self) -> int:
        return 1  # workers run as many tasks at once as there are cores

    @property
    def normals(self) -> Float32Array:
        normals = self.packed.normals
        return normals if len(normals) == len(self.rows) else normals[self.rows]

    def drop(self, dropped: BoolArray) -> Replaced | None:
        return self._put(self._take_own(), dropped, ~dropped) if dropped.any() else None

    def flip(self, is_flipped: BoolArray) -> Replaced | None:
        if not is_flipped.any():
            return None
        records = self._take_own()
        records[is_flipped, 3:] *= -1.0
        return self._put(records, is_flipped)

    def replace_normals(self, normals: FloatArray | Float32Array) -> Replaced:
        records = self._take_own()
        records[:, 3:] = normals
        return self._put(records, np.ones(len(records), np.bool_))

    def _take_own(self) -> Float32Array:
        """Return a copy of the records of its own points, shape (m, 6)."""
        return self.packed.to_records().take(self.rows[self.own], axis=0)

    def _put(
        self, records: Float32Array, changed: BoolArray, kept: BoolArray | None = None
    ) -> Replaced:
        """Put the blocks of its own points in which some have changed where they belong."""
        # (m,): the block of each own point, among those that were read
        blocks = np.searchsorted(np.cumsum(self.packed.counts), self.rows[self.own], side="right")
        is_changed = np.zeros(len(self.packed.keys), np.bool_)
        is_changed[blocks[changed]] = True
        # (m,): all points of blocks in which one has changed, without those that are dropped.
        chosen = is_changed[blocks] if kept is None else is_changed[blocks] & kept
        counts = np.bincount(blocks[chosen], minlength=len(is_changed))[is_changed]
        packed = PackedPoints.from_records(
            self.packed.keys[is_changed],
            counts.astype(np.int64),
            records if chosen.all() else records[chosen],
        )
        if self.target is None:
            return packed
        return write_part(Path(self.target[0]), self.target[1], [packed])


CloudRegion = MemoryRegion | _StoredRegion
"""The points of a region and those around it, in the order of the cloud."""

RegionPoints = MemoryRegion | StoredBlocks
"""Where the points of a region are."""


def pack_region(cloud: DiskCloud, blocks: IntArray, margin: float) -> SentBlocks:
    """Return what a worker is sent of a region: see `StoredBlocks`."""
    return SentBlocks(cloud.arrangement, _take_near(cloud, blocks, margin))


def _bound(
    arrangement: Arrangement, blocks: IntArray, margin: float
) -> tuple[FloatArray, FloatArray]:
    """Return the box around some blocks and a margin."""
    places = unpack_keys(blocks)
    corners = places.min(axis=0), places.max(axis=0) + 1
    low, high = (arrangement.origin + arrangement.edge * corner for corner in corners)
    # A quantum more, by which rounding may move a point or a bound.
    return low - margin - arrangement.quantum, high + margin + arrangement.quantum


def _take_near(cloud: DiskCloud, blocks: IntArray, margin: float) -> PackedPoints:
    steps = int(np.ceil(margin / cloud.arrangement.edge))
    return cloud.take_packed(find_near_blocks(cloud.keys, blocks, steps))
