"""The canonical order and rounding of a cloud: the same points in memory, on disk and on the wire.

::

    positions ── snapped to the middles of quanta ── sorted stably by blocks of 2^23 quanta

Blocks are laid by the cloud's box alone: wherever a cloud lies, and whatever its unit, the same
points share a block and a quantum. A position is its block's place and an offset that float32
holds without rounding, 24 bytes with its normal instead of 48. Middles lie on no face: rounding
moves none of them to another quantum, so that what is snapped or packed again stays as it is.

The functions with `records` are kernels.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Annotated, Any

import numpy as np

from hpcapp import kernels
from hpcapp.geometry.lattice import lay_lattice, unpack_keys
from hpcapp.geometry.points import Float32Array, FloatArray, IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError
from hpccomponent.protocol.columns import Column
from hpccomponent.protocol.records import record

_ROWS_AT_ONCE = 1 << 14  # what is made of them stays in the cache
RECORDS_AT_ONCE = 1 << 16
"""So do these; of whatever size, they are whole pages of a file."""
_BLOCKS = 63.0  # along the longest side
_BELOW_ONE = float(np.nextafter(np.float32(1.0), np.float32(0.0)))
_LEAST_EXTENT = 2.0**-20  # by the largest coordinate: a quantum is some of its last bits

BlockKeys = Annotated[IntArray, Column("b", low=0, rises=True)]
BlockCounts = Annotated[IntArray, Column("b", low=0)]


@record("surface.arrangement")
@dataclass(frozen=True, slots=True, eq=False)
class Arrangement:
    """The lattice of blocks that a cloud is sorted by.

    Block (0, 0, 0) has a corner at `origin` (3,); `edge` is the side of a block. A `box` (2, 3) is
    to be taken for the one around the points, wherever lattices are laid by that (see `frame`).
    """

    origin: FloatArray
    edge: float
    box: FloatArray | None = None

    @property
    def quantum(self) -> float:
        """What positions are rounded to, in length units of the input."""
        return self.edge / kernels.QUANTA

    def bound(self, low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the corners (3,) that a cloud's box is to have, given those around its points."""
        return (low, high) if self.box is None else (self.box[0], self.box[1])


@record("surface.packed_points")
@dataclass(frozen=True, slots=True, eq=False)
class PackedPoints:
    """Arranged points in b blocks, in half the bytes, without loss."""

    keys: BlockKeys
    """Of the occupied blocks (see `lattice.pack_places`)."""
    counts: BlockCounts
    """Points in each block."""
    offsets: Annotated[Float32Array, Column("n", 3, low=0.0, high=_BELOW_ONE, unit="blocks")]
    """Block after block, from the block's corner."""
    normals: Annotated[Float32Array, Column("n", 3)]

    def __len__(self) -> int:
        return len(self.offsets)

    @classmethod
    def from_records(cls, keys: IntArray, counts: IntArray, records: Float32Array) -> PackedPoints:
        """Return points whose offsets and normals lie side by side, (n, 6), as views of these."""
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
    """Choose a cloud's blocks by the box around it; InputError where all points are the same.

    The longest side has 63 blocks, and touches 64 of them; fewer where float64 holds the
    coordinates no finer.

    Examples
    --------
    >>> choose_arrangement(np.zeros(3), np.array([126.0, 50.0, 20.0])).edge
    2.0
    """
    longest = float((high - low).max())
    if not longest > 0.0:
        raise InputError("all points lie at one place", "scan something with an extent")
    largest = float(np.abs([low, high]).max())
    edge = max(longest, _LEAST_EXTENT * largest) / _BLOCKS
    return Arrangement(lay_lattice(low, edge), edge)


def snap_points(arrangement: Arrangement, positions: FloatArray) -> FloatArray:
    """Return a copy of positions (n, 3), moved to the middles of the quanta that they lie in.

    They are what `unpack_points` gives; a coordinate moves by less than 1e-9 of the longest side.
    """
    snapped = np.empty_like(positions)
    for start in range(0, len(positions), _ROWS_AT_ONCE):
        rows = slice(start, start + _ROWS_AT_ONCE)
        part = np.subtract(positions[rows], arrangement.origin, out=snapped[rows])
        part /= arrangement.edge
        # (r, 3): the block of each, and from its corner, in blocks, what is left.
        corners = np.floor(part)
        part -= corners
        # In quanta: down to a whole one and up to its middle, then as a length.
        part *= kernels.QUANTA
        np.floor(part, out=part)
        part += 0.5
        part *= arrangement.quantum
        # Corner and offset are summed as `unpack_points` does, so that both give the same bits.
        corners *= arrangement.edge
        corners += arrangement.origin
        part += corners
    return snapped


def pack_points(
    arrangement: Arrangement, positions: FloatArray, normals: FloatArray
) -> PackedPoints:
    """Sort one point or more by blocks, and pack them as `snap_points` rounds them.

    In a block they keep their order; InputError or ValueError where one is over 2^20 blocks away.
    """
    points = np.ascontiguousarray(positions, np.float64), np.ascontiguousarray(normals, np.float64)
    return PackedPoints.from_records(
        *kernels.pack_records(*points, arrangement.origin, arrangement.edge)
    )


def unpack_points(arrangement: Arrangement, packed: PackedPoints) -> tuple[FloatArray, FloatArray]:
    """Return positions, bit for bit as `snap_points` rounded them, and normals, as float32 held."""
    return kernels.unpack_records(*unpacking_arguments(arrangement, packed))


def unpack_near(
    arrangement: Arrangement, packed: PackedPoints, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, IntArray]:
    """Return the positions (m, 3) of `unpack_points` that lie in a box, and their rows (m,)."""
    return kernels.unpack_within(*unpacking_arguments(arrangement, packed), low, high)


def unpacking_arguments(
    arrangement: Arrangement, packed: PackedPoints
) -> tuple[Float32Array, IntArray, FloatArray, float]:
    """Return what the kernels' `unpack_records` takes: records, counts, corners and edge."""
    corners = unpack_keys(packed.keys) * arrangement.edge + arrangement.origin
    counts = np.ascontiguousarray(packed.counts, np.int64)
    return packed.to_records(), counts, corners, arrangement.edge


def interleave(
    pieces: Sequence[PackedPoints], at_once: int = RECORDS_AT_ONCE
) -> Iterator[Float32Array]:
    """Yield the records of some pieces, block after block, `at_once` at a time: (r, 6) each.

    The points of each block come in the order of the pieces.
    """
    if len(pieces) == 1:
        records = pieces[0].to_records()
        yield from (records[start : start + at_once] for start in range(0, len(records), at_once))
        return
    records = np.concatenate([piece.to_records() for piece in pieces])
    counts = np.concatenate([piece.counts for piece in pieces])
    # (p,): the blocks of all pieces by key; those of one key stay in the order of the pieces.
    order = np.argsort(np.concatenate([piece.keys for piece in pieces]), kind="stable")
    sizes = counts[order]
    ends = np.cumsum(sizes)
    moves = (np.cumsum(counts) - counts)[order] - (ends - sizes)  # from where a block's come
    for start in range(0, len(records), at_once):
        stop = min(start + at_once, len(records))
        # The blocks that these records are in, and (r,) how many of them are in each.
        first, last = np.searchsorted(ends, (start, stop - 1), "right")
        runs = slice(first, last + 1)
        within = np.diff(np.clip(ends[runs], None, stop), prepend=start)
        rows = np.repeat(moves[runs], within) + np.arange(start, stop)
        yield records.take(rows, axis=0)
