"""An arranged cloud, wherever it lies: its blocks, and the points in some of them.

Whoever works through a cloud asks for whole blocks, so that it need not be in memory. Here is
the cloud that is; `disk_cloud` has the one that is not. Both give the same points, bit for bit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface import kernels
from hpccomponent.surface.cloud.arrangement import Arrangement, choose_arrangement, snap_points
from hpccomponent.surface.kernels import bound_points
from hpccomponent.surface.types.lattice import find_keys
from hpccomponent.surface.types.points import BoolArray, FloatArray, IntArray, PointCloud

__all__ = ["ArrangedCloud", "MemoryCloud", "Points", "arrange_cloud", "cut_blocks", "find_runs"]

_ROWS_AT_ONCE = 1 << 14  # what is made of them stays in the cache

Points = tuple[FloatArray, FloatArray]
"""Positions in length units of the input and unit normals, each of shape (n, 3)."""


class ArrangedCloud(Protocol):
    """Points with normals, snapped and sorted as an arrangement says.

    Parameters
    ----------
    arrangement : Arrangement
    origin : ndarray of float64, shape (3,)
        What was subtracted from the input's coordinates.
    keys, counts : ndarray of int64, shape (b,)
        Of the occupied blocks, sorted, and how many points each holds.
    low, high : ndarray of float64, shape (3,)
        Corners of the box around all points.
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

    def __len__(self) -> int: ...

    def take_blocks(self, keys: IntArray) -> Points:
        """Return the points in some blocks, block after block, each in the order of the input.

        Parameters
        ----------
        keys : ndarray of int64, shape (k,)
            Sorted, unique; those of blocks without points are passed over.

        Returns
        -------
        positions, normals : ndarray of float64, shape (m, 3)
            See `Points`.
        """

    def groups(self, points: int) -> Iterator[Points]:
        """Yield all points in runs of whole blocks.

        Parameters
        ----------
        points : int
            About so many at a time.

        Yields
        ------
        positions, normals : ndarray of float64, shape (m, 3)
            See `Points`.
        """


@dataclass(frozen=True, slots=True, eq=False)
class MemoryCloud:
    """An arranged cloud in memory; see `ArrangedCloud`.

    Parameters
    ----------
    cloud : PointCloud
        With normals; arranged.
    arrangement : Arrangement
    keys : ndarray of int64, shape (b,)
    offsets : ndarray of int64, shape (b + 1,)
        Block i holds the points offsets[i] to offsets[i + 1].
    """

    cloud: PointCloud
    arrangement: Arrangement
    keys: IntArray
    offsets: IntArray

    @property
    def origin(self) -> FloatArray:
        """See `ArrangedCloud`."""
        return self.cloud.origin

    @property
    def counts(self) -> IntArray:
        """See `ArrangedCloud`."""
        return np.diff(self.offsets)

    @property
    def low(self) -> FloatArray:
        """See `ArrangedCloud`."""
        return bound_points(self.cloud.positions)[0]

    @property
    def high(self) -> FloatArray:
        """See `ArrangedCloud`."""
        return bound_points(self.cloud.positions)[1]

    def __len__(self) -> int:
        return len(self.cloud)

    def take_blocks(self, keys: IntArray) -> Points:
        """See `ArrangedCloud`; views where the blocks lie side by side."""
        assert self.cloud.normals is not None  # noqa: S101 - checked when it was arranged
        rows = find_keys(self.keys, keys)
        runs = find_runs(rows[rows < len(self.keys)])
        slices = [slice(self.offsets[run.start], self.offsets[run.stop]) for run in runs]
        positions = _join([self.cloud.positions[some] for some in slices])
        return positions, _join([self.cloud.normals[some] for some in slices])

    def groups(self, points: int) -> Iterator[Points]:
        """See `ArrangedCloud`."""
        for run in cut_blocks(self.counts, points):
            yield self.take_blocks(self.keys[run])

    def select(self, kept: BoolArray) -> MemoryCloud:
        """Return the points that a mask names, in the same blocks.

        Parameters
        ----------
        kept : ndarray of bool, shape (n,)

        Returns
        -------
        MemoryCloud
            Without the blocks that are left empty.
        """
        counts = np.add.reduceat(kept, self.offsets[:-1], dtype=np.int64)
        offsets = np.append(0, np.cumsum(counts[counts > 0]))
        return MemoryCloud(self.cloud.take(kept), self.arrangement, self.keys[counts > 0], offsets)


def arrange_cloud(cloud: PointCloud) -> MemoryCloud:
    """Snap a cloud's points and sort them by blocks.

    Parameters
    ----------
    cloud : PointCloud
        Finite positions.

    Returns
    -------
    MemoryCloud

    Raises
    ------
    InputError
        All points are the same.
    """
    arrangement = choose_arrangement(*bound_points(cloud.positions))
    snapped = snap_points(arrangement, cloud.positions)
    keys, offsets, rows = kernels.sort_points(snapped, arrangement.origin, arrangement.edge)
    positions = snapped.take(rows, axis=0)
    del snapped  # makes room for the normals
    normals = None if cloud.normals is None else _take_singles(cloud.normals, rows)
    colours = None if cloud.colours is None else cloud.colours.take(rows, axis=0)
    attributes = {name: column.take(rows) for name, column in cloud.attributes.items()}
    arranged = PointCloud(positions, normals, colours, attributes, cloud.origin)
    return MemoryCloud(arranged, arrangement, keys, offsets)


def _take_singles(vectors: FloatArray, rows: NDArray[np.uint32]) -> FloatArray:
    """Take some rows, rounded to single precision."""
    taken = np.empty((len(rows), 3))
    for start in range(0, len(rows), _ROWS_AT_ONCE):
        some = slice(start, start + _ROWS_AT_ONCE)
        taken[some] = vectors.take(rows[some], axis=0).astype(np.float32)
    return taken


def cut_blocks(counts: IntArray, points: int) -> list[slice]:
    """Cut a cloud into runs of whole blocks.

    Parameters
    ----------
    counts : ndarray of int64, shape (b,)
        Points in each block.
    points : int
        In a run, at most, unless one block has more.

    Returns
    -------
    list of slice
        Of the blocks.

    Examples
    --------
    >>> cut_blocks(np.array([3, 4, 9, 1, 1]), 8)
    [slice(0, 2, None), slice(2, 3, None), slice(3, 5, None)]
    """
    ends = np.cumsum(counts)
    bounds = [0]
    while bounds[-1] < len(counts):
        before = int(ends[bounds[-1] - 1]) if bounds[-1] else 0
        fitting = int(np.searchsorted(ends, before + points, side="right"))
        bounds.append(max(fitting, bounds[-1] + 1))
    return [slice(a, b) for a, b in pairwise(bounds)]


def find_runs(rows: IntArray) -> list[slice]:
    """Return the runs of consecutive numbers among rising ones.

    Parameters
    ----------
    rows : ndarray of int64, shape (k,)

    Returns
    -------
    list of slice
    """
    if not len(rows):
        return []
    breaks = np.flatnonzero(np.diff(rows) != 1) + 1
    bounds = [0, *breaks.tolist(), len(rows)]
    return [slice(int(rows[a]), int(rows[b - 1]) + 1) for a, b in pairwise(bounds)]


def _join(parts: list[NDArray[Any]]) -> NDArray[Any]:
    if not parts:
        return np.zeros((0, 3))
    return parts[0] if len(parts) == 1 else np.concatenate(parts)
