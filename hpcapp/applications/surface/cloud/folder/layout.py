"""How the points of one file lie there: in as few bits as all of them can do with, without loss.

::

    page of the layout | records, of one size each | last record (see `part_check`)

Positions are whole numbers of quanta, and what is left of a normal of length 1 to its longest
component is known from the others but for the last bits: 17 bytes of 24 for most scans, 9 where
there are no normals, 21 for normals of any lengths.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.cloud.arrangement import PackedPoints, interleave
from hpcapp.geometry.points import ByteArray, Float32Array, IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.files.checksum import PAGE
from hpccomponent.posix import read_at
from hpccomponent.store.value import DamagedError

_COLUMNS = 7  # as `kernels.fold_records` has them
_HEAD = struct.Struct(f"<8s{2 * _COLUMNS}q")  # magic, least of each column, bits of each
_MAGIC = b"hpcfold1"


@dataclass(frozen=True, slots=True, eq=False)
class FoldedLayout:
    """Offsets and normals as the kernels fold them: see `kernels.fold_records`."""

    lows: IntArray
    widths: IntArray

    columns: ClassVar = 6

    @classmethod
    def of(cls, pieces: Sequence[PackedPoints]) -> FoldedLayout:
        """Return the one in which some points take the least room."""
        bounds = [kernels.bound_records(piece.to_records()) for piece in pieces if len(piece)]
        bounds = bounds or [np.zeros((2, _COLUMNS), np.int64)]
        lows = np.min([low for low, _ in bounds], axis=0)
        spans = np.max([high for _, high in bounds], axis=0) - lows
        return cls(lows, np.array([span.bit_length() for span in spans.tolist()]))

    @classmethod
    def read(cls, file: int) -> FoldedLayout:
        """Return that of an open file; DamagedError where it has none."""
        head = read_at(file, _HEAD.size, 0)
        if len(head) < _HEAD.size or not head.startswith(_MAGIC):
            raise DamagedError("does not begin as packed points do")
        numbers = np.array(_HEAD.unpack(head)[1:])
        return cls(numbers[:_COLUMNS], numbers[_COLUMNS:])

    @property
    def first(self) -> int:
        """The byte at which they begin."""
        return PAGE

    @property
    def size(self) -> int:
        """Bytes of each."""
        return max(1, -(-int(self.widths.sum()) // 8))

    def end(self, records: int) -> int:
        """Return the byte behind so many records."""
        return self.first + self.size * records

    def place(
        self, content: ByteArray, counts: IntArray, starts: IntArray, records: Float32Array
    ) -> None:
        """Put what was read, (n * size,), where it belongs in the records (m, columns).

        It has `counts` (b,) records of each block, whose first one goes to row `starts` (b,).
        """
        folded = content.reshape(-1, self.size)
        kernels.unfold_records(folded, self.lows, self.widths, counts, starts, records)

    def write(self, pieces: Sequence[PackedPoints]) -> Iterator[memoryview | bytes]:
        """Yield what a file of some points begins with: whole pages each, but for the last."""
        yield _HEAD.pack(_MAGIC, *self.lows.tolist(), *self.widths.tolist()).ljust(PAGE, b"\0")
        for records in interleave(pieces):
            yield kernels.fold_records(records, self.lows, self.widths).reshape(-1).data


class SingleLayout:
    """One float32 for each point, as it is: an attribute."""

    columns: ClassVar = 1

    @property
    def first(self) -> int:
        """See `FoldedLayout`."""
        return 0

    @property
    def size(self) -> int:
        """See `FoldedLayout`."""
        return 4

    def end(self, records: int) -> int:
        """See `FoldedLayout`."""
        return self.size * records

    @classmethod
    def read(cls, file: int) -> SingleLayout:
        """Return it; all files have the same."""
        del file
        return cls()

    def place(
        self, content: ByteArray, counts: IntArray, starts: IntArray, records: Float32Array
    ) -> None:
        """See `FoldedLayout`."""
        moves = np.repeat(starts - (np.cumsum(counts) - counts), counts)
        records[moves + np.arange(len(moves)), 0] = content.view("<f4")


RecordLayout = FoldedLayout | SingleLayout
"""How the records of a file lie there."""
