"""Writes clouds to folders as the tasks of a job do, in one process."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hpcapp.applications.surface.cloud.arrangement import Arrangement, pack_points, unpack_points
from hpcapp.applications.surface.cloud.folder.disk import DiskCloud, write_index
from hpcapp.applications.surface.cloud.folder.layout import FoldedLayout
from hpcapp.applications.surface.cloud.folder.parts import FilePart, write_part
from hpcapp.geometry.points import Float32Array, FloatArray


class DiskCloudWriter:
    """Writes an arranged cloud part by part.

    Parameters
    ----------
    folder : Path
        Exists, and holds no other cloud.
    origin : ndarray of float64, shape (3,)
        What was subtracted from the input's coordinates.
    """

    def __init__(self, folder: Path, arrangement: Arrangement, origin: FloatArray) -> None:
        self._folder = folder
        self._arrangement = arrangement
        self._origin = origin
        self._parts: list[FilePart] = []
        self._low, self._high = np.full(3, np.inf), np.full(3, -np.inf)

    def add(self, positions: FloatArray, normals: FloatArray) -> None:
        """Arrange the next points of the cloud and write them.

        Parameters
        ----------
        positions, normals : ndarray of float64, shape (n, 3)

        Raises
        ------
        OutputError
            The disk is full, or the folder cannot be written.
        """
        if not len(positions):
            return
        packed = pack_points(self._arrangement, positions, normals)
        snapped, _ = unpack_points(self._arrangement, packed)
        self._low = np.minimum(self._low, [column.min() for column in snapped.T])
        self._high = np.maximum(self._high, [column.max() for column in snapped.T])
        number = len(self._parts)
        self._parts.append(FilePart.whole(number, *write_part(self._folder, number, [packed])))

    def finish(self) -> DiskCloud:
        """Write the index and return the cloud; see `write_index`."""
        box = self._low, self._high
        return write_index(self._folder, self._arrangement, self._origin, box, self._parts)


def read_part(path: Path, points: int) -> Float32Array:
    """Return the first records of a file of packed points, shape (points, 6)."""
    records = np.empty((points, 6), np.float32)
    with path.open("rb") as file:
        layout = FoldedLayout.read(file.fileno())
    content = np.fromfile(path, np.uint8)[layout.first : layout.end(points)]
    layout.place(content, np.array([points]), np.array([0]), records)
    return records
