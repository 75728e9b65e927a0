"""A file of points that is read in parts: a cloud may be larger than memory.

Used by `ply_points` and `text`, which make the sources, and by `formats`, which opens them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hpcapp.io.frame import to_local
from hpccomponent.errors import InputError
from hpccomponent.surface.cloud.point_records import PointRecords
from hpccomponent.surface.types.points import PointCloud

__all__ = ["PointSource", "read_whole", "translated"]

Number = TypeVar("Number", bound=np.generic)

_ROWS_AT_ONCE = 1 << 20


@dataclass(frozen=True, slots=True, eq=False)
class PointSource:
    """The points of a file, in its order and in its coordinates.

    Parameters
    ----------
    path : Path
        The file.
    count : int or None
        How many points the file says it has; None where it says nothing.
    is_double : bool
        Whether coordinates may have more digits than float32 holds.
    has_normals : bool
    scan : callable
        Given a number of rows, yields the file's points in parts of so many, the last of fewer;
        a file without points is one empty part.
    records : PointRecords or None
        Where the points are; None where one must be read to find the next.
    check_rest : callable
        Finds out whether all of the file is as it should be, the points set aside; there with
        `records` only, and part of `scan`.
    """

    path: Path
    count: int | None
    is_double: bool
    has_normals: bool
    scan: Callable[[int], Iterator[PointCloud]]
    records: PointRecords | None = None
    check_rest: Callable[[], None] | None = None

    def chunks(self, rows: int) -> Iterator[PointCloud]:
        """Yield the points in parts.

        Parameters
        ----------
        rows : int
            Points in a part, at most; memory is proportional to it, not to the file.

        Yields
        ------
        PointCloud
            Every point of the file, NaN and zero normals included; its origin is zero.

        Raises
        ------
        InputError
            The file is damaged, as `read_points` would say it; after the last part at the latest.
        """
        with translated(self.path):
            yield from self.scan(rows)

    def check(self) -> None:
        """Find out whether all of the file but its points is as it should be, given `records`.

        Raises
        ------
        InputError
            It is damaged.
        """
        assert self.check_rest is not None  # noqa: S101 - there are records
        with translated(self.path):
            self.check_rest()


def read_whole(source: PointSource) -> PointCloud:
    """Read all points at once, and bring them into a local frame.

    Parameters
    ----------
    source : PointSource

    Returns
    -------
    PointCloud

    Raises
    ------
    InputError
        The file is damaged.
    """
    at_once = _ROWS_AT_ONCE if source.records is None else max(source.count or 0, 1)
    parts = list(source.chunks(at_once))
    positions = _join([part.positions for part in parts])
    normals = [part.normals for part in parts if part.normals is not None]
    colors = [part.colors for part in parts if part.colors is not None]
    positions, origin = to_local(positions)
    return PointCloud(
        positions, _join(normals) if normals else None, _join(colors) if colors else None, origin
    )


def _join(parts: list[NDArray[Number]]) -> NDArray[Number]:
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


@contextmanager
def translated(path: Path) -> Iterator[None]:
    """Turn the system's errors of reading a file into ours.

    Parameters
    ----------
    path : Path
        The file, for the message.

    Raises
    ------
    InputError
        The block ended by an OSError.
    """
    try:
        yield
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read: {error.strerror or error}", "check the file's name"
        ) from error
