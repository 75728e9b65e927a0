"""What the tasks that go through a cloud declare of their results.

The master knows how many points lie in each block, from the index of the folder or from what it
sends: so a result says nothing of points that are not there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface.cloud.arranged import ArrangedCloud, Place
from hpcapp.applications.surface.cloud.arrangement import (
    Arrangement,
    BlockCounts,
    BlockKeys,
    PackedPoints,
)
from hpcapp.applications.surface.cloud.folder.disk import open_disk_cloud, open_place
from hpcapp.applications.surface.cloud.regions import SentBlocks, StoredBlocks
from hpcapp.applications.surface.scale.local_scale import ScaleCounts
from hpcapp.applications.surface.types.result_patterns import (
    CORNERS,
    LENGTH,
    SMALL_BYTES,
    Box,
    CellCounts,
    CellKeys,
    are_units,
    bounds_some,
    cells_in,
    is_share,
    lie_in,
    lie_within,
    sampled_boxes,
)
from hpcapp.geometry.lattice import find_keys, pack_places, unpack_keys
from hpcapp.geometry.points import Float32Array, FloatArray, IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.columns import Bounds, Column, pattern_of
from hpccomponent.protocol.declared import Declared, Fixed, Where

SamplePositions = Annotated[FloatArray, Column("s", 3, unit=LENGTH)]
SampleNormals = Annotated[FloatArray, Column("s", 3)]

_SAME_BLOCKS = "the points are those of the blocks"


@dataclass(frozen=True, slots=True, eq=False)
class AssignedPoints:
    """The points that a task is given, as far as they are known without reading them.

    The keys and counts (b,) are of its own blocks, but for empty ones. `sent` are the points
    themselves, and others, where they are sent.
    """

    arrangement: Arrangement
    keys: IntArray
    counts: IntArray
    sent: PackedPoints | None = None

    @classmethod
    def of(cls, points: StoredBlocks) -> AssignedPoints:
        """Return what is known of a region's own points."""
        if isinstance(points.where, SentBlocks):
            sent = points.where
            return replace(
                cls.among(sent.arrangement, sent.packed, points.blocks), sent=sent.packed
            )
        cloud = open_disk_cloud(Path(points.where))
        return cls.among(cloud.arrangement, cloud, points.blocks)

    @classmethod
    def among(
        cls, arrangement: Arrangement, cloud: ArrangedCloud | PackedPoints, blocks: IntArray
    ) -> AssignedPoints:
        """Return what is known of the points in some of a cloud's blocks."""
        rows = find_keys(cloud.keys, blocks)
        rows = rows[rows < len(cloud.keys)]
        return cls(arrangement, cloud.keys[rows], cloud.counts[rows])

    @property
    def points(self) -> int:
        """How many there are."""
        return int(self.counts.sum())

    @property
    def total(self) -> tuple[int, int]:
        """How many there are, as the bounds of a sum."""
        return self.points, self.points

    @property
    def box(self) -> Box:
        """Corners of the box around the blocks."""
        origin, edge = self.arrangement.origin, self.arrangement.edge
        if not len(self.keys):
            return origin, origin
        places = unpack_keys(self.keys)
        return origin + edge * places.min(axis=0), origin + edge * (places.max(axis=0) + 1)

    def cells(self, low: FloatArray, size: float) -> Bounds:
        """Return the bounds of keys of cells that hold points."""
        return cells_in(self.box, low, size)

    def replaced(
        self,
        target: tuple[str, int] | None,
        most: float,
        are_right: Callable[[Any], bool] = lambda _: True,
        *,
        is_all: bool = False,
    ) -> Declared:
        """Return the pattern of blocks, some or all, with other normals, up to `most` long."""
        counts = Bounds(low=1)
        if target is not None:
            return Where(
                Fixed(Bounds().of(BlockKeys), counts.of(BlockCounts)),
                lambda written: self._hold(written[0], written[1], is_all),
                _SAME_BLOCKS,
            )
        return Where(
            pattern_of(PackedPoints, counts=counts, normals=Bounds(-most, most)),
            lambda packed: (
                self._hold(packed.keys, packed.counts, is_all)
                and int(packed.counts.sum()) == len(packed)
                and self._are_where_they_were(packed)
                and are_right(packed.normals)
            ),
            _SAME_BLOCKS,
        )

    def lacks(self, rest: PackedPoints | tuple[IntArray, IntArray] | None, points: int) -> bool:
        """Tell whether blocks may be those that so many points were dropped from."""
        if rest is None:
            return points == 0
        keys, counts = (rest.keys, rest.counts) if isinstance(rest, PackedPoints) else rest
        rows = find_keys(self.keys, keys)
        if not lie_within(rows, 0, len(self.keys)):
            return False
        # (b,): each block that is named has lost points, together as many as were dropped.
        dropped = self.counts[rows] - counts
        return bool((dropped > 0).all()) and int(dropped.sum()) == points

    def without_some(self, target: tuple[str, int] | None) -> Declared:
        """Return the pattern of blocks that points were dropped from, written or to be sent."""
        if target is not None:
            return Fixed(Bounds().of(BlockKeys), Bounds().of(BlockCounts))
        return Where(pattern_of(PackedPoints), self._are_left, _SAME_BLOCKS)

    def samples(self, positions: FloatArray) -> bool:
        """Tell whether points in the blocks' box may be some of these, in their order."""
        # (s,): the blocks of the points rise, and each has no more of them than it holds.
        places = np.floor((positions - self.arrangement.origin) / self.arrangement.edge)
        rows = find_keys(self.keys, pack_places(places.astype(np.int64)))
        return (
            lie_within(rows, 0, len(self.keys))
            and bool((rows[1:] >= rows[:-1]).all())
            and bool((np.bincount(rows, minlength=len(self.keys)) <= self.counts).all())
        )

    def _hold(self, keys: IntArray, counts: IntArray, is_all: bool) -> bool:
        """Tell whether blocks with so many points are among these, or all of them."""
        if is_all and len(keys) != len(self.keys):
            return False
        rows = find_keys(self.keys, keys)
        return lie_within(rows, 0, len(self.keys)) and np.array_equal(counts, self.counts[rows])

    def _are_where_they_were(self, packed: PackedPoints) -> bool:
        if self.sent is None:
            return True
        own = find_keys(packed.keys, self.sent.keys) < len(packed.keys)
        return np.array_equal(packed.offsets, self.sent.offsets[np.repeat(own, self.sent.counts)])

    def _are_left(self, packed: PackedPoints) -> bool:
        """Tell whether points are some of those that were sent, in their order."""
        if self.sent is None or int(packed.counts.sum()) != len(packed):
            return False
        chosen = find_keys(packed.keys, self.sent.keys) < len(packed.keys)
        if np.count_nonzero(chosen) != len(packed.keys):
            return False
        rows = np.repeat(chosen, self.sent.counts)
        # What is left was there before, in this order and with these normals.
        before = _name_points(self.sent.counts[chosen], self.sent.offsets[rows])
        after = _name_points(packed.counts, packed.offsets)
        is_left = np.isin(before, after)
        return np.array_equal(before[is_left], after) and np.array_equal(
            self.sent.normals[rows][is_left], packed.normals
        )


def _name_points(counts: IntArray, offsets: Float32Array) -> NDArray[np.void]:
    """Return one value for each point, of its block and its place there, where no other is."""
    names = np.empty((len(offsets), 4), "<u4")
    names[:, 0] = np.repeat(np.arange(len(counts)), counts)
    names[:, 1:] = offsets.view("<u4")
    return names.view("V16")[:, 0]


def region_bytes(each: int) -> Callable[..., int]:
    """Return what tells how large a result may be, `each` bytes a point, by a task's arguments."""
    return lambda points, *_: SMALL_BYTES + each * AssignedPoints.of(points).points


def counted_bytes(place: Place, blocks: IntArray, *_: Any) -> int:
    """Return how large what `tasks.count_block_cells` counts may be."""
    cloud = open_place(place)
    return SMALL_BYTES + 16 * AssignedPoints.among(cloud.arrangement, cloud, blocks).points


def bounded_region(points: StoredBlocks) -> Declared:
    """Return the pattern of what `tasks.bound_region` finds."""
    own = AssignedPoints.of(points)
    low, high = own.box
    edge = own.arrangement.edge

    def agrees(box: FloatArray) -> bool:
        is_within = bounds_some(box, own.points) and lie_in(box, own.box)
        return (
            is_within and lie_in(box[0], (low, low + edge)) and lie_in(box[1], (high - edge, high))
        )

    return Where(CORNERS, agrees, "the box reaches from the first block to the last")


def counted_boxes(
    points: StoredBlocks, low: FloatArray, edge: float, one_in: int, is_distinct: bool
) -> Declared:
    """Return the pattern of what `tasks.count_boxes` counts."""
    own = AssignedPoints.of(points)
    return Where(
        sampled_boxes(own.points, own.cells(low, edge)),
        lambda counted: is_share(own.points, 0 if is_distinct else one_in, counted[0]),
        "the boxes hold points of the blocks",
    )


def counted_scale(points: StoredBlocks, origin: FloatArray, edge: float, depth: int) -> Declared:
    """Return the pattern of what `tasks.count_region_scale` counts."""
    own = AssignedPoints.of(points)

    def agrees(counted: ScaleCounts) -> bool:
        boxes = counted.boxes
        is_nested = (boxes[:, 1:] >= boxes[:, :-1]) & (boxes[:, 1:] <= 8 * boxes[:, :-1])
        return (
            bool((boxes[:, 0] == 1).all())
            and bool(is_nested.all())
            and bool((boxes[:, -1] <= counted.points).all())
        )

    counts = pattern_of(
        ScaleCounts,
        {"d": depth},
        keys=own.cells(origin, edge),
        points=Bounds(total=own.total),
    )
    return Where(counts, agrees, "a box holds up to eight of half its edge")


def sampled_region(points: StoredBlocks, *_: Any) -> Declared:
    """Return the pattern of what `tasks.sample_region` takes."""
    own = AssignedPoints.of(points)
    return Where(
        Fixed(Bounds(*own.box).of(SamplePositions), Bounds().of(SampleNormals)),
        lambda sample: own.samples(sample[0]) and are_units(sample[1]),
        _SAME_BLOCKS,
    )


def sampled_places(points: StoredBlocks, *_: Any) -> Declared:
    """Return the pattern of what `tasks.sample_places` takes."""
    own = AssignedPoints.of(points)
    low, high = own.box
    return Bounds(low, high, agrees=own.samples, rule=_SAME_BLOCKS).of(SamplePositions)


def counted_cells(place: Place, blocks: IntArray, origin: FloatArray, size: float) -> Declared:
    """Return the pattern of what `tasks.count_block_cells` counts."""
    cloud = open_place(place)
    own = AssignedPoints.among(cloud.arrangement, cloud, blocks)
    counts = Bounds(total=own.total).of(CellCounts)
    return Fixed(own.cells(origin, size).of(CellKeys), counts)
