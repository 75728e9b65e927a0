"""The topology of a mesh in parts: what `check_mesh` finds, from the seams between the parts.

Around a closed vertex of a part nothing is left to find out. All that is not inside the parts are
the sides between open vertices, which are grouped into edges here, and the pieces of corners at
these vertices, which are joined across the edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpcapp import kernels
from hpcapp.applications.surface.extraction.part_places import starts_of
from hpcapp.applications.surface.extraction.summary import PartSummary
from hpcapp.applications.surface.stitching.bricks import PartBricks
from hpcapp.applications.surface.stitching.topology import Topology, count_loops
from hpcapp.geometry.lattice import find_first, find_keys, number_keys
from hpcapp.geometry.pieces import round_areas
from hpcapp.geometry.points import FloatArray, IntArray
from hpccomponent.dataclass import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class Components:
    """What each brick of the mesh has of each component: e entries, in the order of the bricks.

    `place` has the bricks as rows of `PartBricks.keys`, `sums` (e, 5) what `BrickSums` has;
    `vertices`, `faces` and `supports` (vertices that are supported, see `MeshPart`) are counts.
    """

    place: IntArray
    component: IntArray
    vertices: NDArray[np.int32]
    faces: NDArray[np.int32]
    sums: FloatArray
    supports: NDArray[np.int32]

    def only(self, chosen: NDArray[np.bool_]) -> Components:
        """Return the entries that a mask (e,) names."""
        return Components(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def count(self, values: NDArray[np.int32], components: int) -> IntArray:
        """Sum vertices, faces or supports (e,) over each of so many components."""
        return np.bincount(self.component, values, components).astype(np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class _Seams:
    """The seams of all parts; vertices are numbered through over the bricks, dropped ones too.

    ``piece_owners`` says whether the unit of a piece owns its vertex. Of each side there is the
    number of its face in the mesh and its own in the face, the pieces at its tail and its head,
    and the component.
    """

    pieces: IntArray
    piece_owners: NDArray[np.bool_]
    bare: IntArray
    sides: IntArray
    tails: IntArray
    heads: IntArray
    components: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class _Verdict:
    """What the seams say: see `Survey`, and how many more fans there are than vertices."""

    boundary: int
    loops: int
    is_edge_manifold: bool
    is_oriented: bool
    surplus_fans: int
    edges: IntArray


def judge_parts(
    summaries: Sequence[PartSummary],
    bricks: PartBricks,
    component: IntArray,
    kept: NDArray[np.bool_],
    entries: Components,
) -> Topology:
    """Judge the connectivity of the mesh that the parts are.

    `component` is that of each label, `kept` says which labels stay; `entries` are of components
    that stay, in bricks that are taken.

    Notes
    -----
    A vertex that is closed in one part and has faces in another is found, and is not manifold; but
    such edges of these faces as the first part has too count as boundary, and the faces may be
    missing in the volume.
    """
    count = int(component.max(initial=-1)) + 1
    faces = entries.count(entries.faces, count)
    if not faces.any():
        return Topology(False, True, True, True, False, 0, None, (), 0, 0, 0, 0)
    # (c,): a vertex that no face uses is a component of its own, and counts nowhere.
    vertices = np.where(faces > 0, entries.count(entries.vertices, count), 0)
    parts = _place_parts(summaries, bricks)
    seams = _join_seams([_take_seams(part, component, kept) for part in parts])
    verdict = _judge_seams(seams, faces)
    is_vertex_manifold = verdict.surplus_fans == 0
    watertight = verdict.is_edge_manifold and is_vertex_manifold and not verdict.boundary
    genera = _genera(entries, vertices, verdict.edges, faces) if watertight else ()
    return Topology(
        watertight,
        verdict.is_edge_manifold,
        is_vertex_manifold,
        verdict.is_oriented,
        _signed_volume(parts, kept, entries, seams) > 0.0,
        int((faces > 0).sum()),
        sum(genera) if watertight else None,
        genera,
        verdict.boundary,
        verdict.loops,
        int(vertices.sum()),
        int(faces.sum()),
    )


def sum_areas(
    summaries: Sequence[PartSummary], bricks: PartBricks, component: IntArray, entries: Components
) -> FloatArray:
    """Return the area of each component (c,) of the mesh that the parts are.

    `component` is that of each label; `entries` are in bricks that are taken. Areas are rounded:
    they are as large as each other whose sums came in another order, from other parts.
    """
    count = int(component.max(initial=-1)) + 1
    seam_faces = _gather_seam_faces(_place_parts(summaries, bricks), np.ones(len(component), bool))
    (a, b, c), is_known = _find_rim(seam_faces.known, seam_faces.places, seam_faces.corners)
    beyond = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
    areas = np.bincount(entries.component, entries.sums[:, 4], count).astype(np.float64)
    areas += np.bincount(component[seam_faces.labels[is_known]], beyond, count)
    return round_areas(areas)


@dataclass(frozen=True, slots=True, eq=False)
class _SeamFaces:
    """Faces of the mesh with foreign vertices: no part knows where all their corners are.

    Of each the numbers of its corners, and the label; and the numbers of the vertices of all rims,
    sorted, and where they are.
    """

    corners: IntArray
    labels: IntArray
    known: IntArray
    places: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _PlacedPart:
    """A part, and where its vertices and faces come in the mesh, dropped ones counted too."""

    index: int
    summary: PartSummary
    bricks: PartBricks
    starts: IntArray
    face_starts: IntArray

    @property
    def first(self) -> int:
        """The row of its first brick among those of all parts."""
        return int(self.bricks.parts[self.index])

    def bricks_of(self, vertices: NDArray[np.int32]) -> IntArray:
        """Return the bricks of vertices as rows in the part, -1 for foreign ones."""
        starts = starts_of(self.summary.vertex_counts)
        return np.where(vertices < 0, -1, np.searchsorted(starts, vertices, side="right") - 1)

    def bricks_of_faces(self, faces: NDArray[np.integer[Any]]) -> IntArray:
        """Return the bricks of faces as rows in the part."""
        return np.searchsorted(starts_of(self.summary.face_counts), faces, side="right") - 1

    def place(self, vertices: NDArray[np.int32]) -> tuple[IntArray, IntArray]:
        """Return the numbers of vertices in the mesh, and their labels."""
        summary, bricks = self.summary, self.bricks
        numbers = np.empty(len(vertices), np.int64)
        labels = np.empty(len(vertices), np.int64)
        own, foreign = vertices >= 0, ~vertices[vertices < 0]
        # A brick and a number in it name a vertex, whichever copy of the brick counts.
        row = self.bricks_of(vertices[own])
        number = vertices[own] - starts_of(summary.vertex_counts)[row]
        numbers[own] = self.starts[bricks.place[self.first + row]] + number
        labels[own] = bricks.labels_at(self.first + row, number)
        there = np.searchsorted(bricks.keys, summary.foreign_bricks[foreign])
        numbers[~own] = self.starts[there] + summary.foreign_numbers[foreign]
        labels[~own] = bricks.label_starts[self.index] + summary.foreign_labels[foreign]
        return numbers, labels

    def place_faces(self, faces: IntArray) -> IntArray:
        """Return the numbers of faces in the mesh."""
        row = self.bricks_of_faces(faces)
        within = faces - starts_of(self.summary.face_counts)[row]
        return self.face_starts[self.bricks.place[self.first + row]] + within


def _place_parts(summaries: Sequence[PartSummary], bricks: PartBricks) -> list[_PlacedPart]:
    # (B + 1,): where the vertices and the faces of each brick begin if none is dropped.
    starts = starts_of(bricks.vertex_counts[bricks.taken])
    face_starts = starts_of(bricks.face_counts[bricks.taken])
    return [
        _PlacedPart(index, summary, bricks, starts, face_starts)
        for index, summary in enumerate(summaries)
    ]


def _take_seams(part: _PlacedPart, component: IntArray, kept: NDArray[np.bool_]) -> _Seams:
    """Return the seams of a part, without what is dropped or not taken."""
    summary, is_taken = part.summary, part.bricks.is_taken
    numbers, labels = part.place(summary.piece_vertices)
    units = summary.piece_units
    in_guest = units >= 0
    # (p,): pieces that are in the mesh: of labels that stay, in no guest that another gives.
    is_in_mesh = kept[labels] & (~in_guest | is_taken[part.first + units])
    owner = part.bricks_of(summary.piece_vertices)
    # (p,): a guest's unit owns that brick's vertices; the other one, those of the own bricks.
    owns = np.where(in_guest, owner == units, (owner >= 0) & ~summary.guests[owner])
    rows, tails, heads = summary.sides.T.astype(np.int64)
    # (q,): sides of faces in the mesh; (p,): pieces renumbered without those that are not.
    is_counted = is_in_mesh[tails]
    rows, tails, heads = rows[is_counted], tails[is_counted], heads[is_counted]
    renumbered = np.cumsum(is_in_mesh) - 1
    bare, bare_labels = part.place(summary.bare)
    bare_taken = is_taken[part.first + part.bricks_of(summary.bare)]
    return _Seams(
        pieces=numbers[is_in_mesh],
        piece_owners=owns[is_in_mesh],
        bare=bare[bare_taken & kept[bare_labels]],
        sides=3 * part.place_faces(rows // 3) + rows % 3,
        tails=renumbered[tails],
        heads=renumbered[heads],
        components=component[labels[tails]],
    )


def _join_seams(parts: Sequence[_Seams]) -> _Seams:
    """Put the seams of all parts together; their pieces are numbered through."""
    before = starts_of(np.array([len(part.pieces) for part in parts], np.int64))
    moved = [
        replace(part, tails=part.tails + start, heads=part.heads + start)
        for part, start in zip(parts, before, strict=False)
    ]
    return _Seams(
        *(np.concatenate([getattr(part, one.name) for part in moved]) for one in fields(_Seams))
    )


def _judge_seams(seams: _Seams, faces: IntArray) -> _Verdict:
    """Group the sides into edges, count what is wrong, and join the pieces of corners."""
    # (w,), (p,): open vertices, and the one that each piece of corners is at.
    vertices, piece = number_keys(seams.pieces)
    tails, heads = piece[seams.tails], piece[seams.heads]
    low, high = np.minimum(tails, heads), np.maximum(tails, heads)
    # The sides edge by edge, those of one in the order of their faces.
    order = np.lexsort((seams.sides, low * len(vertices) + high))
    edges = (low * len(vertices) + high)[order]
    # (e,): where the sides of each edge begin; how many there are, and how many run backwards.
    first = np.flatnonzero(np.r_[True, edges[1:] != edges[:-1]][: len(edges)])
    counts = np.diff(np.r_[first, len(edges)])
    backward = np.add.reduceat((tails > heads)[order].astype(np.int64), first) if len(first) else 0
    # (e,): a side of each edge.
    side = order[first]
    bare = side[counts == 1]
    fans = _count_fans(seams, order, first[counts >= 2], piece)
    fans += _count_closed_elsewhere(seams, vertices, piece)
    # (c,): the sides that are in no seam are pairs within the parts; the others, edges from above.
    inner = 3 * faces - np.bincount(seams.components, minlength=len(faces))
    outer = np.bincount(seams.components[side], minlength=len(faces))
    return _Verdict(
        boundary=len(bare),
        loops=count_loops(low[bare], high[bare]),
        is_edge_manifold=not ((counts > 2).any() or (low == high)[side].any()),
        is_oriented=not ((backward > 1) | (counts - backward > 1)).any(),
        surplus_fans=fans - len(vertices),
        edges=inner // 2 + outer,
    )


def _count_closed_elsewhere(seams: _Seams, vertices: IntArray, piece: IntArray) -> int:
    """Count the open vertices around which the unit that owns them has a ring of faces.

    That unit has no piece of corners there, and does not call them bare: the ring is a fan of which
    no piece tells.
    """
    is_closed = np.ones(len(vertices), np.bool_)
    is_closed[piece[seams.piece_owners]] = False
    bare = find_keys(vertices, seams.bare)
    is_closed[bare[bare < len(vertices)]] = False
    return int(is_closed.sum())


def _count_fans(seams: _Seams, order: IntArray, pairs: IntArray, vertex: IntArray) -> int:
    """Count the pieces that the pieces of corners form when joined across edges."""
    a, b = order[pairs], order[pairs + 1]
    # (e,): most often the two sides run in opposite directions. Pieces at one end of the edge
    # belong together, whichever way they run.
    runs_back = vertex[seams.tails[a]] == vertex[seams.heads[b]]
    left = np.concatenate([seams.tails[a], seams.heads[a]])
    right = np.concatenate(
        [
            np.where(runs_back, seams.heads[b], seams.tails[b]),
            np.where(runs_back, seams.tails[b], seams.heads[b]),
        ]
    )
    joined = np.stack([left, right, right], axis=1)  # edges as faces with a corner twice
    return kernels.label_components(joined, len(seams.pieces))[0]


def _genera(
    entries: Components, vertices: IntArray, edges: IntArray, faces: IntArray
) -> tuple[int, ...]:
    """Return the genus of each closed component, the one with the most faces first."""
    with_vertices = entries.component[entries.vertices > 0]
    # Among components of as many faces, the one with the first vertex of the mesh comes first.
    found, first = find_first(with_vertices)
    found, first = found[faces[found] > 0], first[faces[found] > 0]
    ranked = found[np.lexsort((first, -faces[found]))]
    genus = (2 - (vertices - edges + faces)) // 2
    return tuple(int(g) for g in genus[ranked])


def _signed_volume(
    parts: Sequence[_PlacedPart], kept: NDArray[np.bool_], entries: Components, seams: _Seams
) -> float:
    """Return six times the volume relative to the mean of the vertices (see `signed_volume`).

    Seen from another point, each face's share changes by the point times twice the face's directed
    area; over all faces these areas add up to the cross products along the boundary, because
    sides that run in opposite directions cancel.
    """
    seam_faces = _gather_seam_faces(parts, kept)
    known, rim = seam_faces.known, seam_faces.places
    a, b, c = _find_rim(known, rim, seam_faces.corners)[0]
    sides = np.stack([seams.pieces[seams.tails], seams.pieces[seams.heads]], axis=1)
    tails, heads = _find_rim(known, rim, sides)[0]
    # (3,): the point that `signed_volume` takes; of a closed mesh, any gives the same.
    mean = entries.sums[:, 1:4].sum(axis=0) / entries.vertices.sum()
    total = entries.sums[:, 0].sum() + (a * np.cross(b, c)).sum()
    return float(total - mean @ np.cross(tails, heads).sum(axis=0))


def _gather_seam_faces(parts: Sequence[_PlacedPart], kept: NDArray[np.bool_]) -> _SeamFaces:
    """Return the faces with foreign vertices, without what is dropped or not taken."""
    faces, names, numbers, places = [], [], [], []
    for part in parts:
        summary = part.summary
        row = part.bricks_of_faces(summary.seam_faces[:, 0])
        corners, labels = part.place(summary.seam_faces[:, 1:].reshape(-1))
        is_counted = part.bricks.is_taken[part.first + row] & kept[labels[::3]]
        faces.append(corners.reshape(-1, 3)[is_counted])
        names.append(labels[::3][is_counted])
        numbers.append(part.place(summary.rim)[0])
        places.append(summary.rim_places)
    known, rows = find_first(np.concatenate(numbers))
    rim = np.concatenate(places)[rows]
    return _SeamFaces(np.concatenate(faces), np.concatenate(names), known, rim)


def _find_rim(
    known: IntArray, rim: FloatArray, wanted: IntArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return where vertices are, shape (k, m, 3) of m rows of k; and of which rows all are known.

    The others are left out.
    """
    if not len(known) or not len(wanted):
        return np.empty((wanted.shape[1], 0, 3)), np.zeros(len(wanted), np.bool_)
    at = find_keys(known, wanted)
    is_known: NDArray[np.bool_] = np.logical_and.reduce(at < len(known), axis=1)
    found: FloatArray = rim[at[is_known]].transpose(1, 0, 2)
    return found, is_known
