"""The canonical order and rounding of a cloud: the same points in memory, on disk and on the wire.

::

    positions ── snapped to multiples of a quantum ── sorted stably by blocks of 2^24 quanta

All steps are powers of two, so that every number here is exact: a position is its block's place
and an offset that float32 holds without rounding, 24 bytes with its normal instead of 48.

The functions with `records` are kernels.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import frexp
from typing import Any

import numpy as np

from hpcapp.applications.surface import kernels
from hpcapp.applications.surface.types.lattice import unpack_keys
from hpcapp.applications.surface.types.points import Float32Array, FloatArray, IntArray
from hpccomponent.errors import InputError
from hpccomponent.protocol.records import record

__all__ = [
    "Arrangement",
    "PackedPoints",
    "choose_arrangement",
    "interleave",
    "pack_points",
    "pack_snapped",
    "snap_points",
    "unpack_near",
    "unpack_points",
    "unpacking_arguments",
]


QUANTA_BITS = 24
"""Of an offset within a block: the significand of float32."""


_ROWS_AT_ONCE = 1 << 14  # what is made of them stays in the cache
_RECORDS_AT_ONCE = 1 << 16  # so do these, as whole pages of a file
_BLOCKS_BITS = 6  # at most 2^6 blocks along the longest side, and more than half of that


@record("surface.arrangement")
@dataclass(frozen=True, slots=True, eq=False)
class Arrangement:
    """The lattice of blocks that a cloud is sorted by.

    Parameters
    ----------
    origin : ndarray of float64, shape (3,)
        Corner of block (0, 0, 0): a multiple of `edge`.
    edge : float
        Of a block, in length units of the input: a power of two.
    """

    origin: FloatArray
    edge: float

    @property
    def quantum(self) -> float:
        """What all positions are multiples of, in length units of the input."""
        return self.edge * 2.0**-QUANTA_BITS


@record("surface.packed_points")
@dataclass(frozen=True, slots=True, eq=False)
class PackedPoints:
    """Arranged points in half the bytes, without loss.

    Parameters
    ----------
    keys : ndarray of int64, shape (b,)
        Sorted keys of the occupied blocks (see `lattice.pack_places`).
    counts : ndarray of int64, shape (b,)
        Points in each block.
    offsets : ndarray of float32, shape (n, 3)
        Block after block, from the block's corner, in blocks: 0 or more, below 1.
    normals : ndarray of float32, shape (n, 3)
    """

    keys: IntArray
    counts: IntArray
    offsets: Float32Array
    normals: Float32Array

    def __len__(self) -> int:
        return len(self.offsets)

    @classmethod
    def from_records(cls, keys: IntArray, counts: IntArray, records: Float32Array) -> PackedPoints:
        """Return points whose offsets and normals lie side by side, as they do on disk.

        Parameters
        ----------
        keys, counts : ndarray of int64, shape (b,)
            See the class.
        records : ndarray of float32, shape (n, 6)
            Offset and normal of each point.

        Returns
        -------
        PackedPoints
            Views of the records.
        """
        return cls(keys, counts, records[:, :3], records[:, 3:])

    def to_records(self) -> Float32Array:
        """Return offsets and normals side by side; without a copy where they lie so already."""
        base: Any = self.offsets.base
        is_shared = isinstance(base, np.ndarray) and base is self.normals.base
        if is_shared and base.shape == (len(self), 6):
            records: Float32Array = base
            return records
        return np.concatenate([self.offsets, self.normals], axis=1)


def choose_arrangement(low: FloatArray, high: FloatArray) -> Arrangement:
    """Choose the blocks of a cloud.

    Parameters
    ----------
    low, high : ndarray of float64, shape (3,)
        Corners of the box around all points, in length units of the input.

    Returns
    -------
    Arrangement
        Its edge is the power of two in [longest side / 64, longest side / 32).

    Raises
    ------
    InputError
        All points are the same.

    Examples
    --------
    >>> choose_arrangement(np.zeros(3), np.array([1.0, 0.5, 0.2])).edge
    0.015625
    """
    longest = float((high - low).max())
    if not longest > 0.0:
        raise InputError("all points lie at one place", "scan something with an extent")
    fraction, exponent = frexp(longest)
    edge = 2.0 ** (exponent - _BLOCKS_BITS - (fraction == 0.5))
    return Arrangement(np.floor(low / edge) * edge, edge)


def snap_points(arrangement: Arrangement, positions: FloatArray) -> FloatArray:
    """Round positions to multiples of the quantum.

    Parameters
    ----------
    arrangement : Arrangement
    positions : ndarray of float64, shape (n, 3)
        In length units of the input.

    Returns
    -------
    ndarray of float64, shape (n, 3)
        A copy; each coordinate moves by less than 1e-9 of the longest side.
    """
    snapped = np.empty_like(positions)
    quantum = arrangement.quantum
    for start in range(0, len(positions), _ROWS_AT_ONCE):
        rows = slice(start, start + _ROWS_AT_ONCE)
        part = np.divide(positions[rows], quantum, out=snapped[rows])
        np.rint(part, out=part)
        part *= quantum
    snapped += 0.0  # no negative zeros: equal positions have equal bytes
    return snapped


def pack_points(
    arrangement: Arrangement, positions: FloatArray, normals: FloatArray
) -> PackedPoints:
    """Snap points, sort them by blocks and pack them.

    Parameters
    ----------
    arrangement : Arrangement
    positions, normals : ndarray of float64, shape (n, 3)
        At least one point; the positions in length units of the input.

    Returns
    -------
    PackedPoints
        Within a block the points keep their order.

    Raises
    ------
    InputError, ValueError
        A point lies more than 2^20 blocks away.
    """
    return pack_snapped(arrangement, snap_points(arrangement, positions), normals)


def pack_snapped(
    arrangement: Arrangement, snapped: FloatArray, normals: FloatArray
) -> PackedPoints:
    """Pack points that have been snapped; as `pack_points` else."""
    points = np.ascontiguousarray(snapped, np.float64), np.ascontiguousarray(normals, np.float64)
    return PackedPoints.from_records(
        *kernels.pack_records(*points, arrangement.origin, arrangement.edge)
    )


def unpack_points(arrangement: Arrangement, packed: PackedPoints) -> tuple[FloatArray, FloatArray]:
    """Return the points that were packed, bit for bit as `snap_points` rounded them.

    Returns
    -------
    positions : ndarray of float64, shape (n, 3)
        In length units of the input.
    normals : ndarray of float64, shape (n, 3)
        Those of float32.
    """
    return kernels.unpack_records(*unpacking_arguments(arrangement, packed))


def unpack_near(
    arrangement: Arrangement, packed: PackedPoints, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Return those of the positions that were packed that lie in a box; see `unpack_points`.

    Parameters
    ----------
    arrangement : Arrangement
    packed : PackedPoints
    low, high : ndarray of float64, shape (3,)
        Corners of the box, in length units of the input.

    Returns
    -------
    positions : ndarray of float64, shape (m, 3)
    rows : ndarray of int64, shape (m,)
        Which ones they are.
    """
    return kernels.unpack_within(*unpacking_arguments(arrangement, packed), low, high)


def unpacking_arguments(
    arrangement: Arrangement, packed: PackedPoints
) -> tuple[Float32Array, IntArray, FloatArray, float]:
    """Return what the kernels take that unpack points.

    Returns
    -------
    records, counts, corners, edge
        See `unpack_records`.
    """
    corners = unpack_keys(packed.keys) * arrangement.edge + arrangement.origin
    counts = np.ascontiguousarray(packed.counts, np.int64)
    return packed.to_records(), counts, corners, arrangement.edge


def interleave(
    pieces: Sequence[PackedPoints], at_once: int = _RECORDS_AT_ONCE
) -> Iterator[memoryview]:
    """Yield the records of some pieces, block after block.

    Parameters
    ----------
    pieces : sequence of PackedPoints
        The points of each block come in the order of the pieces.
    at_once : int
        Records that are yielded at a time, where there are several pieces.

    Yields
    ------
    memoryview
        Of some records at a time; see `PackedPoints.to_records`.
    """
    if len(pieces) == 1:
        yield pieces[0].to_records().reshape(-1).view(np.uint8).data
        return
    records = np.concatenate([piece.to_records() for piece in pieces])
    counts = np.concatenate([piece.counts for piece in pieces])
    order = np.argsort(np.concatenate([piece.keys for piece in pieces]), kind="stable")
    sizes = counts[order]
    ends = np.cumsum(sizes)
    moves = (np.cumsum(counts) - counts)[order] - (ends - sizes)  # from where a block's come
    for start in range(0, len(records), at_once):
        stop = min(start + at_once, len(records))
        first, last = np.searchsorted(ends, (start, stop - 1), "right")
        runs = slice(first, last + 1)
        within = np.diff(np.clip(ends[runs], None, stop), prepend=start)
        rows = np.repeat(moves[runs], within) + np.arange(start, stop)
        yield records.take(rows, axis=0).reshape(-1).view(np.uint8).data
