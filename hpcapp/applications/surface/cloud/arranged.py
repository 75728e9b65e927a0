"""An arranged cloud, wherever it lies: its blocks, and the points in some of them.

Whoever works through a cloud asks for whole blocks, so that it need not be in memory. Here is
the cloud that is; `disk` has the one that is not. Both give the same points, bit for bit, and
answer the same questions, so that nobody else asks which of them it is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple
from itertools import pairwise
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from hpcapp import kernels
from hpcapp.applications.surface.cloud.arrangement import (
    Arrangement,
    PackedPoints,
    choose_arrangement,
    pack_points,
    snap_points,
)
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.applications.surface.types.reading import UNREAD, Reading
from hpcapp.cancellation import check_cancelled
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.lattice import find_keys
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray, PointCloud
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import HpcError

Points = tuple[FloatArray, FloatArray]
"""Positions in length units of the input and unit normals, each of shape (n, 3)."""

_ROWS_AT_ONCE = 1 << 14  # what is made of them stays in the cache
_ENDLESS = Arrangement(np.zeros(3), np.inf)


@dataclass(frozen=True, slots=True, eq=False)
class CloudMeasures:
    """What a method asks of a cloud before it chooses its cells.

    The noise is judged by `sample`, in the cloud's order; `reading` tells what the scan is of.
    """

    scale: LocalScale
    sample: PointCloud
    reading: Reading = UNREAD

    @property
    def spacing(self) -> float:
        """Of the whole cloud, in length units of the input."""
        return self.scale.spacing

    def to_values(self) -> tuple[Any, ...]:
        """Return them as values that a store takes."""
        columns = self.sample.positions, self.sample.normals
        return astuple(self.scale), *columns, self.reading.to_json()

    @classmethod
    def of_values(cls, values: tuple[Any, ...]) -> Self:
        """Return what `to_values` has told."""
        scale, positions, normals, reading = values
        return cls(LocalScale(*scale), PointCloud(positions, normals), Reading.of_json(reading))


class ArrangedCloud(Protocol):
    """Points with normals, snapped and sorted as an arrangement says.

    Of the occupied blocks there are the sorted `keys` (b,) and the `counts` (b,) of points; `low`
    and `high` (3,) are the corners of the box around all points, and `origin` (3,) was subtracted
    from the input's coordinates. Tasks read the cloud from its `place` (see `disk.open_place`);
    `is_here` says whether it is in this process's memory, `measured` what `measure.measure_cloud`
    has noted.
    """

    @property
    def arrangement(self) -> Arrangement: ...  # noqa: D102 - see the class

    @property
    def origin(self) -> FloatArray: ...  # noqa: D102 - see the class

    @property
    def keys(self) -> IntArray: ...  # noqa: D102 - see the class

    @property
    def counts(self) -> IntArray: ...  # noqa: D102 - see the class

    @property
    def low(self) -> FloatArray: ...  # noqa: D102 - see the class

    @property
    def high(self) -> FloatArray: ...  # noqa: D102 - see the class

    @property
    def is_here(self) -> bool: ...  # noqa: D102 - see the class

    @property
    def place(self) -> Place: ...  # noqa: D102 - see the class

    @property
    def measured(self) -> CloudMeasures: ...  # noqa: D102 - see the class

    def __len__(self) -> int: ...

    def take_blocks(self, keys: IntArray) -> Points:
        """Return the points in some blocks, (m, 3), block after block, each in the input's order.

        The keys (k,) are sorted and unique; those of blocks without points are passed over.
        """

    def take_within(self, keys: IntArray, low: FloatArray, high: FloatArray) -> Points:
        """Return the same points as `take_blocks`; those outside of a box may be missing."""

    def take_columns(self, keys: IntArray) -> PointCloud:
        """Return the same points as `take_blocks`, with the attributes that lie beside them."""

    def take_all(self, most: float, refusal: HpcError) -> PointCloud:
        """Return all points; raise `refusal` instead of reading more than `most` of them."""

    def take_packed(self, keys: IntArray) -> PackedPoints:
        """Return the same points as `take_blocks`, packed."""

    def count_cells(
        self, keys: IntArray, origin: FloatArray, size: float
    ) -> tuple[IntArray, IntArray]:
        """Count the points of some blocks, one point or more, in the occupied cells of a lattice.

        `origin` (3,) is a corner of a cell; keys and counts (c,) of cells come sorted by key.
        """

    def sample(self, points: int) -> PointCloud:
        """Return about so many points, evenly from all of it; all where that costs nothing."""


Place = str | ArrangedCloud
"""Where a cloud lies: a folder, or the cloud itself where it is in this process's memory."""


@dataclass(frozen=True, slots=True, eq=False)
class MemoryCloud:
    """An arranged cloud in memory; see `ArrangedCloud`.

    The points have normals; block i holds those from offsets[i] to offsets[i + 1], shape (b + 1,).
    """

    points: PointCloud
    arrangement: Arrangement
    keys: IntArray
    offsets: IntArray
    low: FloatArray
    high: FloatArray
    noted: CloudMeasures | None = None

    @classmethod
    def as_they_are(cls, points: PointCloud) -> MemoryCloud:
        """Hold one point or more as they are in one endless block: the method cuts it up itself."""
        box = bound_points(points.positions)
        return cls(points, _ENDLESS, np.zeros(1, np.int64), np.array([0, len(points)]), *box)

    @property
    def is_here(self) -> bool:
        """Always."""
        return True

    @property
    def place(self) -> Place:
        """See `ArrangedCloud`."""
        return self

    @property
    def origin(self) -> FloatArray:
        """See `ArrangedCloud`."""
        return self.points.origin

    @property
    def counts(self) -> IntArray:
        """See `ArrangedCloud`."""
        return np.diff(self.offsets)

    def __len__(self) -> int:
        return len(self.points)

    def take_blocks(self, keys: IntArray) -> Points:
        """See `ArrangedCloud`; views where the blocks lie side by side."""
        assert self.points.normals is not None  # noqa: S101 - checked when it was arranged
        slices = self.find_rows(keys)
        positions = _join([self.points.positions[some] for some in slices])
        return positions, _join([self.points.normals[some] for some in slices])

    def take_within(self, keys: IntArray, low: FloatArray, high: FloatArray) -> Points:
        """See `ArrangedCloud`: all of them."""
        del low, high
        return self.take_blocks(keys)

    def take_columns(self, keys: IntArray) -> PointCloud:
        """See `ArrangedCloud`; a view where the blocks lie side by side. Colours come too."""
        slices = self.find_rows(keys)
        if len(slices) < 2:
            return self.points.view(*slices or [slice(0)])
        return self.points.take(list_rows(slices))

    def take_all(self, most: float, refusal: HpcError) -> PointCloud:
        """See `ArrangedCloud`: none are read."""
        del most, refusal
        return self.points

    def find_rows(self, keys: IntArray) -> list[slice]:
        """Return where the points of some blocks are, whose keys (k,) are sorted."""
        rows = find_keys(self.keys, keys)
        runs = find_runs(rows[rows < len(self.keys)])
        return [slice(int(self.offsets[run.start]), int(self.offsets[run.stop])) for run in runs]

    def take_packed(self, keys: IntArray) -> PackedPoints:
        """See `ArrangedCloud`."""
        points = self.take_blocks(keys)
        if not len(points[0]):
            none = np.empty(0, np.int64)
            return PackedPoints.from_records(none, none, np.empty((0, 6), np.float32))
        return pack_points(self.arrangement, *points)

    def count_cells(
        self, keys: IntArray, origin: FloatArray, size: float
    ) -> tuple[IntArray, IntArray]:
        """See `ArrangedCloud`."""
        cells, offsets, _ = kernels.sort_points(self.take_blocks(keys)[0], origin, size)
        return cells, np.diff(offsets)

    @property
    def measured(self) -> CloudMeasures:
        """See `ArrangedCloud`."""
        assert self.noted is not None  # noqa: S101 - or there is nothing to ask
        return self.noted

    def sample(self, points: int) -> PointCloud:
        """See `ArrangedCloud`."""
        del points  # all of them are here
        return self.points

    def select(self, kept: BoolArray) -> MemoryCloud:
        """Return the points (one or more) that a mask (n,) names, without blocks left empty."""
        # (b,): the points of each block that stay; blocks stand side by side, none of them empty.
        counts = np.add.reduceat(kept, self.offsets[:-1], dtype=np.int64)
        offsets = np.append(0, np.cumsum(counts[counts > 0]))
        points, keys = self.points.take(kept), self.keys[counts > 0]
        box = self.arrangement.bound(*bound_points(points.positions))
        return MemoryCloud(points, self.arrangement, keys, offsets, *box)


def arrange_cloud(
    cloud: PointCloud,
    choose: Callable[[FloatArray, FloatArray], Arrangement] = choose_arrangement,
) -> MemoryCloud:
    """Snap a cloud's finite points and sort them by blocks; InputError where all are the same.

    How its blocks are chosen by its box may be another way than its own (see `frame`).
    """
    box = bound_points(cloud.positions)
    arrangement = choose(*box)
    snapped = snap_points(arrangement, cloud.positions)
    keys, offsets, rows = kernels.sort_points(snapped, arrangement.origin, arrangement.edge)
    check_cancelled()
    positions = snapped.take(rows, axis=0)
    del snapped  # makes room for the normals
    normals = None if cloud.normals is None else _take_singles(cloud.normals, rows)
    colours = None if cloud.colours is None else cloud.colours.take(rows, axis=0)
    attributes = {name: column.take(rows) for name, column in cloud.attributes.items()}
    arranged = PointCloud(positions, normals, colours, attributes, cloud.origin)
    # Rounding leaves the least the least.
    low, high = arrangement.bound(*snap_points(arrangement, np.stack(box)))
    return MemoryCloud(arranged, arrangement, keys, offsets, low, high)


def _take_singles(vectors: FloatArray, rows: NDArray[np.uint32]) -> FloatArray:
    """Take some rows, rounded to single precision."""
    taken = np.empty((len(rows), 3))
    for start in range(0, len(rows), _ROWS_AT_ONCE):
        check_cancelled()
        some = slice(start, start + _ROWS_AT_ONCE)
        taken[some] = vectors.take(rows[some], axis=0).astype(np.float32)
    return taken


def find_runs(rows: IntArray) -> list[slice]:
    """Return the runs of consecutive numbers among rising ones (k,)."""
    if not len(rows):
        return []
    breaks = np.flatnonzero(np.diff(rows) != 1) + 1
    bounds = [0, *breaks.tolist(), len(rows)]
    return [slice(int(rows[a]), int(rows[b - 1]) + 1) for a, b in pairwise(bounds)]


def list_rows(slices: Sequence[slice]) -> IntArray:
    """Return the numbers in some runs of rows, one run at least."""
    return np.concatenate([np.arange(run.start, run.stop) for run in slices])


def _join(parts: list[NDArray[Any]]) -> NDArray[Any]:
    if not parts:
        return np.zeros((0, 3))
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
