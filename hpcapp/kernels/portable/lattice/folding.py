"""Packed points as they lie on disk: whole numbers, each column in as many bits as it needs there.

::

    offsets ──> quanta                                           3 columns
    normal  ──> longest component, and its sign                  1
                steps of float32 from what the others leave it   1
                the two others, as bits with the sign last       2
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.points import ByteArray, Float32Array, IntArray
from hpcapp.kernels.constants import QUANTA

__all__ = ["bound_records", "fold_records", "unfold_records"]

_COLUMNS = 7  # see above
_WORDS = 4  # of 64 bits, with room for as many columns of 32
_SIGN = np.uint32(1 << 31)


def bound_records(records: Float32Array) -> IntArray:
    """Return the least and the largest number in each column of some records, (2, 7).

    Records (n, 6), one or more, are the offset and normal of a point: see `packing.pack_records`.
    """
    columns = _split(records)
    return np.stack([columns.min(axis=1), columns.max(axis=1)])


def fold_records(records: Float32Array, lows: IntArray, widths: IntArray) -> ByteArray:
    """Return records (n, 6) in fewer bytes, without loss: (n, s).

    Of each column, `lows` (7,) is the least number, and `widths` (7,) in how many bits, 32 at most,
    its distance from that fits. A record's s bytes hold the bits of all columns, the first one's
    least significant bit first.
    """
    words = np.zeros((len(records), _WORDS), "<u8")
    at = 0
    for column, low, width in zip(_split(records), lows.tolist(), widths.tolist(), strict=True):
        word, bit = divmod(at, 64)
        value = (column - low).astype(np.uint64)
        if (value >> np.uint64(width)).any():
            raise ValueError("records: one does not fit into the layout")
        words[:, word] |= value << np.uint64(bit)
        if bit + width > 64:
            words[:, word + 1] |= value >> np.uint64(64 - bit)
        at += width
    folded = words.view(np.uint8).reshape(len(words), 8 * _WORDS)[:, : max(1, -(-at // 8))]
    return np.ascontiguousarray(folded)


def unfold_records(
    folded: ByteArray,
    lows: IntArray,
    widths: IntArray,
    counts: IntArray,
    starts: IntArray,
    records: Float32Array,
) -> None:
    """Put records that were folded, (n, s), where they belong in `records` (m, 6).

    `lows` and `widths` (7,) are as for `fold_records`. There are `counts` (b,) of them, one block
    after the other; `starts` (b,) are the rows that the first of each goes to.
    """
    words = np.zeros((len(folded), 8 * _WORDS), np.uint8)
    words[:, : folded.shape[1]] = folded
    words = words.view("<u8")
    columns = np.empty((_COLUMNS, len(folded)), np.int64)
    at = 0
    for column, low, width in zip(columns, lows.tolist(), widths.tolist(), strict=True):
        word, bit = divmod(at, 64)
        value = words[:, word] >> np.uint64(bit)
        if bit + width > 64:
            value |= words[:, word + 1] << np.uint64(64 - bit)
        column[:] = (value & np.uint64((1 << width) - 1)).astype(np.int64) + low
        at += width
    rows = np.repeat(starts - (np.cumsum(counts) - counts), counts) + np.arange(len(folded))
    records[rows] = _join(columns)


def _split(records: Float32Array) -> IntArray:
    """Return the columns of some records, shape (7, n)."""
    columns = np.empty((_COLUMNS, len(records)), np.int64)
    quanta = records[:, :3].T * np.float32(QUANTA)
    if not ((quanta - np.floor(quanta) == 0.5) & (quanta >= 0.5) & (quanta < QUANTA)).all():
        raise ValueError("records: expected offsets in the middles of quanta")
    columns[:3] = quanta.astype(np.int64)
    normals = np.ascontiguousarray(records[:, 3:])
    bits = normals.view(np.uint32)
    longest = np.argmax(bits << np.uint32(1), axis=1)
    whole = _take_axis(bits, longest)
    one, other = (_take_axis(normals, (longest + step) % 3) for step in (1, 2))
    columns[3] = 2 * longest + (whole >> np.uint32(31))
    columns[4] = (whole & ~_SIGN).astype(np.int64) - _predict(one, other)
    for row, component in ((5, one), (6, other)):
        turned = component.view(np.uint32)
        columns[row] = turned << np.uint32(1) | turned >> np.uint32(31)
    return columns


def _join(columns: IntArray) -> Float32Array:
    """Return the records of some columns, shape (n, 6)."""
    records = np.empty((columns.shape[1], 6), np.float32)
    records[:, :3] = ((columns[:3].astype(np.float32) + np.float32(0.5)) / np.float32(QUANTA)).T
    longest, sign = np.divmod(columns[3], 2)
    turned = columns[5:].astype(np.uint32)
    one, other = (turned >> np.uint32(1) | turned << np.uint32(31)).view(np.float32)
    whole = (columns[4] + _predict(one, other)).astype(np.uint32) | sign.astype(np.uint32) << 31
    rows = np.arange(len(records))
    for step, component in enumerate((whole.view(np.float32), one, other)):
        records[rows, 3 + (longest + step) % 3] = component
    return records


def _predict(one: Float32Array, other: Float32Array) -> IntArray:
    """Return the bits of what two components of a vector of length 1 leave to the third."""
    with np.errstate(over="ignore", invalid="ignore"):
        left = 1.0 - one.astype(np.float64) ** 2 - other.astype(np.float64) ** 2
    third = np.sqrt(np.where(left > 0.0, left, 0.0)).astype(np.float32)
    predicted: IntArray = third.view(np.uint32).astype(np.int64)
    return predicted


def _take_axis(vectors: NDArray[Any], axes: IntArray) -> NDArray[Any]:
    """Return of each vector the component along its axis."""
    return np.ascontiguousarray(vectors[np.arange(len(vectors)), axes])
