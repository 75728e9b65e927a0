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
    EachOf,
    Either,
    Fixed,
    Nothing,
    Record,
    Where,
    Whole,
)
from hpccomponent.surface.cloud.arranged import Place
from hpccomponent.surface.cloud.arrangement import Arrangement, PackedPoints
from hpccomponent.surface.cloud.disk import open_disk_cloud, open_place
from hpccomponent.surface.cloud.outlier_regions import LOCAL_RANK, has_sparse
from hpccomponent.surface.cloud.outliers import EDGE, ISLAND_LEVEL
from hpccomponent.surface.cloud.regions import SentBlocks
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
    "cleaned_region",
    "counted_boxes",
    "counted_cells",
    "estimated_region",
    "grouped_region",
    "mended_region",
    "region_bytes",
    "run_bytes",
    "sampled_blocks",
    "stray_cells",
    "surveyed_blocks",
    "turned_region",
    "without_repeated",
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
    is_whole : bool
        Whether none of them is dropped.
    """

    arrangement: Arrangement
    keys: IntArray
    counts: IntArray
    sent: PackedPoints | None = None
    is_whole: bool = True

    @classmethod
    def of(cls, points: tuple[Any, ...]) -> _Assigned:
        """Return what is known of `RegionPoints`, or of `BlockPoints`."""
        where, blocks, *_, dropped = points
        if isinstance(where, SentBlocks):
            found = cls.among(where.arrangement, where.packed, blocks)
            return replace(found, sent=where.packed, is_whole=dropped is None)
        cloud = open_disk_cloud(Path(where))
        return replace(cls.among(cloud.arrangement, cloud, blocks), is_whole=dropped is None)

    @classmethod
    def among(cls, arrangement: Arrangement, cloud: Any, blocks: IntArray) -> _Assigned:
        """Return what is known of the points in some of a cloud's blocks."""
        rows = find_keys(cloud.keys, blocks)
        rows = rows[rows < len(cloud.keys)]
        return cls(arrangement, cloud.keys[rows], cloud.counts[rows])

    @property
    def points(self) -> int:
        """How many there are, or were before some of them were dropped."""
        return int(self.counts.sum())

    @property
    def total(self) -> tuple[int, int]:
        """The least and the greatest number of points that are left."""
        return self.points if self.is_whole else 0, self.points

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

    def written(self) -> Declared:
        """Return the pattern of the blocks that were written."""
        return Where(Fixed(*self._columns()), lambda blocks: self._holds(*blocks), _SAME_BLOCKS)

    def packed(self, most: float, are_right: Callable[[Any], bool] = lambda _: True) -> Declared:
        """Return the pattern of the points with other normals, which are up to `most` long."""
        keys, counts = self._columns()
        offsets = Array("<f4", "p", 3, low=0.0, high=_BELOW_ONE)
        normals = Array("<f4", "p", 3, low=-most, high=most)
        return Where(
            Record(PackedPoints, keys=keys, counts=counts, offsets=offsets, normals=normals),
            lambda packed: (
                self._holds(packed.keys, packed.counts)
                and int(packed.counts.sum()) == len(packed)
                and self._are_where_they_were(packed)
                and are_right(packed.normals)
            ),
            _SAME_BLOCKS,
        )

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

    def _columns(self) -> tuple[Array, Array]:
        if self.is_whole:
            keys, counts = self.keys, self.counts
            same = (Array("<i8", len(some), low=some, high=some) for some in (keys, counts))
            return next(same), next(same)
        return Array("<i8", "b", low=0, rises=True), Array("<i8", "b", low=1, total=self.total)

    def _holds(self, keys: IntArray, counts: IntArray) -> bool:
        """Tell whether blocks with so many points are among these."""
        rows = find_keys(self.keys, keys)
        return lie_within(rows, 0, len(self.keys)) and bool((counts <= self.counts[rows]).all())

    def _are_where_they_were(self, packed: PackedPoints) -> bool:
        if self.sent is None or not self.is_whole:
            return True
        own = find_keys(self.keys, self.sent.keys) < len(self.keys)
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


def surveyed_blocks(points: tuple[Any, ...]) -> Declared:
    """Return the pattern of what `blocks.survey_blocks` finds."""
    own = _Assigned.of(points)
    return Where(
        Fixed(Whole(*own.total), BOX),
        lambda found: (
            bounds_some(found[1], found[0]) and (not found[0] or lie_in(found[1], own.box))
        ),
        "the box lies in the blocks",
    )


def counted_boxes(
    points: tuple[Any, ...],
    low: FloatArray,
    edges: tuple[float, ...],
    one_in: int,
    is_distinct: bool,
) -> Declared:
    """Return the pattern of what `blocks.count_block_boxes` counts."""
    own = _Assigned.of(points)
    if is_distinct or not own.is_whole:
        one_in = 0
    return Where(
        EachOf([sampled_boxes(own.points, own.cells("c", low, edge)) for edge in edges]),
        lambda found: all(is_share(own.points, one_in, n) for n, _ in found),
        "the boxes hold points of the blocks",
    )


def sampled_blocks(points: tuple[Any, ...], *_: Any) -> Declared:
    """Return the pattern of what `blocks.sample_blocks` takes."""
    own = _Assigned.of(points)
    low, high = own.box
    return Where(
        Fixed(Array("<f8", "s", 3, low=low, high=high), Array("<f8", "s", 3)),
        lambda found: own.samples(*found),
        _SAME_BLOCKS,
    )


def counted_cells(place: Place, blocks: IntArray, origin: FloatArray, size: float) -> Declared:
    """Return the pattern of what `blocks.count_block_cells` counts."""
    cloud = open_place(place)
    own = _Assigned.among(cloud.arrangement, cloud, blocks)
    return Fixed(own.cells("c", origin, size), Array("<i8", "c", low=1, total=own.total))


def without_repeated(folder: str, blocks: IntArray, _target: tuple[str, int]) -> Declared:
    """Return the pattern of what `cleaning.drop_repeated_points` writes."""
    own = _Assigned.of((folder, blocks, None))

    def agrees(found: tuple[Any, ...]) -> bool:
        repeated, keys, counts = found
        rows = find_keys(own.keys, keys)
        if not lie_within(rows, 0, len(own.keys)):
            return False
        lost = own.counts[rows] - counts
        return bool((lost > 0).all()) and int(lost.sum()) == repeated

    keys, counts = Array("<i8", "b", low=0, rises=True), Array("<i8", "b", low=1)
    return Where(
        Fixed(Whole(0, own.points), keys, counts), agrees, "blocks lack the points that are dropped"
    )


def cleaned_region(
    points: tuple[Any, ...],
    low: FloatArray,
    spacing: float,
    target: tuple[str, int] | None,
    _sampled: tuple[float, int],
) -> Declared:
    """Return the pattern of what `cleaning.clean_blocks` returns."""
    own = _Assigned.of(points)
    ranks, mended = _ranks(own, low, EDGE * spacing), _mended(own, target)
    return Where(
        Fixed(ranks, Either(Nothing(), mended)),
        lambda found: (found[1] is None) == has_sparse(found[0]),
        "a region is mended where no cell is sparse",
    )


def _ranks(own: _Assigned, low: FloatArray, size: float) -> Declared:
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


def stray_cells(points: tuple[Any, ...], low: FloatArray, spacing: float, _base: int) -> Declared:
    """Return the pattern of what `cleaning.judge_blocks` finds."""
    own = _Assigned.of(points)
    return Where(
        own.cells("s", low, EDGE * spacing),
        lambda cells: len(cells) <= own.points,
        "each cell holds a point",
    )


def mended_region(
    points: tuple[Any, ...],
    _low: FloatArray,
    _spacing: float,
    target: tuple[str, int] | None,
    _sampled: tuple[float, int],
) -> Declared:
    """Return the pattern of what `cleaning.mend_blocks` returns."""
    return _mended(_Assigned.of(points), target)


def _mended(own: _Assigned, target: tuple[str, int] | None) -> Declared:
    (low, high), most = own.box, np.full(3, _UNIT)

    def agrees(mended: tuple[Any, ...]) -> bool:
        replaced, flipped, sample = mended
        is_same = replaced is None
        return (
            is_same == (flipped == 0) if own.is_whole else not (is_same and flipped)
        ) and own.samples(*sample)

    bounds = (np.stack(rows)[:, None] for rows in ((low, -most), (high, most)))
    sample = Array("<f8", 2, "s", 3, low=next(bounds), high=next(bounds))
    replaced = own.written() if target is not None else own.packed(_UNIT, are_units)
    return Where(
        Fixed(Either(Nothing(), replaced), Whole(0, own.points), sample),
        agrees,
        "points are written where something of them has changed",
    )


def estimated_region(
    points: tuple[Any, ...],
    _low: FloatArray,
    spacing: float,
    _keeps: bool,
    target: tuple[str, int] | None,
) -> Declared:
    """Return the pattern of what `normals.estimate_blocks` returns."""
    own = _Assigned.of(points)
    return own.packed(_MOST_NOISE * spacing) if target is None else own.written()


def turned_region(
    points: tuple[Any, ...],
    _low: FloatArray,
    _spacing: float,
    _sides: Any,
    target: tuple[str, int] | None,
) -> Declared:
    """Return the pattern of what `normals.turn_blocks` returns."""
    own = _Assigned.of(points)
    replaced = own.packed(_UNIT, are_units) if target is None else own.written()
    bins = Array("<i8", CONFIDENCE_BINS, low=0, total=own.total)
    return Fixed(replaced, Whole(0, own.points), bins)


def grouped_region(points: tuple[Any, ...], low: FloatArray, spacing: float) -> Declared:
    """Return the pattern of what `normals.group_blocks` finds."""
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
