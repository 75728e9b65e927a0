"""Where planes cut a mesh: exact, joined by the edges of its faces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hpcapp.applications.section.planes import Cut, Plane, plan_along, plan_planes
from hpcapp.applications.section.sections import Outline, Section, Sections
from hpcapp.cancellation import check_cancelled
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.geometry.regions.region import say_place
from hpcapp.io.crs import Crs
from hpcapp.io.geocentric import refuse_geocentric
from hpcapp.io.outlines import Drawn
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError

_SAME = 1e-10  # of the extent of a mesh: rounding, places nearer than that are one


@dataclass(frozen=True, slots=True, eq=False)
class _Pieces:
    """Straight pieces of outlines, one a face.

    Parameters
    ----------
    places : ndarray of float64, shape (m, 2, 3)
        Their ends, in the frame of the mesh; what is solid lies to the left in the drawing.
    flat : ndarray of float64, shape (m, 2, 2)
        The same in the drawing.
    keys : ndarray of int64, shape (m, 2)
        Equal where two pieces meet; on the border of a strip less than zero, by its corner.
    """

    places: FloatArray
    flat: FloatArray
    keys: IntArray


def make_sections(
    mesh: Mesh, crs: Crs, planes: Sequence[str], lines: Sequence[Drawn] | None,
    step: float | None, width: float | None, name: str,
) -> Sections:  # fmt: skip
    """Cut a mesh by planes that were typed, or across or along lines.

    Raise InputError where none meets it, and of lines where coordinates are from the centre of the
    earth; UsageError where a plane is none, or they are too many.
    """
    low, high = (end + mesh.origin for end in bound_points(mesh.vertices))
    if lines is not None:
        refuse_geocentric(name, low, high, crs)
    cuts = plan_planes(planes, step, low, high) if lines is None else plan_along(lines, step, width)
    sections = []
    for cut in cuts:
        check_cancelled()
        sections.append(cut_mesh(mesh, cut, crs.height_scale))
    if not any(one.outlines for one in sections):
        where = "no plane" if lines is None else "no section along the line"
        raise InputError(
            f"{name}: {where} meets its surface",
            f"it lies from {say_place(low)} to {say_place(high)}",
        )
    return Sections(tuple(sections), crs)


def cut_mesh(mesh: Mesh, cut: Cut, height_scale: float = 1.0) -> Section:
    """Return the outlines of one section, in the coordinates of the input.

    They are closed where the mesh is. A vertex in a plane counts as before it, so that a face in it
    has the outline of what lies behind. Drawings have heights that are so many times as long.
    """
    same = _SAME * float(np.ptp(mesh.vertices, axis=0).max())
    parts = [_cut_faces(mesh, plane, k, height_scale) for k, plane in enumerate(cut.planes)]
    # (2 m, ...): all ends, those of a piece one after the other
    keys = np.concatenate([part.keys for part in parts]).ravel()
    places = np.concatenate([part.places for part in parts]).reshape(-1, 3)
    flat = np.concatenate([part.flat for part in parts]).reshape(-1, 2)
    _tell_ends(keys, flat[:, 1], same)
    _, first, number = np.unique(keys, return_index=True, return_inverse=True)
    outlines = []
    for chain in _join(number.reshape(-1, 2)):
        rows = first[chain]
        moved = np.linalg.norm(np.diff(places[rows], axis=0), axis=1) > same
        rows = rows[np.append(True, moved)]
        if len(rows) > 1:
            # what is dropped may be the end, which is where the start of a closed one is
            is_closed = chain[0] == chain[-1]
            rows[-1] = rows[0] if is_closed else rows[-1]
            outlines.append(Outline(places[rows] + mesh.origin, flat[rows], bool(is_closed)))
    return Section(cut.name, cut.station, cut.line, tuple(outlines))


def _cut_faces(mesh: Mesh, plane: Plane, number: int, height_scale: float) -> _Pieces:
    """Return what a plane cuts of the faces; the number tells its keys from those of others."""
    place, scales = plane.place - mesh.origin, np.array([1.0, 1.0, height_scale])
    # (v,): how far each vertex is in front, in lengths of the vector
    ahead = np.einsum("ij,j->i", mesh.vertices - place, plane.towards)
    sides = ahead[mesh.faces] > 0.0
    count = np.count_nonzero(sides, axis=1)
    is_cut = (count == 1) | (count == 2)
    # (m, 3) and (m,): the corners of the faces that are cut, which are in front, and how many
    corners, sides, count = mesh.faces[is_cut], sides[is_cut], count[is_cut]
    # the corner that is alone on its side, and the two others in turn
    lone = (sides == (count == 1)[:, None]).argmax(axis=1)
    turned = (lone[:, None] + np.arange(3)) % 3
    alone, after, before = np.take_along_axis(corners, turned, axis=1).T
    # (m, 2, 2): the edges that a piece starts and ends on, with their vertices
    edges = np.stack([np.stack([alone, after], 1), np.stack([alone, before], 1)], axis=1)
    # front to the right of the way along the surface, whose faces look out
    edges = np.where((count == 1)[:, None, None], edges[:, ::-1], edges)
    # both faces of an edge have the same place of it, to the last bit
    edges = np.sort(edges, axis=2)
    (start, end), (near, far) = (np.moveaxis(of[edges], 2, 0) for of in (mesh.vertices, ahead))
    places = start + (near / (near - far))[..., None] * (end - start)
    flat = np.einsum("mej,kj->mek", (places - place) * scales, plane.find_axes(scales))
    edge = edges[..., 0] * len(mesh.vertices) + edges[..., 1]
    keys = np.unique(edge, return_inverse=True)[1].reshape(-1, 2).astype(np.int64)
    keys += number * (3 * len(mesh.faces) + 1)
    return _clip(_Pieces(places, flat, keys), plane)


def _clip(pieces: _Pieces, plane: Plane) -> _Pieces:
    """Return what lies in the strip, where the plane has its place in the drawing."""
    places, flat, keys = pieces.places, pieces.flat, pieces.keys
    for sign, border, corner in zip((1.0, -1.0), plane.span, plane.ends, strict=True):
        # (m, 2): how far each end is outside
        beyond = sign * (border - flat[..., 0])
        kept = (beyond <= 0.0).any(axis=1)
        places, flat, keys, beyond = places[kept], flat[kept], keys[kept], beyond[kept]
        for end in (0, 1):
            out = np.flatnonzero(beyond[:, end] > 0.0)
            share = (beyond[out, end] / (beyond[out, end] - beyond[out, 1 - end]))[:, None]
            places[out, end] += share * (places[out, 1 - end] - places[out, end])
            flat[out, end] += share * (flat[out, 1 - end] - flat[out, end])
            keys[out, end] = -1 - corner
    return _Pieces(places, flat + np.array([plane.start, 0.0]), keys)


def _tell_ends(keys: IntArray, heights: FloatArray, same: float) -> None:
    """Give ends on borders of strips their keys: one where corner and height are the same."""
    ends = np.flatnonzero(keys < 0)
    ends = ends[np.lexsort((heights[ends], keys[ends]))]
    is_new = (np.diff(keys[ends]) != 0) | (np.diff(heights[ends]) > same)
    keys[ends] = -1 - np.cumsum(np.append(0, is_new))[: len(ends)]


def _join(pieces: IntArray) -> list[IntArray]:
    """Return chains of the ends of pieces (m, 2); one that is closed ends where it starts.

    A chain ends where another number of pieces meets than two: at a border, or where sheets meet.
    """
    rows: list[list[int]] = pieces[pieces[:, 0] != pieces[:, 1]].tolist()
    touching: list[list[int]] = [[] for _ in range(int(pieces.max(initial=-1)) + 1)]
    for row, ends in enumerate(rows):
        for end in ends:
            touching[end].append(row)
    # those that begin at a border come first, in their own way; the others have no end
    starts = [(row, ends[k]) for k in (0, 1) for row, ends in enumerate(rows)]
    starts = [(row, at) for row, at in starts if len(touching[at]) != 2]
    starts += [(row, ends[0]) for row, ends in enumerate(rows)]
    free = set(range(len(rows)))
    chains = []
    for row, at in starts:
        chain = [at]
        while row in free:
            free.remove(row)
            at = sum(rows[row]) - at
            chain.append(at)
            if len(touching[at]) == 2:
                row = sum(touching[at]) - row
        if len(chain) > 1:
            chains.append(np.array(chain))
    return chains
