"""Points as records of one length in a binary file, which may be read from any of them on.

Used by the reader of binary PLY, and by tasks on machines that see the file.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpccomponent.errors import InputError
from hpccomponent.protocol.records import record
from hpccomponent.surface.types.points import ByteArray, PointCloud

__all__ = ["Column", "PointRecords"]

Column = tuple[int, str]
"""Where in a record a number stands, in bytes, and its numpy type with the byte order."""

_BYTES_AT_ONCE = 1 << 20  # what is read stays in the cache until it is copied into columns


@record("surface.point_records")
@dataclass(frozen=True, slots=True)
class PointRecords:
    """Where the points of a file are.

    Parameters
    ----------
    path : str
        Of the file.
    start : int
        Of the first record, in bytes from the start of the file.
    length : int
        Of a record, in bytes.
    count : int
        Of the records.
    positions, normals, colours : tuple of Column
        Three columns each; the last two none where the file has none.
    """

    path: str
    start: int
    length: int
    count: int
    positions: tuple[Column, ...]
    normals: tuple[Column, ...] = ()
    colours: tuple[Column, ...] = ()

    def read(self, start: int, stop: int) -> PointCloud:
        """Read a run of points.

        Parameters
        ----------
        start, stop : int
            From 0, within `count`.

        Returns
        -------
        PointCloud
            Every point, NaN and zero normals included, in the file's coordinates.

        Raises
        ------
        InputError
            The file cannot be read, or has become shorter.
        """
        wanted = max(stop - start, 0)
        columns = [
            np.empty((wanted, 3)),
            np.empty((wanted, 3)) if self.normals else None,
            np.empty((wanted, 3), np.uint8) if self.colours else None,
        ]
        step = max(1, _BYTES_AT_ONCE // self.length)
        buffer = np.empty(min(step, wanted) * self.length, np.uint8)
        try:
            with open(self.path, "rb", buffering=0) as file:
                file.seek(self.start + start * self.length)
                for first in range(0, wanted, step):
                    rows = slice(first, min(first + step, wanted))
                    self._fill(file, buffer[: (rows.stop - first) * self.length])
                    for target, source in zip(columns, self._sources(), strict=True):
                        if target is not None:
                            self._copy(buffer, source, target[rows])
        except OSError as error:
            raise InputError(
                f"{self.path}: cannot be read: {error.strerror or error}", "check the file's name"
            ) from error
        return PointCloud(*columns)  # type: ignore[arg-type] # positions are never None

    def _sources(self) -> tuple[tuple[Column, ...], ...]:
        return self.positions, self.normals, self.colours

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
        for column, (offset, dtype) in zip(target.T, source, strict=True):
            column[:] = np.ndarray(len(column), dtype, buffer, offset, (self.length,))
