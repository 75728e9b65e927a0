"""What a master must know of a part of a mesh to weld it to the others, and no more.

A part consists of units: the bricks that are its own, together, and each guest brick by itself,
because a guest counts only where no other part has the brick.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.extraction.parts import (
    BrickCounts,
    BrickFlags,
    BrickKeys,
    ForeignBricks,
    ForeignNumbers,
    MeshPart,
)
from hpcapp.applications.surface.types.result_patterns import LENGTH, ComponentBoxes
from hpcapp.geometry.lattice import find_keys, number_keys, unique_keys
from hpcapp.geometry.points import BoolArray, FloatArray, Int32Array
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.columns import Column
from hpccomponent.protocol.records import record

EntryCounts = Annotated[Int32Array, Column("e", low=0)]


@record("surface.part_summary")
@dataclass(frozen=True, slots=True, eq=False)
class PartSummary:
    """A part without its vertices and faces; b bricks, g foreign vertices, c components.

    Vertices are named as in `MeshPart.faces`: i >= 0 is a row, i < 0 the foreign vertex ~i.
    """

    bricks: BrickKeys
    guests: BrickFlags
    vertex_counts: BrickCounts
    face_counts: BrickCounts
    foreign_bricks: ForeignBricks
    foreign_numbers: ForeignNumbers
    """This, and the five before it, as in `MeshPart`."""
    foreign_labels: Annotated[Int32Array, Column("g", low=0)]
    """The component of each foreign vertex."""
    entry_starts: Annotated[Int32Array, Column("b+1", low=0)]
    """Where the entries of each brick begin: the components that it has vertices or faces of."""
    entry_labels: EntryCounts
    """The component of each entry."""
    entry_vertices: EntryCounts
    """How many of its brick's vertices belong to it."""
    entry_faces: EntryCounts
    """Likewise, of the faces."""
    entry_sums: Annotated[FloatArray, Column("e", 5)]
    """Six times its signed volume, the sum of its vertices' positions, and its area (see
    `BrickSums`)."""
    entry_supports: EntryCounts
    """How many of the vertices of each entry are supported."""
    mixed_labels: Annotated[Int32Array, Column("m", low=0)]
    """The component of every vertex of bricks with vertices of more than one."""
    bounds: ComponentBoxes
    """Lowest and highest coordinates of the vertices of each component."""
    piece_vertices: Annotated[Int32Array, Column("p")]
    """The open vertex of each piece of corners (see `Seams`)."""
    piece_units: Annotated[Int32Array, Column("p", low=-1)]
    """Which guest brick the piece lies in; -1 in the part's own bricks."""
    sides: Annotated[Int32Array, Column("q", 3, low=0)]
    """Sides between open vertices, and the pieces at their ends."""
    bare: Annotated[Int32Array, Column("u")]
    """Vertices that no face of their own unit uses."""
    seam_faces: Annotated[Int32Array, Column("s", 4)]
    """Faces with foreign vertices: the row and the three vertices."""
    rim: Annotated[Int32Array, Column("r", low=0, rises=True)]
    """Open and bare vertices of the part, and those of its seam faces."""
    rim_places: Annotated[FloatArray, Column("r", 3, unit=LENGTH)]
    """Where they are."""


@dataclass(frozen=True, slots=True, eq=False)
class _Nodes:
    """The vertices as the units of a part see them; first the part's vertices, then the foreign.

    Those come once more for each guest brick that uses them: all bricks' own unit sees them as
    the first v + g nodes.
    """

    faces: Int32Array
    vertex_of: Int32Array
    unit_of: Int32Array
    is_open: BoolArray


def summarize_part(part: MeshPart) -> PartSummary:
    """Sum up a part for `plan_stitching`.

    It takes a few per cent of the part's size: it grows with the bricks and along the seams.
    """
    own = len(part.vertices)
    nodes = _name_nodes(part)
    all_vertices = (own, len(part.foreign_bricks))
    seams = kernels.find_seams(nodes.faces, all_vertices, nodes.vertex_of, nodes.is_open)
    counts = (part.vertex_counts, part.face_counts)
    sums = kernels.sum_bricks(part.vertices, part.faces, counts, seams.labels, seams.components)
    # Vertices that other parts may have to be compared at: open ones, bare ones, and those of
    # faces with foreign vertices; of these the part's own make the rim.
    pieces, bare = nodes.vertex_of[seams.pieces], nodes.vertex_of[seams.bare]
    at_seam = unique_keys(np.flatnonzero(part.faces.reshape(-1) < 0) // 3)
    rim = unique_keys(np.concatenate([pieces, bare, part.faces[at_seam].reshape(-1)]))
    rim = rim[np.searchsorted(rim, 0) : np.searchsorted(rim, own)]
    return PartSummary(
        part.bricks,
        part.guests,
        *counts,
        part.foreign_bricks,
        part.foreign_numbers,
        seams.labels[own:],
        sums.starts,
        sums.labels,
        sums.vertices,
        sums.faces,
        sums.sums,
        _count_supported(part, sums.starts, sums.labels, seams.labels[:own]),
        _mixed_labels(part.vertex_counts, sums.starts, sums.vertices, seams.labels),
        sums.bounds,
        _as_in_faces(pieces, own),
        nodes.unit_of[seams.pieces],
        seams.sides,
        bare,
        np.concatenate([at_seam[:, None].astype(np.int32), part.faces[at_seam]], axis=1),
        rim,
        part.vertices[rim],
    )


def _name_nodes(part: MeshPart) -> _Nodes:
    """Give the vertices of each guest brick's faces nodes of their own."""
    own, all_vertices = len(part.vertices), len(part.vertices) + len(part.foreign_bricks)
    is_open = np.zeros(all_vertices, np.bool_)
    is_open[own:] = True
    vertex_of = np.arange(all_vertices, dtype=np.int32)
    unit_of = np.full(all_vertices, -1, np.int32)
    if not part.guests.any():
        return _Nodes(part.faces, vertex_of, unit_of, is_open)
    brick_of = np.repeat(np.arange(len(part.bricks)), part.vertex_counts)
    in_guest = np.repeat(part.guests, part.vertex_counts)
    of_guest = np.repeat(part.guests, part.face_counts)
    units = np.repeat(np.arange(len(part.bricks)), part.face_counts)[of_guest]
    is_open[:own] = in_guest
    # Of the guests' faces: each (unit, vertex), as one number, becomes a node; vertices of guest
    # bricks too, whether a face uses them or not.
    corners = part.faces[of_guest]
    corners = np.where(corners < 0, own + ~corners, corners)
    named = np.concatenate(
        [
            (units[:, None] * all_vertices + corners).reshape(-1),
            brick_of[in_guest] * all_vertices + np.flatnonzero(in_guest),
        ]
    )
    pairs, nodes = number_keys(named)
    unit, vertex = np.divmod(pairs, all_vertices)
    faces = part.faces.copy()
    faces[of_guest] = all_vertices + nodes[: 3 * len(units)].reshape(-1, 3)
    # A unit is sure only of vertices of its own brick.
    is_own = (vertex < own) & (np.append(brick_of, -1)[np.minimum(vertex, own)] == unit)
    return _Nodes(
        faces,
        np.concatenate([vertex_of, vertex.astype(np.int32)]),
        np.concatenate([unit_of, unit.astype(np.int32)]),
        np.concatenate([is_open, ~is_own]),
    )


def _count_supported(
    part: MeshPart, starts: Int32Array, entry_labels: Int32Array, labels: Int32Array
) -> Int32Array:
    """Count the supported vertices of each entry; `labels` are those of the part's vertices."""
    rows, bricks = np.flatnonzero(part.supported), np.arange(len(part.bricks))
    # (e,) and (s,): brick and component of each entry and of each supported vertex, as one number.
    entries = np.repeat(bricks, np.diff(starts)) << 32 | entry_labels
    order = np.argsort(entries)
    of_vertices = np.repeat(bricks, part.vertex_counts)[rows] << 32 | labels[rows]
    entry_of = order[find_keys(entries[order], of_vertices)]
    return np.bincount(entry_of, minlength=len(entries)).astype(np.int32)


def _mixed_labels(
    vertex_counts: Int32Array, starts: Int32Array, vertices: Int32Array, labels: Int32Array
) -> Int32Array:
    """Return the labels of the vertices in bricks with vertices of more than one component."""
    brick_of_entry = np.repeat(np.arange(len(vertex_counts)), np.diff(starts))
    kinds = np.bincount(brick_of_entry[vertices > 0], minlength=len(vertex_counts))
    return labels[: int(vertex_counts.sum())][np.repeat(kinds > 1, vertex_counts)]


def _as_in_faces(vertices: Int32Array, own: int) -> Int32Array:
    named: Int32Array = np.where(vertices < own, vertices, ~(vertices - own))
    return named
