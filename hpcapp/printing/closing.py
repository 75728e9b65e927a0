"""A mesh of anywhere, closed as far as it can be: what lets a solid be made of it.

::

    faces ── seams welded ── what no surface is dropped ── largest pieces ── holes filled ── lids
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from hpcapp.applications.surface.stitching.topology import check_mesh, signed_volume
from hpcapp.geometry.lattice import unique_keys
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.pieces import PieceChoice, say_dropped
from hpcapp.geometry.points import IntArray
from hpcapp.io.meshes.mesh_stream import find_vertices, make_mesh
from hpcapp.mending.handles import split_corners
from hpcapp.mending.holes import Filled, fill_holes
from hpcapp.mending.loops import count_faces, find_holes
from hpcapp.mending.pieces import keep_faces, measure_pieces
from hpcapp.mending.triangulation import triangulate
from hpcapp.wording import say_count
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

log = logging.getLogger("hpcapp")

_BENT = 0.1
"""Of the diagonal of the mesh. Smaller holes are filled as the surface around them bends, which
takes minutes of a larger one, and tells nothing of what is missing there: it gets a lid."""


@dataclass(frozen=True, slots=True, eq=False)
class Closed:
    """A mesh, manifold and oriented, that is open only where a sheet ends (see `mending.loops`).

    `holes` is how many were closed, `lids` how many large ones of them; `is_inward` tells that it
    was seen from inside, as a room is: then large holes stay open, and where it has none, its faces
    are turned over.
    """

    mesh: Mesh
    holes: int
    lids: int
    is_open: bool
    is_inward: bool


def close_mesh(mesh: Mesh, pieces: int = 1) -> Closed:
    """Close the holes of the largest pieces of a mesh.

    Raise InputError where nothing of it is a surface, or has an area.
    """
    topology = check_mesh(mesh)
    is_closed = topology.watertight and topology.oriented
    is_closed &= topology.vertices == len(mesh.vertices)
    if not is_closed:
        mesh = _make_manifold(_weld(mesh))
    of_face, areas = measure_pieces(mesh)
    if not areas.max() > 0.0:
        raise InputError("the faces of the mesh have no area", "check the file")
    stays = PieceChoice(pieces).choose(areas)
    if not stays.all():
        log.info("%s", say_dropped(areas, stays))
    mesh = keep_faces(mesh, stays[of_face])
    if is_closed:
        filled, lids = Filled(mesh, 0, 0), 0
    else:
        size = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
        filled = fill_holes(mesh, _BENT * size)
        mesh, lids = _put_lids(filled.mesh)
        is_closed = not check_mesh(mesh).boundary_edges
    is_inward = is_closed and signed_volume(mesh) < 0.0
    if is_inward and lids:
        return Closed(filled.mesh, filled.holes, 0, is_open=True, is_inward=True)
    if is_inward:
        mesh = replace(mesh, faces=mesh.faces[:, ::-1])
    return Closed(mesh, filled.holes + lids, lids, not is_closed, is_inward)


def _weld(mesh: Mesh) -> Mesh:
    """Join vertices at one place along borders, as of a mesh that was cut for its texture."""
    sides = _list_sides(mesh.faces)
    is_border = count_faces(*sides)[0] == 1
    bare = unique_keys(np.concatenate([ends[is_border] for ends in sides]))
    places = mesh.vertices[bare] + 0.0  # no negative zeros
    _, first, place = np.unique(places, axis=0, return_index=True, return_inverse=True)
    rows = np.arange(len(mesh.vertices))
    rows[bare] = bare[first[place.reshape(-1)]]
    return replace(mesh, faces=rows[mesh.faces])


def _list_sides(faces: IntArray) -> tuple[IntArray, IntArray]:
    """Return the tails and heads of the sides of faces, (3 f,) each."""
    return faces.reshape(-1), np.roll(faces, -1, axis=1).reshape(-1)


def _make_manifold(mesh: Mesh) -> Mesh:
    """Drop faces at edges that have more than two, or two that run one way, and part fans."""
    faces = mesh.faces[(mesh.faces != np.roll(mesh.faces, 1, axis=1)).all(axis=1)]
    # Of faces that are there twice the first stays.
    _, first = np.unique(np.sort(faces, axis=1), axis=0, return_index=True)
    faces = faces[np.sort(first)]
    is_odd = count_faces(*_list_sides(faces))[1]
    faces = faces[~is_odd.reshape(-1, 3).any(axis=1)]
    if not len(faces):
        raise InputError(
            "the mesh is no surface: all of its faces meet others as those of a solid cannot",
            "reconstruct takes points of it, and makes it anew",
        )
    if dropped := len(mesh.faces) - len(faces):
        log.info("dropped %s that no surface of a solid has", say_count(dropped, "face"))
    nodes, corners = split_corners(faces)
    return make_mesh(find_vertices(mesh).take(nodes), corners, mesh.origin)


def _put_lids(mesh: Mesh) -> tuple[Mesh, int]:
    """Close large holes by the least area between their borders, or else by a fan."""
    loops = find_holes(mesh, np.inf).holes
    if not loops:
        return mesh, 0
    # (s, 2): the sides that join vertices of borders; (v,): where on its loop each vertex is.
    sides = np.stack(_list_sides(mesh.faces), axis=1)
    sides = sides[np.isin(sides, np.concatenate(loops)).all(axis=1)]
    at = np.full(len(mesh.vertices), -1)
    sources, places, faces = [np.arange(len(mesh.vertices))], [mesh.vertices], [mesh.faces]
    for loop in loops:
        at[loop] = np.arange(len(loop))
        taken = np.sort(at[sides[(at[sides] >= 0).all(axis=1)]], axis=1)
        at[loop] = -1
        corners, blank = mesh.vertices[loop], np.zeros((len(loop), 3))
        lid = triangulate(corners, blank, set(map(tuple, taken.tolist())))
        if lid is None:
            middle = np.full(len(loop), len(mesh.vertices) + len(sources) - 1)
            faces.append(np.stack([loop, np.roll(loop, -1), middle], axis=1))
            sources.append(loop[:1])
            places.append(corners.mean(axis=0, keepdims=True))
        else:
            faces.append(loop[lid])
    vertices = find_vertices(mesh).take(np.concatenate(sources))
    vertices = replace(vertices, positions=np.concatenate(places))
    return make_mesh(vertices, np.concatenate(faces), mesh.origin), len(loops)
