"""Points as records of one length in a binary file, which may be read from any of them on.

Used by the reader of binary PLY, and by tasks on machines that see the file.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpcapp.cancellation import check_cancelled
from hpcapp.geometry.points import ByteArray, PointCloud
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError
from hpccomponent.protocol.records import record

Column = tuple[int, str]
"""Where in a record a number stands, in bytes, and its numpy type with the byte order."""

_Target = tuple[NDArray[Any], tuple[Column, ...]]
_BYTES_AT_ONCE = 1 << 20  # what is read stays in the cache until it is copied into columns


@record("surface.point_records")
@dataclass(frozen=True, slots=True)
class PointRecords:
    """Where the points of a file are.

    Parameters
    ----------
    start : int
        Of the first record, in bytes from the start of the file.
    length : int
        Of a record, in bytes.
    count : int
        Of the records.
    positions, normals, colours : tuple of Column
        Three columns each; the last two none where the file has none.
    attributes : tuple of (str, Column)
        The other columns, by name.
    """

    path: str
    start: int
    length: int
    count: int
    positions: tuple[Column, ...]
    normals: tuple[Column, ...] = ()
    colours: tuple[Column, ...] = ()
    attributes: tuple[tuple[str, Column], ...] = ()

    def read(self, start: int, stop: int, wanted: Container[str] | None = None) -> PointCloud:
        """Read a run of points, NaN and zero normals included, in the file's coordinates.

        Wanted beside positions are ``normals``, ``colours`` and names of attributes, by default
        all. Raise InputError where the file cannot be read, or has become shorter.
        """
        rows = max(stop - start, 0)
        positions = np.empty((rows, 3))
        normals = np.empty((rows, 3)) if self.normals and _is_in("normals", wanted) else None
        colours = None
        if self.colours and _is_in("colours", wanted):
            colours = np.empty((rows, 3), colour_type(dtype for _, dtype in self.colours))
        attributes = {
            name: (np.empty(rows, np.dtype(column[1]).newbyteorder("=")), (column,))
            for name, column in self.attributes
            if _is_in(name, wanted)
        }
        targets: list[_Target] = [(positions, self.positions), *attributes.values()]
        if normals is not None:
            targets.append((normals, self.normals))
        if colours is not None:
            targets.append((colours, self.colours))
        self._read_into(targets, start, rows)
        return PointCloud(
            positions, normals, colours, {name: column for name, (column, _) in attributes.items()}
        )

    def scan(self, rows: int) -> Iterator[PointCloud]:
        """Yield all points in parts of so many, one empty part where there are none.

        Errors are those of `read`.
        """
        for start in range(0, max(self.count, 1), rows):
            yield self.read(start, min(start + rows, self.count))

    def _read_into(self, targets: list[_Target], start: int, wanted: int) -> None:
        step = max(1, _BYTES_AT_ONCE // self.length)
        buffer = np.empty(min(step, wanted) * self.length, np.uint8)
        try:
            with open(self.path, "rb", buffering=0) as file:
                file.seek(self.start + start * self.length)
                for first in range(0, wanted, step):
                    check_cancelled()
                    rows = slice(first, min(first + step, wanted))
                    self._fill(file, buffer[: (rows.stop - first) * self.length])
                    with np.errstate(invalid="ignore", over="ignore"):  # NaN of any kind
                        for target, source in targets:
                            self._copy(buffer, source, target[rows])
        except OSError as error:
            raise InputError(
                f"{self.path}: cannot be read: {error.strerror or error}", "check the file's name"
            ) from error

    def _fill(self, file: Any, buffer: ByteArray) -> None:
        view = buffer.data
        while len(view):
            taken = file.readinto(view)
            if not taken:
                raise InputError(
                    f"{Path(self.path)}: truncated: it has become shorter while it was read",
                    "copy or export the file again",
                )
            view = view[taken:]

    def _copy(self, buffer: ByteArray, source: tuple[Column, ...], target: NDArray[Any]) -> None:
        """Copy columns of the records in a buffer into those of an array."""
        columns = [target] if target.ndim == 1 else target.T
        for column, (offset, dtype) in zip(columns, source, strict=True):
            column[:] = np.ndarray(len(column), dtype, buffer, offset, (self.length,))


def _is_in(name: str, wanted: Container[str] | None) -> bool:
    return wanted is None or name in wanted


def colour_type(dtypes: Iterable[Any]) -> np.dtype[Any]:
    """Return the type that keeps colours of three columns as they are.

    That is uint8, uint16, or float32 for all others.
    """
    common = np.result_type(*(np.dtype(dtype).newbyteorder("=") for dtype in dtypes))
    return common if common in (np.uint8, np.uint16) else np.dtype(np.float32)
