"""A part of a closed mesh, cut open along the line where the points' support ends.

::

    part, clearances ── survey_opening ──> labels of bare patches, ids of what is cut
                                             │ the master joins patches, and matches the seams
    part, its survey ── cut_opening <────────┘ which patches stay, numbers of foreign vertices

A triangle that the line crosses is cut in two: no vertex of the boundary is off the line, and no
triangle stands out from it. The vertices of the line are known by the edges that they cut, and
these by the bricks and numbers of their ends. So they are the same in every part.

**Numbers.** In a brick of the open mesh its supported vertices come first, then the cuts through
the edges of its faces, in the order of the edges; then, where a patch that stays is in the brick,
the bare vertices. None of that depends on which patches stay, or on another part. An edge on the
side of two bricks has a place in both, and that in the brick of the lower key is the one meant.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.extraction.part_places import starts_of
from hpcapp.applications.surface.extraction.parts import ForeignBricks, ForeignNumbers, MeshPart
from hpcapp.applications.surface.types.result_patterns import ComponentBoxes
from hpcapp.geometry.lattice import find_first, find_keys, number_keys, unique_keys
from hpcapp.geometry.points import BoolArray, Float32Array, FloatArray, Int32Array, IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.columns import Column
from hpccomponent.protocol.records import record

_SHORTEST = 0.1  # of an edge: the line keeps this share from its ends, so that no face is a sliver


@record("surface.opening_seams")
@dataclass(frozen=True, slots=True, eq=False)
class OpeningSeams:
    """What the master must know of a part that is to be cut open; c patches, g foreign vertices."""

    foreign_bricks: ForeignBricks
    foreign_numbers: ForeignNumbers
    """Of the foreign vertices, in the closed mesh."""
    foreign_labels: Annotated[Int32Array, Column("g", low=-1)]
    """The bare patch that each lies in; -1 where it is supported."""
    rim_labels: Annotated[Int32Array, Column("r", low=-1)]
    """Likewise, of the vertices in `PartSummary.rim`."""
    rim_numbers: Annotated[Int32Array, Column("r", low=-1)]
    """Their numbers in their bricks of the open mesh; -1 in bricks that another part gives."""
    extents: ComponentBoxes
    """Of the bare vertices, patch by patch."""
    is_bounded: Annotated[BoolArray, Column("c")]
    """Whether the line where support ends runs along each patch."""
    edges: Annotated[IntArray, Column("m", 6, low=0)]
    """Cut edges with one face in the part: brick and number of both ends in the closed mesh, the
    brick of the face, and the number there of the cut."""


@record("surface.opening_survey")
@dataclass(frozen=True, slots=True, eq=False)
class OpeningSurvey:
    """What `cut_opening` must know of a part; v vertices, g foreign ones, k places of cuts.

    `clearances` and `labels` (v + g,) are of the part's vertices and then the foreign ones, which
    are at `places` (g, 3): supported below 1, and the bare patch of each, -1 where it is supported.
    `cut_bricks` (k,) are the brick of each cut, as a row of the part, sorted; `cut_ends` (k, 2) the
    ends of its edge, the lower one first; it `is_lone` where the edge has but one face in the part.
    """

    clearances: Float32Array
    labels: Int32Array
    places: FloatArray
    cut_bricks: IntArray
    cut_ends: IntArray
    is_lone: BoolArray


def drop_copies(
    part: MeshPart, taken: BoolArray, places: FloatArray
) -> tuple[MeshPart, FloatArray]:
    """Leave out the bricks that another part gives; what faces use of them becomes foreign.

    `taken` (b,) tells which bricks the part gives, `places` (g, 3) where its foreign vertices are.
    Returns the part, without guests, and where the foreign vertices of that are.
    """
    if taken.all():
        return replace(part, guests=np.zeros(len(taken), np.bool_)), places
    # (v,): the vertices that stay its own; then the corners of the faces that stay.
    own = np.repeat(taken, part.vertex_counts)
    corners = part.faces[np.repeat(taken, part.face_counts)].reshape(-1)
    starts, count = starts_of(part.vertex_counts), len(part.vertices)
    used = unique_keys(corners).astype(np.int64)
    named, outer = ~used[used < 0], used[used >= 0]
    outer = outer[~own[outer]]
    owners = np.searchsorted(starts, outer, side="right") - 1
    # Foreign from now on: what was foreign and is still used, and what the others' bricks hold.
    bricks = np.concatenate([part.foreign_bricks[named], part.bricks[owners]])
    outer_numbers = (outer - starts[owners]).astype(np.int32)
    numbers = np.concatenate([part.foreign_numbers[named], outer_numbers])
    order = np.lexsort((numbers, bricks))
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    # (v + g,): what a corner becomes: a row, or ~ of a foreign vertex.
    meaning = np.empty(count + len(part.foreign_bricks), np.int64)
    meaning[:count] = np.cumsum(own) - 1
    meaning[outer] = ~rank[len(named) :]
    meaning[~named] = ~rank[: len(named)]  # negative indices find them
    cut = MeshPart(
        part.bricks[taken],
        np.zeros(int(taken.sum()), np.bool_),
        part.vertex_counts[taken],
        part.face_counts[taken],
        part.vertices[own],
        meaning[corners].reshape(-1, 3).astype(np.int32),
        bricks[order],
        numbers[order],
        part.supported[own],
    )
    return cut, np.concatenate([places[named], part.vertices[outer]])[order]


def survey_opening(
    part: MeshPart, places: FloatArray, clearances: Float32Array, rim: IntArray
) -> tuple[OpeningSurvey, OpeningSeams]:
    """Find the bare patches of a part without guests, and what the line around them cuts.

    `places` (g, 3) are where its foreign vertices are, and `clearances` (v + g,) those of its
    vertices and then the foreign ones. `rim` (r,) has rows of vertices that other parts may name;
    -1 for those that another part has.
    """
    own, bare = len(part.vertices), clearances >= 1.0
    # (3 f,): both ends of each side of a face, as nodes.
    tails = _as_nodes(part)
    heads = np.roll(tails, -1, axis=1)
    tails, heads = tails.reshape(-1), heads.reshape(-1)
    # (3 f,): sides within a bare patch.
    within = bare[tails] & bare[heads]
    labels, patches = _label_bare(tails[within], heads[within], bare)
    across = np.flatnonzero(bare[tails] != bare[heads])  # sides that the line crosses
    tails, heads = tails[across], heads[across]
    is_bounded = np.zeros(patches, np.bool_)
    is_bounded[np.maximum(labels[tails], labels[heads])] = True
    # (s,): the brick of the face that each of these is a side of.
    brick_of = np.repeat(np.arange(len(part.bricks)), part.face_counts)[across // 3]
    cuts, is_lone = _find_cuts(_rank_nodes(part, tails, heads), brick_of, tails, heads)
    survey = OpeningSurvey(clearances, labels, places, cuts[:, 0], cuts[:, 1:], is_lone)
    numbers = _Numbers(part, survey)
    seams = OpeningSeams(
        part.foreign_bricks,
        part.foreign_numbers,
        labels[own:],
        np.where(rim < 0, -1, np.append(labels[:own], -1)[rim]).astype(np.int32),
        np.where(rim < 0, -1, np.append(numbers.vertices, -1)[rim]).astype(np.int32),
        _bound_patches(np.concatenate([part.vertices, places]), labels, patches),
        is_bounded,
        _name_edges(part, cuts[is_lone], numbers.cuts[is_lone]),
    )
    return survey, seams


def cut_opening(
    part: MeshPart,
    survey: OpeningSurvey,
    stays: BoolArray,
    foreign_numbers: IntArray,
    seam_cuts: IntArray,
) -> MeshPart:
    """Leave out the bare patches of a part without guests, but for holes that are filled.

    These are the patches that `stays` (c,). `foreign_numbers` (g,) are those of the foreign
    vertices in their bricks of the open mesh, `seam_cuts` (m, 2) brick and number of the cuts
    through the edges of `OpeningSeams.edges`.
    """
    numbers = _Numbers(part, survey)
    stays_there = np.append(stays, True)[survey.labels]  # label -1 is the last one
    bricks = np.concatenate([part.bricks[numbers.bricks], part.foreign_bricks])
    names = np.stack([bricks, np.concatenate([numbers.vertices, foreign_numbers])], axis=1)
    cuts = _Cuts(part, survey, numbers, seam_cuts)
    points = np.concatenate([part.vertices, survey.places])
    brick_of, corners = _cut_faces(part, points, stays_there, names, cuts)
    vertices, counts = _lay_vertices(part, survey, numbers, stays_there, cuts)
    face_counts = np.bincount(brick_of, minlength=len(part.bricks))
    return _assemble(part.bricks, vertices, counts, corners, face_counts)


class _Numbers:
    """The numbers of the vertices, and of the cuts, in their bricks of the open mesh."""

    def __init__(self, part: MeshPart, survey: OpeningSurvey) -> None:
        own, bricks = len(part.vertices), len(part.bricks)
        starts = starts_of(part.vertex_counts)
        self.bricks = np.repeat(np.arange(bricks), part.vertex_counts)
        self.is_bare = survey.labels[:own] >= 0
        before = starts_of(self.is_bare)
        # (v,): how many bare and supported vertices stand before each in its brick.
        bare_before = before[:-1] - before[starts[self.bricks]]
        supported_before = np.arange(own) - starts[self.bricks] - bare_before
        # (b,): supported vertices come first, then the cuts, then the bare ones.
        supported = part.vertex_counts - np.diff(before[starts])
        cut_counts = np.bincount(survey.cut_bricks, minlength=bricks)
        # (k,): how many cuts stand before each in its brick.
        turn = np.arange(len(survey.cut_bricks)) - starts_of(cut_counts)[survey.cut_bricks]
        self.cuts = supported[survey.cut_bricks] + turn
        behind = (supported + cut_counts)[self.bricks]
        self.vertices = np.where(self.is_bare, behind + bare_before, supported_before)


class _Cuts:
    """The cuts through the edges of a part: where they are, and by which names."""

    def __init__(
        self, part: MeshPart, survey: OpeningSurvey, numbers: _Numbers, seam_cuts: IntArray
    ) -> None:
        low, high = survey.cut_ends.T
        self._count = len(survey.clearances)
        points = np.concatenate([part.vertices, survey.places])
        clearance = survey.clearances.astype(np.float64)
        # (k, 1): where along the edge the clearance is 1.
        share = (1.0 - clearance[low]) / (clearance[high] - clearance[low])
        share = share.clip(_SHORTEST, 1.0 - _SHORTEST)[:, None]
        self.places = points[low] + share * (points[high] - points[low])
        keys = low * self._count + high
        self._keys, self._first = find_first(keys)  # the bricks rise, so in the lowest one
        # (k, 2): brick and number; those on a seam by the names that all parts agree on.
        named = np.stack([part.bricks[survey.cut_bricks], numbers.cuts], axis=1)
        named[survey.is_lone] = seam_cuts
        self._names = named[self._first]

    def find(self, tails: IntArray, heads: IntArray) -> tuple[IntArray, FloatArray]:
        """Return the names, brick and number, and the places of the cuts of some edges."""
        # An edge is known by its ends in one order; those in the other are looked for turned round.
        rows = find_keys(self._keys, tails * self._count + heads)
        missing = rows == len(self._keys)
        turned = heads[missing] * self._count + tails[missing]
        rows[missing] = np.searchsorted(self._keys, turned)
        return self._names[rows], self.places[self._first[rows]]


def _as_nodes(part: MeshPart) -> IntArray:
    """Return the corners of the faces: rows of the vertices, and behind them the foreign ones."""
    faces = part.faces.astype(np.int64)
    return np.where(faces < 0, len(part.vertices) + ~faces, faces)


def _label_bare(tails: IntArray, heads: IntArray, bare: BoolArray) -> tuple[Int32Array, int]:
    """Label the bare vertices by the patches that edges make of them."""
    labels = np.full(len(bare), -1, np.int32)
    joined = np.stack([tails, heads, heads], axis=1)  # edges as faces with a corner twice
    # Numbers from 0 for the components of bare vertices; a supported one is its own, and left out.
    patches, numbers = number_keys(kernels.label_components(joined, len(bare))[1][bare])
    labels[bare] = numbers
    return labels, len(patches)


def _bound_patches(points: FloatArray, labels: Int32Array, patches: int) -> FloatArray:
    """Bound the vertices of bare patches."""
    bare = np.flatnonzero(labels >= 0)
    # (c, 6): inside out at first, so that any place bounds them.
    extents = np.full((patches, 6), np.inf)
    extents[:, 3:] = -np.inf
    np.minimum.at(extents[:, :3], labels[bare], points[bare])
    np.maximum.at(extents[:, 3:], labels[bare], points[bare])
    return extents


def _rank_nodes(part: MeshPart, tails: IntArray, heads: IntArray) -> IntArray:
    """Rank the ends of some edges by brick and number: the order is the same in all parts."""
    own, starts = len(part.vertices), starts_of(part.vertex_counts)
    ends = unique_keys(np.concatenate([tails, heads]))
    is_own = ends < own
    bricks, numbers = np.empty(len(ends), np.int64), np.empty(len(ends), np.int64)
    # (e,) each: own ones are known by the row in the part, foreign ones by their names.
    rows = np.searchsorted(starts, ends[is_own], side="right") - 1
    bricks[is_own], numbers[is_own] = part.bricks[rows], ends[is_own] - starts[rows]
    foreign = ends[~is_own] - own
    bricks[~is_own], numbers[~is_own] = part.foreign_bricks[foreign], part.foreign_numbers[foreign]
    # (v + g,): nodes that no cut has stay 0; nobody looks them up.
    ranks = np.zeros(own + len(part.foreign_bricks), np.int64)
    ranks[ends[np.lexsort((numbers, bricks))]] = np.arange(len(ends))
    return ranks


def _find_cuts(
    ranks: IntArray, brick_of: IntArray, tails: IntArray, heads: IntArray
) -> tuple[IntArray, BoolArray]:
    """Return brick and ends of each cut, sorted, and whether its edge has one side here."""
    # (s,): the ends in the order that all parts know, so that all cut at the very same place.
    forward = ranks[tails] < ranks[heads]
    low, high = np.where(forward, tails, heads), np.where(forward, heads, tails)
    # (s, 3): brick of the face and both ends of each side, sorted; a cut for each brick of an edge.
    order = np.lexsort((ranks[high], ranks[low], brick_of))
    sides = np.stack([brick_of, low, high], axis=1)[order]
    first = np.ones(len(sides), np.bool_)
    first[1:] = (sides[1:] != sides[:-1]).any(axis=1)
    cuts = sides[first]
    # (s,): the edge of each side, whatever its brick. With one side here, it is a seam's.
    _, edge = number_keys(sides[:, 1] * len(ranks) + sides[:, 2])
    is_lone = np.bincount(edge)[edge[first]] == 1 if len(edge) else first
    return cuts, is_lone


def _name_edges(part: MeshPart, cuts: IntArray, numbers: IntArray) -> IntArray:
    """Return some cuts as in `OpeningSeams.edges`."""
    starts = starts_of(part.vertex_counts)
    named = np.empty((len(cuts), 6), np.int64)
    for column, ends in enumerate(cuts[:, 1:].T):
        # (m,): rows of the foreign vertices; below 0 where an end is the part's own.
        foreign = ends - len(part.vertices)
        is_own = foreign < 0
        rows = np.searchsorted(starts, ends[is_own], side="right") - 1
        named[is_own, 2 * column] = part.bricks[rows]
        named[is_own, 2 * column + 1] = ends[is_own] - starts[rows]
        named[~is_own, 2 * column] = part.foreign_bricks[foreign[~is_own]]
        named[~is_own, 2 * column + 1] = part.foreign_numbers[foreign[~is_own]]
    named[:, 4], named[:, 5] = part.bricks[cuts[:, 0]], numbers
    return named


def _cut_faces(
    part: MeshPart, points: FloatArray, stays: BoolArray, names: IntArray, cuts: _Cuts
) -> tuple[IntArray, IntArray]:
    """Return brick row and named corners, shape (f, 3, 2), of what stays of the faces."""
    nodes = _as_nodes(part)
    # (f, 3): which corners of each face stay.
    inside = stays[nodes]
    kinds = inside.sum(axis=1)  # (f,): how many corners stay
    whole = np.flatnonzero(kinds == 3)

    tips = np.flatnonzero(kinds == 1)  # one corner stays: so does a triangle at it
    a, b, c = _turn(nodes[tips], np.argmax(inside[tips], axis=1))
    tip = np.stack([names[a], cuts.find(a, b)[0], cuts.find(a, c)[0]], axis=1)

    bases = np.flatnonzero(kinds == 2)  # two stay: so does a quadrangle, cut in two
    c, a, b = _turn(nodes[bases], np.argmin(inside[bases], axis=1))
    (from_b, at_b), (from_a, at_a) = cuts.find(b, c), cuts.find(a, c)
    is_short = _square(at_b - points[a]) < _square(at_a - points[b])  # that diagonal
    third = np.where(is_short[:, None], from_b, from_a)
    start = np.where(is_short[:, None], names[a], names[b])
    first = np.stack([names[a], names[b], third], axis=1)
    second = np.stack([start, from_b, from_a], axis=1)

    # In the order of the faces that they come from, which is that of the bricks.
    source = np.concatenate([whole, tips, bases, bases])
    order = np.argsort(source, kind="stable")
    brick_of = np.repeat(np.arange(len(part.bricks)), part.face_counts)
    pieces = np.concatenate([names[nodes[whole]], tip, first, second])
    return brick_of[source[order]], pieces[order]


def _turn(nodes: IntArray, first: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Return the corners of faces, each from a certain one on."""
    rows = np.arange(len(nodes))
    a, b, c = (nodes[rows, (first + k) % 3] for k in range(3))
    return a, b, c


def _square(vectors: FloatArray) -> FloatArray:
    x, y, z = vectors.T
    squares: FloatArray = x * x + y * y + z * z
    return squares


def _lay_vertices(
    part: MeshPart, survey: OpeningSurvey, numbers: _Numbers, stays: BoolArray, cuts: _Cuts
) -> tuple[FloatArray, IntArray]:
    """Return the vertices of the open part, brick by brick, and how many each has."""
    supported, bare = np.flatnonzero(~numbers.is_bare), np.flatnonzero(numbers.is_bare)
    has_filled = np.zeros(len(part.bricks), np.bool_)
    has_filled[numbers.bricks[bare[stays[bare]]]] = True
    bare = bare[has_filled[numbers.bricks[bare]]]  # all of a brick: their numbers are taken
    places = np.concatenate([part.vertices[supported], cuts.places, part.vertices[bare]])
    bricks = [numbers.bricks[supported], survey.cut_bricks, numbers.bricks[bare]]
    brick_of = np.concatenate(bricks)
    # Brick by brick, in each the supported ones, the cuts and the bare ones, as `_Numbers` has it.
    order = np.argsort(brick_of, kind="stable")
    return places[order], np.bincount(brick_of, minlength=len(part.bricks))


def _assemble(
    bricks: IntArray,
    vertices: FloatArray,
    vertex_counts: IntArray,
    corners: IntArray,
    face_counts: IntArray,
) -> MeshPart:
    """Make a part of named corners; bricks that have nothing are left out."""
    filled = (vertex_counts > 0) | (face_counts > 0)
    bricks, vertex_counts, face_counts = bricks[filled], vertex_counts[filled], face_counts[filled]
    brick_keys, numbers = corners.reshape(-1, 2).T  # (3 f,): the name of each corner
    rows = find_keys(bricks, brick_keys)
    is_own = rows < len(bricks)
    faces = np.empty(len(rows), np.int64)
    faces[is_own] = starts_of(vertex_counts)[rows[is_own]] + numbers[is_own]
    # The foreign ones, each once: sorted by brick and number, both in one integer.
    foreign_keys, brick_names = number_keys(brick_keys[~is_own])
    pairs, named = number_keys(brick_names << 32 | numbers[~is_own])
    faces[~is_own] = ~named
    return MeshPart(
        bricks,
        np.zeros(len(bricks), np.bool_),
        vertex_counts.astype(np.int32),
        face_counts.astype(np.int32),
        vertices,
        faces.astype(np.int32).reshape(-1, 3),
        foreign_keys[pairs >> 32],
        (pairs & 0xFFFFFFFF).astype(np.int32),
        np.ones(len(vertices), np.bool_),  # nothing else is left of it
    )
