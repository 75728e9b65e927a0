"""One PLY file that many write to: every part knows where its rows are.

The rows of a binary PLY file have one size each. Whoever opens the file writes its header and makes
it as long as it will be; then each worker writes the bricks of its own part. Rows have one place
each, so that a part that is written twice, as after the loss of a worker, gives the same bytes.
"""

from __future__ import annotations

import os
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
from hpcapp.applications.surface.types.result_patterns import SMALL_BYTES, WRITTEN
from hpcapp.geometry.ply_rows import SharedPly, face_rows, vertex_rows
from hpcapp.kernels.freed_memory import leave_for_files
from hpccomponent.cutting import cut_equal
from hpccomponent.errors import OutputError
from hpccomponent.files.checksum import note_written
from hpccomponent.posix import AS_BYTES, write_at
from hpccomponent.runtime.tasks import declare
from hpccomponent.store.places import hold_store

_BRICKS_AT_ONCE = 1 << 11  # what is made of some is used again for the next


def write_part(part: MeshPart, places: PartPlaces, shared: SharedPly) -> None:
    """Write what a part gives to the mesh into the file that all parts share.

    The file is there and long enough; OSError where it cannot be written.
    """
    file = os.open(shared.path, os.O_WRONLY | AS_BYTES)
    try:
        _write_rows(file, part, places, shared)
    finally:
        os.close(file)


@declare(result=WRITTEN, limit=SMALL_BYTES, is_verified=False)
def write_kept(kept: tuple[str, str], places: PartPlaces, shared: SharedPly) -> bool:
    """Write a part that is kept into the file that all parts share (a task); tell if that was done.

    It was not where this process does not see the part, or sees no such file or may not write it.
    `kept` has the store (see `store.places`) and the name of what `tiles.mesh_tile` put there.
    OutputError where the file cannot be written, JobError or CloudError where the part cannot be
    read.
    """
    leave_for_files()  # what tiles have left
    place, name = kept
    try:
        file = os.open(shared.path, os.O_WRONLY | AS_BYTES)
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
            done = write_at(file, run, at)
            run, at = run[done:], at + done
