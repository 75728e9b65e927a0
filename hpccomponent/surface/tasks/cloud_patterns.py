"""What the tasks that go through a cloud declare of their results.

The master knows how many points lie in each block, from the index of the folder or from what it
sends: so a result says nothing of points that are not there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hpccomponent.protocol.declared import (
    Array,
    Declared,
    Either,
    Fixed,
    Nothing,
    Record,
    Where,
    Whole,
)
from hpccomponent.surface.cloud.arranged import ArrangedCloud, Place
from hpccomponent.surface.cloud.arrangement import Arrangement, PackedPoints
from hpccomponent.surface.cloud.disk import open_disk_cloud, open_place
from hpccomponent.surface.cloud.outlier_regions import LOCAL_RANK
from hpccomponent.surface.cloud.outliers import EDGE, ISLAND_LEVEL
from hpccomponent.surface.cloud.regions import SentBlocks, StoredBlocks
from hpccomponent.surface.normals.patches import CELL, LINKED, MARGIN, SHEETS, Links, Patches
from hpccomponent.surface.tasks.result_patterns import (
    BOX,
    SMALL_BYTES,
    Box,
    are_units,
    bounds_some,
    cells_in,
    is_share,
    lie_in,
    lie_within,
    rise_by_pairs,
    sampled_boxes,
)
from hpccomponent.surface.types.lattice import find_keys, pack_places, unpack_keys
from hpccomponent.surface.types.points import FloatArray, IntArray

__all__ = [
    "CONFIDENCE_BINS",
    "bounded_region",
    "counted_boxes",
    "counted_cells",
    "estimated_region",
    "grouped_region",
    "mended_region",
    "ranked_region",
    "region_bytes",
    "run_bytes",
    "sampled_region",
    "stray_cells",
    "turned_region",
    "without_points",
]

CONFIDENCE_BINS = 100
"""Of the histogram of confidences."""

_UNIT = 1.001  # of a vector of unit length
_SAME_BLOCKS = "the points are those of the blocks"
_BELOW_ONE = float(np.nextafter(np.float32(1.0), np.float32(0.0)))
_MOST_NOISE = 24.0  # spacings: twice as far as the neighbours that it is told by
_ROUNDED = 1.0 + 1e-6  # what is a mean may lie as much further out


@dataclass(frozen=True, slots=True, eq=False)
class _Assigned:
    """The points that a task is given, as far as they are known without reading them.

    Parameters
    ----------
    arrangement : Arrangement
    keys, counts : ndarray of int64, shape (b,)
        Of the task's own blocks, but for empty ones.
    sent : PackedPoints or None
        The points themselves, and others, where they are sent.
    """

    arrangement: Arrangement
    keys: IntArray
    counts: IntArray
    sent: PackedPoints | None = None

    @classmethod
    def of(cls, points: StoredBlocks) -> _Assigned:
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
    ) -> _Assigned:
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

    def cells(self, extent: str, low: FloatArray, size: float) -> Declared:
        """Return the pattern of keys of cells that hold points."""
        return cells_in(extent, self.box, low, size)

    def replaced(
        self,
        target: tuple[str, int] | None,
        most: float,
        are_right: Callable[[Any], bool] = lambda _: True,
        *,
        is_all: bool = False,
    ) -> Declared:
        """Return the pattern of blocks, some or all, with other normals, up to `most` long."""
        keys, counts = Array("<i8", "b", low=0, rises=True), Array("<i8", "b", low=1)
        if target is not None:
            return Where(
                Fixed(keys, counts),
                lambda written: self._hold(written[0], written[1], is_all),
                _SAME_BLOCKS,
            )
        offsets = Array("<f4", "p", 3, low=0.0, high=_BELOW_ONE)
        normals = Array("<f4", "p", 3, low=-most, high=most)
        return Where(
            Record(PackedPoints, keys=keys, counts=counts, offsets=offsets, normals=normals),
            lambda packed: (
                self._hold(packed.keys, packed.counts, is_all)
                and int(packed.counts.sum()) == len(packed)
                and self._are_where_they_were(packed)
                and are_right(packed.normals)
            ),
            _SAME_BLOCKS,
        )

    def lacks(self, blocks: tuple[IntArray, IntArray] | None, points: int) -> bool:
        """Tell whether blocks may be those that so many points were dropped from."""
        if blocks is None:
            return points == 0
        rows = find_keys(self.keys, blocks[0])
        if not lie_within(rows, 0, len(self.keys)):
            return False
        dropped = self.counts[rows] - blocks[1]
        return bool((dropped > 0).all()) and int(dropped.sum()) == points

    def samples(self, positions: FloatArray, normals: FloatArray) -> bool:
        """Tell whether points in the blocks' box may be some of these, in their order."""
        places = np.floor((positions - self.arrangement.origin) / self.arrangement.edge)
        rows = find_keys(self.keys, pack_places(places.astype(np.int64)))
        return (
            lie_within(rows, 0, len(self.keys))
            and bool((rows[1:] >= rows[:-1]).all())
            and bool((np.bincount(rows, minlength=len(self.keys)) <= self.counts).all())
            and are_units(normals)
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


def region_bytes(each: int) -> Callable[..., int]:
    """Return how large what is found of some blocks may be, from what a task is given.

    Parameters
    ----------
    each : int
        Bytes of each point, at most.

    Returns
    -------
    callable
    """
    return lambda points, *_: SMALL_BYTES + each * _Assigned.of(points).points


def run_bytes(each: int) -> Callable[..., int]:
    """Return the same of tasks that are given a place and blocks there.

    Parameters
    ----------
    each : int
        Bytes of each point, at most.

    Returns
    -------
    callable
    """

    def limit(place: Place, blocks: IntArray, *_: Any) -> int:
        cloud = open_place(place)
        return SMALL_BYTES + each * _Assigned.among(cloud.arrangement, cloud, blocks).points

    return limit


def bounded_region(points: StoredBlocks) -> Declared:
    """Return the pattern of what `blocks.bound_region` finds."""
    own = _Assigned.of(points)
    low, high = own.box
    edge = own.arrangement.edge

    def agrees(box: FloatArray) -> bool:
        is_within = bounds_some(box, own.points) and lie_in(box, own.box)
        return (
            is_within and lie_in(box[0], (low, low + edge)) and lie_in(box[1], (high - edge, high))
        )

    return Where(BOX, agrees, "the box reaches from the first block to the last")


def counted_boxes(
    points: StoredBlocks, low: FloatArray, edge: float, one_in: int, is_distinct: bool
) -> Declared:
    """Return the pattern of what `blocks.count_boxes` counts."""
    own = _Assigned.of(points)
    return Where(
        sampled_boxes(own.points, own.cells("c", low, edge)),
        lambda counted: is_share(own.points, 0 if is_distinct else one_in, counted[0]),
        "the boxes hold points of the blocks",
    )


def sampled_region(points: StoredBlocks, *_: Any) -> Declared:
    """Return the pattern of what `blocks.sample_region` takes."""
    own = _Assigned.of(points)
    low, high = own.box
    return Where(
        Fixed(Array("<f8", "s", 3, low=low, high=high), Array("<f8", "s", 3)),
        lambda sample: own.samples(*sample),
        _SAME_BLOCKS,
    )


def counted_cells(place: Place, blocks: IntArray, origin: FloatArray, size: float) -> Declared:
    """Return the pattern of what `blocks.count_block_cells` counts."""
    cloud = open_place(place)
    own = _Assigned.among(cloud.arrangement, cloud, blocks)
    return Fixed(own.cells("c", origin, size), Array("<i8", "c", low=1, total=own.total))


def without_points(points: StoredBlocks, *_: Any) -> Declared:
    """Return the pattern of what tasks write that drop points."""
    own = _Assigned.of(points)
    written = Fixed(Array("<i8", "b", low=0, rises=True), Array("<i8", "b", low=0))
    return Where(
        Fixed(Either(Nothing(), written), Whole(0, own.points)),
        lambda result: own.lacks(*result),
        "blocks lack the points that are dropped",
    )


def ranked_region(points: StoredBlocks, low: FloatArray, spacing: float) -> Declared:
    """Return the pattern of what `cleaning.rank_region` returns."""
    own, size = _Assigned.of(points), EDGE * spacing

    def agrees(ranks: tuple[Any, ...]) -> bool:
        by_rank, sparse_ranks, sparse_counts = ranks[0], ranks[4], ranks[5]
        sparse = np.bincount(sparse_ranks, sparse_counts, LOCAL_RANK + 2)
        return np.array_equal(sparse[LOCAL_RANK:], by_rank[LOCAL_RANK:])

    by_rank = Array("<i8", LOCAL_RANK + 2, low=0, total=own.total)
    counts = Array("<i8", "coarse", low=1, total=own.total)
    coarse = own.cells("coarse", low, size * 2.0**ISLAND_LEVEL)
    sparse_ranks = Array("<i8", "sparse", low=LOCAL_RANK, high=LOCAL_RANK + 1)
    sparse_counts = Array("<i8", "sparse", low=1, total=(0, own.points))
    sparse = own.cells("sparse", low, size), sparse_ranks, sparse_counts
    return Where(
        Fixed(by_rank, coarse, counts, *sparse),
        agrees,
        "sparse cells have the points of high ranks",
    )


def stray_cells(points: StoredBlocks, low: FloatArray, spacing: float, _base: int) -> Declared:
    """Return the pattern of what `cleaning.judge_region` finds."""
    own = _Assigned.of(points)
    return Where(
        own.cells("s", low, EDGE * spacing),
        lambda cells: len(cells) <= own.points,
        "each cell holds a point",
    )


def mended_region(points: StoredBlocks, *_: Any) -> Declared:
    """Return the pattern of what `cleaning.mend_region` returns."""
    own = _Assigned.of(points)
    replaced = own.replaced(points.target, _UNIT, are_units)
    return Where(
        Fixed(Either(Nothing(), replaced), Whole(0, own.points)),
        lambda result: (result[0] is None) == (result[1] == 0),
        "points are written where something of them has changed",
    )


def estimated_region(
    points: StoredBlocks, _low: FloatArray, spacing: float, _keeps: bool
) -> Declared:
    """Return the pattern of what `normals.estimate_region` returns."""
    own = _Assigned.of(points)
    return Fixed(own.replaced(points.target, _MOST_NOISE * spacing, is_all=True))


def turned_region(points: StoredBlocks, *_: Any) -> Declared:
    """Return the pattern of what `normals.turn_region` returns."""
    own = _Assigned.of(points)
    replaced = own.replaced(points.target, _UNIT, are_units, is_all=True)
    bins = Array("<i8", CONFIDENCE_BINS, low=0, total=own.total)
    return Fixed(replaced, Whole(0, own.points), bins)


def grouped_region(points: StoredBlocks, low: FloatArray, spacing: float) -> Declared:
    """Return the pattern of what `normals.group_region` finds."""
    own, reach = _Assigned.of(points), 1.01 * MARGIN * spacing
    box = own.box[0] - reach, own.box[1] + reach
    patches = Record(
        Patches,
        keys=cells_in("p", box, low, CELL * spacing, rises=False),
        ranks=Array("<i8", "p", low=0, high=SHEETS - 1),
        counts=Array("<i8", "p", low=1),
        centres=Array("<f8", "p", 3, low=box[0], high=box[1]),
        normals=Array("<f8", "p", 3, low=-_UNIT, high=_UNIT),
        noise=Array("<f8", "p", low=0.0, high=_MOST_NOISE * spacing * _ROUNDED),
    )
    contacts = Array("<i8", "l", low=1, total=(0, (LINKED + 1) * own.points))
    ends = Array("<i8", "l", low=0)
    return Where(
        Fixed(patches, Record(Links, first=ends, second=ends, contacts=contacts)),
        _are_linked,
        "patches and links are in their order, and these between those",
    )


def _are_linked(found: tuple[Patches, Links]) -> bool:
    patches, links = found
    return (
        rise_by_pairs(patches.keys, patches.ranks)
        and rise_by_pairs(links.first, links.second)
        and lie_within(links.second, 0, len(patches))
        and bool((links.first < links.second).all())
    )
