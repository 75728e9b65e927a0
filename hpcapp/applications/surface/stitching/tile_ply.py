"""A part as a PLY of its own: workers write a folder of tiles themselves.

A vertex on a seam is in each of its tiles, at the very same place: those of other parts are read
where these are kept.
"""

from __future__ import annotations

import os
from collections.abc import Callable

import numpy as np

from hpcapp.applications.surface.extraction.part_places import PartPlaces, place_faces
from hpcapp.applications.surface.extraction.parts import MeshPart
from hpcapp.applications.surface.types.result_patterns import SMALL_BYTES, WRITTEN
from hpcapp.geometry.lattice import number_keys, unique_keys
from hpcapp.geometry.ply_rows import face_rows, mesh_header, vertex_rows
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.kernels.freed_memory import leave_for_files
from hpccomponent.errors import OutputError
from hpccomponent.files.checksum import note_written
from hpccomponent.runtime.tasks import declare
from hpccomponent.store.places import hold_store


def cut_tile(
    part: MeshPart, places: PartPlaces, locate: Callable[[IntArray], FloatArray]
) -> tuple[FloatArray, IntArray]:
    """Return the vertices (v, 3) and faces (f, 3) that a part gives to the mesh, as its own mesh.

    `locate` returns where foreign vertices are, by their rows among those of the part.
    """
    faces, _, _ = place_faces(part, places, np.flatnonzero(places.face_starts >= 0))
    # (v,), (3 f,): the vertices that faces use, foreign ones below 0, and the row of each corner.
    used, corners = number_keys(faces.reshape(-1))
    vertices = np.empty((len(used), 3))
    own = used >= 0
    vertices[own] = part.vertices[used[own]]
    vertices[~own] = locate(~used[~own].astype(np.int64))
    return vertices, corners.reshape(-1, 3)


@declare(result=WRITTEN, limit=SMALL_BYTES, is_verified=False)
def write_kept_tile(
    kept: tuple[str, str],
    places: PartPlaces,
    foreign: tuple[tuple[str, ...], IntArray, IntArray],
    ply: tuple[str, str, bool, FloatArray, tuple[str, ...]],
) -> bool:
    """Write a part that is kept into a folder of tiles (a task); tell if that was done.

    `kept` has the store (see `store.places`) and the name of what `tiles.mesh_tile` put there,
    `foreign` the names of other parts, and of each foreign vertex which of them has it, and in
    which row. `ply` has the file, in a folder that has another name while it is written; the name
    that the folder will have; whether coordinates are ``double``; what is to be added to them;
    comments of the header.

    It was done, too, if the part has no faces, but not where this process does not see the parts,
    or sees no such folder or may not write there. Run twice, even at once, it writes the same bytes
    to the same places. OutputError where the file cannot be written, JobError or CloudError where a
    part cannot be read.
    """
    leave_for_files()  # what tiles have left
    (place, name), (path, target, is_double, origin, comments) = kept, ply
    if not os.access(os.path.dirname(path), os.W_OK | os.X_OK):
        return False
    store = hold_store(place)
    if not all(store.has(wanted) for wanted in (name, *foreign[0])):
        return False

    def load(name: str) -> MeshPart:
        part: MeshPart = store.get(name)[0]
        return part

    def locate(wanted: IntArray) -> FloatArray:
        return _locate(foreign, wanted, load)

    vertices, faces = cut_tile(load(name), places, locate)
    if not len(faces):
        return True
    try:
        # Not cut to nothing first: who is late must not damage what is done.
        with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT, 0o666), "wb") as file:
            for piece in (
                mesh_header(len(vertices), len(faces), is_double, (), comments),
                vertex_rows(vertices, origin, is_double).data,
                face_rows(faces).data,
            ):
                file.write(piece)
                note_written(piece)
    except OSError as error:
        raise OutputError(
            f"{target}: cannot be written: {error.strerror or error}",
            "check that its folder has room and lets you write",
        ) from error
    return True


def _locate(
    foreign: tuple[tuple[str, ...], IntArray, IntArray],
    wanted: IntArray,
    load: Callable[[str], MeshPart],
) -> FloatArray:
    """Return where foreign vertices are, from the parts that have them."""
    names, owners, rows = foreign
    found = np.empty((len(wanted), 3))
    # Part by part, so that each is read once.
    for index in unique_keys(owners[wanted]).tolist():
        there = owners[wanted] == index
        found[there] = load(names[index]).vertices[rows[wanted[there]]]
    return found
