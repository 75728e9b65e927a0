"""The topology of a mesh in parts: what `check_mesh` finds, from the seams between the parts.

Around a closed vertex of a part nothing is left to find out. All that is not inside the parts are
the sides between open vertices, which are grouped into edges here, and the pieces of corners at
these vertices, which are joined across the edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface import kernels
from hpcapp.applications.surface.extraction.part_places import starts_of
from hpcapp.applications.surface.extraction.summary import PartSummary
from hpcapp.applications.surface.stitching.bricks import PartBricks
from hpcapp.applications.surface.stitching.topology import Topology, count_loops
from hpcapp.geometry.lattice import find_first, find_keys, number_keys
from hpcapp.geometry.points import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Components:
    """What each brick of the mesh has of each component: e entries, in the order of the bricks.

    Parameters
    ----------
    place : ndarray of int64, shape (e,)
        The brick, as a row of `PartBricks.keys`.
    component : ndarray of int64, shape (e,)
    vertices, faces : ndarray of int32, shape (e,)
        How many.
    sums : ndarray of float64, shape (e, 4)
        See `BrickSums`.
    supports : ndarray of int32, shape (e,)
        How many of the vertices are supported (see `MeshPart`).
    """

    place: IntArray
    component: IntArray
    vertices: NDArray[np.int32]
    faces: NDArray[np.int32]
    sums: FloatArray
    supports: NDArray[np.int32]

    def only(self, chosen: NDArray[np.bool_]) -> Components:
        """Return some of the entries.

        Parameters
        ----------
        chosen : ndarray of bool, shape (e,)
        """
        return Components(*(getattr(self, field.name)[chosen] for field in fields(self)))

    def count(self, values: NDArray[np.int32], components: int) -> IntArray:
        """Sum vertices, faces or supports over each component.

        Parameters
        ----------
        values : ndarray of int32, shape (e,)
            `vertices`, `faces` or `supports`.
        components : int
            How many the mesh has.

        Returns
        -------
        ndarray of int64, shape (components,)
        """
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
    """What the seams say: see `Survey`, and how often a vertex has one fan too many."""

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

    Parameters
    ----------
    summaries : sequence of PartSummary
    bricks : PartBricks
    component : ndarray of int64
        The component of each label.
    kept : ndarray of bool
        Which labels stay.
    entries : Components
        Of components that stay, in bricks that are taken.

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
    # (B + 1,): where the vertices of each brick begin if none is dropped, as seams know only those.
    raw_starts = starts_of(bricks.vertex_counts[bricks.taken])
    seams = _collect_seams(summaries, bricks, component, kept, raw_starts)
    verdict = _judge_seams(seams, faces)
    is_vertex_manifold = verdict.surplus_fans == 0
    watertight = verdict.is_edge_manifold and is_vertex_manifold and not verdict.boundary
    genera = _genera(entries, vertices, verdict.edges, faces) if watertight else ()
    return Topology(
        watertight,
        verdict.is_edge_manifold,
        is_vertex_manifold,
        verdict.is_oriented,
        _signed_volume(summaries, bricks, kept, entries, (raw_starts, seams)) > 0.0,
        int((faces > 0).sum()),
        sum(genera) if watertight else None,
        genera,
        verdict.boundary,
        verdict.loops,
        int(vertices.sum()),
        int(faces.sum()),
    )


def _collect_seams(
    summaries: Sequence[PartSummary],
    bricks: PartBricks,
    component: IntArray,
    kept: NDArray[np.bool_],
    raw_starts: IntArray,
) -> _Seams:
    """Put the seams of all parts together, without what is dropped or not taken."""
    face_starts = starts_of(bricks.face_counts[bricks.taken])
    found = []
    before = 0
    for index, summary in enumerate(summaries):
        first = int(bricks.parts[index])
        raw, labels = _locate(summary.piece_vertices, index, summary, bricks, raw_starts)
        units = summary.piece_units
        in_guest = units >= 0
        # (p,): pieces that are in the mesh: of labels that stay, in no guest that another gives.
        counts = kept[labels] & (~in_guest | bricks.is_taken[first + units])
        owner = _bricks_of(summary.piece_vertices, summary)
        # (p,): a guest's unit owns that brick's vertices; the other one, those of the own bricks.
        owns = np.where(in_guest, owner == units, (owner >= 0) & ~summary.guests[owner])
        rows, tails, heads = summary.sides.T.astype(np.int64)
        starts = starts_of(summary.face_counts)
        # (q,): the brick of each side's face, and the number of that face in the mesh.
        brick = np.searchsorted(starts, rows // 3, side="right") - 1
        faces = face_starts[bricks.place[first + brick]] + rows // 3 - starts[brick]
        # (q,): sides of faces in the mesh; (p,): pieces numbered through without the others.
        on = counts[tails]
        renumbered = before + np.cumsum(counts) - 1
        bare_raw, bare_labels = _locate(summary.bare, index, summary, bricks, raw_starts)
        bare_taken = bricks.is_taken[first + _bricks_of(summary.bare, summary)]
        found.append(
            (
                raw[counts],
                owns[counts],
                bare_raw[bare_taken & kept[bare_labels]],
                (3 * faces + rows % 3)[on],
                renumbered[tails[on]],
                renumbered[heads[on]],
                component[labels[tails[on]]],
            )
        )
        before += int(counts.sum())
    return _Seams(*(np.concatenate(column) for column in zip(*found, strict=True)))


def _bricks_of(vertices: NDArray[np.int32], summary: PartSummary) -> IntArray:
    """Return the bricks of vertices as rows in the part, -1 for foreign ones."""
    starts = starts_of(summary.vertex_counts)
    return np.where(vertices < 0, -1, np.searchsorted(starts, vertices, side="right") - 1)


def _locate(
    vertices: NDArray[np.int32],
    index: int,
    summary: PartSummary,
    bricks: PartBricks,
    raw_starts: IntArray,
) -> tuple[IntArray, IntArray]:
    """Return the numbers of a part's vertices, counted over all bricks, and their labels."""
    numbers = np.empty(len(vertices), np.int64)
    labels = np.empty(len(vertices), np.int64)
    own, foreign = vertices >= 0, ~vertices[vertices < 0]
    # A brick and a number in it name a vertex, whichever copy of the brick counts.
    row = _bricks_of(vertices[own], summary)
    brick = int(bricks.parts[index]) + row
    number = vertices[own] - starts_of(summary.vertex_counts)[row]
    numbers[own] = raw_starts[bricks.place[brick]] + number
    labels[own] = bricks.labels_at(brick, number)
    there = np.searchsorted(bricks.keys, summary.foreign_bricks[foreign])
    numbers[~own] = raw_starts[there] + summary.foreign_numbers[foreign]
    labels[~own] = bricks.label_starts[index] + summary.foreign_labels[foreign]
    return numbers, labels


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
    degenerate = (low == high)[order[first]]
    fans = _count_fans(seams, order, first[counts >= 2], piece)
    # (w,): where the unit that owns a vertex has neither a piece there nor calls it bare, its faces
    # make a ring around it: a fan of which no piece tells.
    is_closed_elsewhere = np.ones(len(vertices), np.bool_)
    is_closed_elsewhere[piece[seams.piece_owners]] = False
    bare = find_keys(vertices, seams.bare)
    is_closed_elsewhere[bare[bare < len(vertices)]] = False
    # (c,): the sides that are in no seam are pairs within the parts; the others, edges from above.
    inner = 3 * faces - np.bincount(seams.components, minlength=len(faces))
    outer = np.bincount(seams.components[order[first]], minlength=len(faces))
    return _Verdict(
        int((counts == 1).sum()),
        count_loops(low[order[first[counts == 1]]], high[order[first[counts == 1]]]),
        not (counts > 2).any() and not degenerate.any(),
        not ((backward > 1) | (counts - backward > 1)).any(),
        fans + int(is_closed_elsewhere.sum()) - len(vertices),
        inner // 2 + outer,
    )


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
    summaries: Sequence[PartSummary],
    bricks: PartBricks,
    kept: NDArray[np.bool_],
    entries: Components,
    seams: tuple[IntArray, _Seams],
) -> float:
    """Return six times the volume relative to the mean of the vertices (see `signed_volume`).

    Seen from another point, each face's share changes by the point times twice the face's directed
    area; over all faces these areas add up to the cross products along the boundary, because
    sides that run in opposite directions cancel.
    """
    raw_starts, loose = seams
    faces, numbers, places = [], [], []
    for index, summary in enumerate(summaries):
        # (s,): the brick of each face with foreign vertices, from 1 on. No part knows where all the
        # corners of such a face are, so that it is in no part's sum.
        brick = np.searchsorted(starts_of(summary.face_counts), summary.seam_faces[:, 0], "right")
        corners, labels = _locate(
            summary.seam_faces[:, 1:].reshape(-1), index, summary, bricks, raw_starts
        )
        counted = bricks.is_taken[bricks.parts[index] + brick - 1] & kept[labels[::3]]
        faces.append(corners.reshape(-1, 3)[counted])
        numbers.append(_locate(summary.rim, index, summary, bricks, raw_starts)[0])
        places.append(summary.rim_places)
    # (r,), (r, 3): the vertices of all rims, each once, and where they are.
    known, rows = find_first(np.concatenate(numbers))
    rim = np.concatenate(places)[rows]
    a, b, c = _find_rim(known, rim, np.concatenate(faces))
    tails, heads = _find_rim(
        known, rim, np.stack([loose.pieces[loose.tails], loose.pieces[loose.heads]], axis=1)
    )
    # (3,): the point that `signed_volume` takes; of a closed mesh, any gives the same.
    mean = entries.sums[:, 1:].sum(axis=0) / entries.vertices.sum()
    total = entries.sums[:, 0].sum() + (a * np.cross(b, c)).sum()
    return float(total - mean @ np.cross(tails, heads).sum(axis=0))


def _find_rim(known: IntArray, rim: FloatArray, wanted: IntArray) -> FloatArray:
    """Return where vertices are, shape (k, m, 3) of m rows of k; without rows that hide one."""
    if not len(known) or not len(wanted):
        return np.empty((wanted.shape[1], 0, 3))
    at = find_keys(known, wanted)
    found: FloatArray = rim[at[(at < len(known)).all(axis=1)]].transpose(1, 0, 2)
    return found
