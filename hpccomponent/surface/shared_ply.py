"""One PLY file that many write to: every part knows where its rows are.

The rows of a binary PLY file have one size each. Whoever opens the file writes its header and makes
it as long as it will be; then each worker writes the bricks of its own part.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpccomponent.surface.mesh_part import MeshPart
from hpccomponent.surface.part_places import PartPlaces, place_faces, place_vertices
from hpccomponent.surface.points import FloatArray, IntArray

__all__ = ["FACE_SIZE", "SharedPly", "face_rows", "vertex_rows", "vertex_size", "write_part"]

_FACE = np.dtype([("n", "u1"), ("corners", "<i4", (3,))])

FACE_SIZE = _FACE.itemsize
"""Bytes of a face."""


@dataclass(frozen=True, slots=True, eq=False)
class SharedPly:
    """Where the rows of a binary little-endian PLY file are.

    Parameters
    ----------
    path : str
        The file, under the name that it has while it is written.
    vertex_start, face_start : int
        The byte at which the vertices and the faces begin.
    is_double : bool
        Coordinates are ``double``, else ``float``.
    origin : ndarray of float64, shape (3,)
        To be added to the vertices.
    """

    path: str
    vertex_start: int
    face_start: int
    is_double: bool
    origin: FloatArray

    def to_values(self) -> tuple[Any, ...]:
        """Return the parameters in order: what a task may be called with."""
        return tuple(getattr(self, field.name) for field in fields(self))

    @classmethod
    def from_values(cls, values: tuple[Any, ...]) -> SharedPly:
        """Return what `to_values` took apart."""
        return cls(*values)


def vertex_size(is_double: bool) -> int:
    """Return the bytes of a vertex."""
    return 24 if is_double else 12


def vertex_rows(vertices: FloatArray, origin: FloatArray, is_double: bool) -> NDArray[Any]:
    """Return vertices as the rows of a binary PLY file, in the input's frame.

    Parameters
    ----------
    vertices : ndarray of float64, shape (v, 3)
        In length units of the input, in the local frame.
    origin : ndarray of float64, shape (3,)
    is_double : bool

    Returns
    -------
    ndarray of float64 or float32, shape (v, 3)
    """
    rows = np.empty((len(vertices), 3), "<f8" if is_double else "<f4")
    with np.errstate(over="ignore"):  # what float cannot hold becomes infinite
        for axis, shift in enumerate(origin):
            column = vertices[:, axis]
            rows[:, axis] = column + shift if shift else column
    return rows


def face_rows(faces: IntArray) -> NDArray[Any]:
    """Return faces as the rows of a binary PLY file.

    Parameters
    ----------
    faces : ndarray of int64, shape (f, 3)

    Returns
    -------
    structured ndarray, shape (f,)
    """
    rows = np.empty(len(faces), _FACE)
    rows["n"] = 3
    rows["corners"] = faces
    return rows


def write_part(part: MeshPart, places: PartPlaces, shared: SharedPly) -> int:
    """Write what a part gives to the mesh into the file that all parts share.

    Parameters
    ----------
    part : MeshPart
    places : PartPlaces
        From the plan of the weld.
    shared : SharedPly
        The file is there and long enough.

    Returns
    -------
    int
        Bytes written.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    bricks = np.flatnonzero(places.face_starts >= 0)
    vertices, vertex_numbers = place_vertices(part, places, bricks)
    _, faces, face_numbers = place_faces(part, places, bricks)
    file = os.open(shared.path, os.O_WRONLY)
    try:
        rows = vertex_rows(vertices, shared.origin, shared.is_double)
        written = _write_runs(file, rows, vertex_numbers, shared.vertex_start)
        return written + _write_runs(file, face_rows(faces), face_numbers, shared.face_start)
    finally:
        os.close(file)


def _write_runs(file: int, rows: NDArray[Any], numbers: IntArray, start: int) -> int:
    """Write rows to their places; those with consecutive numbers at once."""
    if not len(rows):
        return 0
    size = rows.nbytes // len(rows)
    cuts = np.flatnonzero(np.diff(numbers) != 1) + 1
    raw = rows.view(np.uint8).reshape(-1).data
    for first, last in zip(np.r_[0, cuts].tolist(), np.r_[cuts, len(rows)].tolist(), strict=True):
        run, at = raw[first * size : last * size], start + int(numbers[first]) * size
        while run:
            done = os.pwrite(file, run, at)
            run, at = run[done:], at + done
    return rows.nbytes
