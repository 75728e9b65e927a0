"""How a cloud is gone through: one way, for points in memory and for points in a folder.

::

    each(task)     region ── task ──> result          the points stay as they are
    rewrite(task)  region ── task ──> other points    the pass through these is the next one

A task is a pure function of a region (see `regions`). In memory it is called directly, mostly with
all points at once; in a folder workers run it, region by region.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface.cloud.arranged import (
    ArrangedCloud,
    CloudMeasures,
    MemoryCloud,
    list_rows,
)
from hpcapp.applications.surface.cloud.cutting import cut_regions, find_near_blocks
from hpcapp.applications.surface.cloud.regions import MemoryRegion, ReplacedRows
from hpcapp.cancellation import check_cancelled
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.lattice import find_keys
from hpcapp.geometry.points import BoolArray, Float32Array, FloatArray, IntArray
from hpcapp.progress import Progress
from hpccomponent.dataclass import dataclass

Rows = IntArray | slice
Result = TypeVar("Result")
PassT = TypeVar("PassT", bound="CloudPass")

POINTS_AT_ONCE = 1 << 19
"""Of a region in memory: tasks with margins hold much of each point."""
_SMALLER = 1.5  # regions than that, as blocks are uneven: few need to be halved then


class CloudPass(Protocol):
    """How a cloud is gone through."""

    @property
    def cloud(self) -> ArrangedCloud:
        """The points."""

    @property
    def threads(self) -> int:
        """How many this process may take between passes."""

    def each(self, task: Callable[..., Result], *given: Any, margin: float = 0.0) -> list[Result]:
        """Run a task for each region.

        A registered task of `RegionPoints` is given these and `given`, and looks `margin` around
        its region. Without a margin the results come in the order of the cloud, else in any.
        """

    def rewrite(
        self: PassT,
        task: Callable[..., Any],
        *given: Any,
        margin: float = 0.0,
        accepts: Callable[[list[Any]], bool] = lambda _: True,
        attribute: str | None = None,
    ) -> tuple[PassT, list[Any]]:
        """Replace the points by what a task makes of them, region by region.

        The task returns a tuple that begins with what its region's own points become (see
        `MemoryRegion`), None where they stay; the rest of the tuples is returned, and no point is
        replaced if `accepts` says no to it. With an `attribute` all points are replaced: the last
        value of a tuple, float32 (m,), is kept beside them, and none of them may be dropped later.
        If the pass that is returned is another, this one's points are not there any more.
        """

    def watched(self: PassT, progress: Progress, passes: Mapping[str, int]) -> PassT:
        """Return the same pass, which tells how far stages of about so many `passes` have come.

        It does so where the points lie in a folder: in memory they are soon done.
        """

    def note(self: PassT, measured: CloudMeasures) -> PassT:
        """Keep what was found out about the cloud with it."""


@dataclass(frozen=True, slots=True, eq=False)
class MemoryPass:
    """The pass through a cloud in memory, whose tasks may take so many threads."""

    cloud: MemoryCloud
    threads: int = 1

    def each(self, task: Callable[..., Result], *given: Any, margin: float = 0.0) -> list[Result]:
        """See `CloudPass`."""
        return [task(region, *given) for region in self._cut(margin)]

    def rewrite(
        self,
        task: Callable[..., Any],
        *given: Any,
        margin: float = 0.0,
        accepts: Callable[[list[Any]], bool] = lambda _: True,
        attribute: str | None = None,
    ) -> tuple[MemoryPass, list[Any]]:
        """See `CloudPass`."""
        results = self.each(task, *given, margin=margin)
        changes = [replaced for replaced, *_ in results if replaced is not None]
        others = [tuple(rest) for _, *rest in results]
        added = {}
        if attribute is not None:
            values = [(some.rows, rest[-1]) for some, rest in zip(changes, others, strict=True)]
            added = {attribute: _place(values, np.empty(len(self.cloud), np.float32))}
            others = [rest[:-1] for rest in others]
        return self._replace(changes, added) if accepts(others) else self, others

    def watched(self, progress: Progress, passes: Mapping[str, int]) -> MemoryPass:
        """See `CloudPass`."""
        del progress, passes
        return self

    def note(self, measured: CloudMeasures) -> MemoryPass:
        """See `CloudPass`."""
        return replace(self, cloud=replace(self.cloud, noted=measured))

    def _cut(self, margin: float) -> Iterator[MemoryRegion]:
        """Yield the regions: all points at once where they are few, or no margin is asked for.

        Blocks are cut first, so that of each region only the points in blocks around are looked at.
        """
        cloud, points = self.cloud, self.cloud.points
        positions, normals = points.positions, points.normals
        if not margin or len(positions) <= POINTS_AT_ONCE:
            own = np.ones(len(positions), np.bool_)
            yield MemoryRegion(positions, normals, own, slice(None), self.threads)
            return
        pieces = int(_SMALLER * len(positions) / POINTS_AT_ONCE) + 1
        steps = int(np.ceil(margin / cloud.arrangement.edge))
        for blocks in cut_regions(cloud.keys, cloud.counts, pieces):
            around = list_rows(cloud.find_rows(find_near_blocks(cloud.keys, blocks, steps)))
            for rows in _cut_boxes(positions, list_rows(cloud.find_rows(blocks))):
                check_cancelled()
                near, own = _find_near(positions, rows, around, margin)
                given = None if normals is None else normals[near]
                yield MemoryRegion(positions[near], given, own, rows, self.threads)

    def _replace(
        self, changes: list[ReplacedRows], added: Mapping[str, Float32Array]
    ) -> MemoryPass:
        """Return the pass through what some changes leave of the points."""
        if not changes:
            return self
        points, count = self.cloud.points, len(self.cloud)
        kept = [(some.rows, some.kept) for some in changes if some.kept is not None]
        normals = [(some.rows, some.normals) for some in changes if some.normals is not None]
        attributes = {**added, **points.attributes}
        if normals:
            points = replace(points, normals=_place(normals, points.normals))
        cloud = replace(self.cloud, points=replace(points, attributes=attributes))
        if kept:
            cloud = cloud.select(_place(kept, np.ones(count, np.bool_)))
        return replace(self, cloud=cloud)


def _place(columns: list[tuple[Rows, NDArray[Any]]], others: NDArray[Any] | None) -> NDArray[Any]:
    """Return new values of some points, and what the others have."""
    rows, values = columns[0]
    if isinstance(rows, slice):  # these are all
        return values
    shape = (sum(len(some) for _, some in columns), *values.shape[1:])
    placed = np.empty(shape, values.dtype) if others is None else others.astype(values.dtype)
    for rows, values in columns:
        placed[rows] = values
    return placed


def _cut_boxes(positions: FloatArray, rows: IntArray) -> list[IntArray]:
    """Cut points into boxes of a few each, by halving across the longest side."""
    if len(rows) <= POINTS_AT_ONCE:
        return [rows]
    check_cancelled()
    low, high = bound_points(positions[rows])
    column = positions[rows, int(np.argmax(high - low))]
    # Halves of as many points, unless very many share a coordinate: then they stay together.
    is_below = column < np.median(column)
    if is_below.all() or not is_below.any():
        return [rows]
    halves = rows[is_below], rows[~is_below]
    return [box for half in halves for box in _cut_boxes(positions, half)]


def _find_near(
    positions: FloatArray, rows: IntArray, around: IntArray, margin: float
) -> tuple[IntArray, BoolArray]:
    """Return some points and those near them of what lies around, and which are the points."""
    low, high = bound_points(positions[rows])
    columns = zip(positions[around].T, low - margin, high + margin, strict=True)
    # (a,): in the box around them and the margin, so that some are farther off than that.
    is_near = np.logical_and.reduce([(column >= a) & (column <= b) for column, a, b in columns])
    near = around[is_near]
    return near, find_keys(rows, near) < len(rows)
