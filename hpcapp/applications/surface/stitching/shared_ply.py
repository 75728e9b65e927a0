"""One PLY file that many write to: every part knows where its rows are.

The rows of a binary PLY file have one size each. Whoever opens the file writes its header and makes
it as long as it will be; then each worker writes the bricks of its own part. Rows have one place
each, so that a part that is written twice, as after the loss of a worker, gives the same bytes.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface.extraction.part_places import (
    PartPlaces,
    Runs,
    place_faces,
    place_vertices,
)
from hpcapp.applications.surface.extraction.parts import MeshPart
from hpcapp.applications.surface.kernels.freed_memory import leave_for_files
from hpcapp.applications.surface.types.points import FloatArray, IntArray
from hpcapp.applications.surface.types.result_patterns import SMALL_BYTES, WRITTEN
from hpccomponent.cutting import cut_equal
from hpccomponent.errors import OutputError
from hpccomponent.files.checksum import note_written
from hpccomponent.protocol.records import record
from hpccomponent.runtime.tasks import declare
from hpccomponent.store.places import hold_store

__all__ = [
    "FACE_SIZE",
    "SharedPly",
    "coordinate_lines",
    "face_rows",
    "mesh_header",
    "ply_header",
    "vertex_rows",
    "vertex_size",
    "write_kept",
    "write_part",
]

_CORNERS = np.dtype("V12")  # three int32, moved as one
_FACE = np.dtype([("n", "u1"), ("corners", _CORNERS)])

_BRICKS_AT_ONCE = 1 << 11  # what is made of some is used again for the next

FACE_SIZE = _FACE.itemsize
"""Bytes of a face."""


@record("surface.shared_ply")
@dataclass(frozen=True, slots=True, eq=False)
class SharedPly:
    """Where the rows of a binary little-endian PLY file are.

    Parameters
    ----------
    path : str
        The file, under the name that it has while it is written.
    target : str
        The name that it will have: what messages call it.
    vertex_start, face_start : int
        The byte at which the vertices and the faces begin.
    is_double : bool
        Coordinates are ``double``, else ``float``.
    origin : ndarray of float64, shape (3,)
        To be added to the vertices.
    """

    path: str
    target: str
    vertex_start: int
    face_start: int
    is_double: bool
    origin: FloatArray


def ply_header(element_lines: list[str]) -> bytes:
    """Return the header of a binary little-endian PLY file.

    Parameters
    ----------
    element_lines : list of str
        What its elements are.
    """
    start = ["ply", "format binary_little_endian 1.0", "comment hpcapp"]
    return "\n".join([*start, *element_lines, "end_header", ""]).encode("utf-8")


def mesh_header(
    vertex_count: int,
    face_count: int,
    is_double: bool,
    property_lines: Sequence[str] = (),
    comment_lines: Sequence[str] = (),
) -> bytes:
    """Return the header of a mesh.

    Parameters
    ----------
    vertex_count, face_count : int
    is_double : bool
        Whether coordinates are float64, not float32.
    property_lines : sequence of str
        Further properties of the vertices.
    comment_lines : sequence of str
        What the coordinates mean.
    """
    return ply_header(
        [
            *comment_lines,
            *coordinate_lines(vertex_count, is_double),
            *property_lines,
            f"element face {face_count}",
            "property list uchar int vertex_indices",
        ]
    )


def coordinate_lines(vertex_count: int, is_double: bool) -> list[str]:
    """Return what a header says of the vertices and their coordinates.

    Parameters
    ----------
    vertex_count : int
    is_double : bool
        Whether coordinates are float64, not float32.
    """
    kind = "double" if is_double else "float"
    return [f"element vertex {vertex_count}", *(f"property {kind} {name}" for name in "xyz")]


def vertex_size(is_double: bool) -> int:
    """Return the bytes of a vertex.

    Parameters
    ----------
    is_double : bool
        Whether coordinates are float64, not float32.
    """
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
    kind = "<f8" if is_double else "<f4"
    with np.errstate(over="ignore"):  # what float cannot hold becomes infinite
        if not origin.any():
            return vertices.astype(kind, copy=False)
        # Axis by axis straight into the type of the file: all at once would be a copy in float64.
        rows = np.empty((len(vertices), 3), kind)
        for axis, shift in enumerate(origin):
            column = vertices[:, axis]
            rows[:, axis] = column + shift if shift else column
    return rows


def face_rows(faces: IntArray) -> NDArray[Any]:
    """Return faces as the rows of a binary PLY file.

    Parameters
    ----------
    faces : ndarray of int, shape (f, 3)

    Returns
    -------
    structured ndarray, shape (f,)
    """
    rows = np.empty(len(faces), _FACE)
    # 13 bytes each: how many corners, and these.
    rows["n"] = 3
    rows["corners"] = np.ascontiguousarray(faces, "<i4").view(_CORNERS)[:, 0]
    return rows


def write_part(part: MeshPart, places: PartPlaces, shared: SharedPly) -> None:
    """Write what a part gives to the mesh into the file that all parts share.

    Parameters
    ----------
    part : MeshPart
    places : PartPlaces
        From the plan of the weld.
    shared : SharedPly
        The file is there and long enough.

    Raises
    ------
    OSError
        The file cannot be written.
    """
    file = os.open(shared.path, os.O_WRONLY)
    try:
        _write_rows(file, part, places, shared)
    finally:
        os.close(file)


@declare(result=WRITTEN, limit=SMALL_BYTES, is_verified=False)
def write_kept(kept: tuple[str, str], places: PartPlaces, shared: SharedPly) -> bool:
    """Write a part that is kept into the file that all parts share (a task).

    Parameters
    ----------
    kept : tuple of str
        The store (see `store.places`) and the name of what `tiles.mesh_tile` put there.
    places : PartPlaces
    shared : SharedPly

    Returns
    -------
    bool
        Whether it was written: not where this process does not see the part, or sees no such file
        or may not write it.

    Raises
    ------
    OutputError
        The file cannot be written.
    JobError, CloudError
        The part cannot be read.
    """
    leave_for_files()  # what tiles have left
    place, name = kept
    try:
        file = os.open(shared.path, os.O_WRONLY)
    except OSError:
        return False
    try:
        try:
            store = hold_store(place)
            if not store.has(name):
                return False
            part: MeshPart = store.get(name)[0]
            _write_rows(file, part, places, shared)
        finally:
            os.close(file)  # what a network has to say, it says here
    except OSError as error:
        raise OutputError(
            f"{shared.target}: cannot be written: {error.strerror or error}",
            "check that its folder has room and lets you write",
        ) from error
    return True


def _write_rows(file: int, part: MeshPart, places: PartPlaces, shared: SharedPly) -> None:
    """Write the vertices and faces of the bricks that are taken from a part."""
    # Those that this part gives; few at a time, so that buffers stay in the cache.
    bricks = np.flatnonzero(places.face_starts >= 0)
    for some in cut_equal(len(bricks), -(-len(bricks) // _BRICKS_AT_ONCE)):
        vertices, runs = place_vertices(part, places, bricks[some])
        rows = vertex_rows(vertices, shared.origin, shared.is_double)
        _write_runs(file, rows, runs, shared.vertex_start)
        _, corners, runs = place_faces(part, places, bricks[some])
        _write_runs(file, face_rows(corners), runs, shared.face_start)


def _write_runs(file: int, rows: NDArray[Any], runs: Runs, start: int) -> None:
    """Write rows to their places."""
    if not len(rows):
        return
    size = rows.nbytes // len(rows)
    raw = rows.view(np.uint8).reshape(-1).data
    for first, last, number in runs:
        run, at = raw[first * size : last * size], start + number * size
        note_written(run)
        # The system may write less than it was given.
        while run:
            done = os.pwrite(file, run, at)
            run, at = run[done:], at + done
