"""The small handles of a surface, cut group of bricks by group, wherever its parts are.

::

    bricks ──> groups that overlap ── faces ──> handles ── cut ──> faces taken out, patches
                                                                      │
    parts without those faces, and one more part of all the patches <─┘

Groups are cubes of bricks, taken in the order of their places, and each sees what those before it
have done: so it is of no consequence which parts the bricks are in.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from hpcapp.applications.surface.extraction.part_places import starts_of
from hpcapp.applications.surface.extraction.parts import MeshPart, drop_faces
from hpcapp.applications.surface.extraction.summary import PartSummary, summarize_part
from hpcapp.applications.surface.stitching.assemble import Blocks
from hpcapp.applications.surface.stitching.handles import (
    BOX,
    find_small_handles,
    find_suspects,
    is_hollow,
    measure_side,
)
from hpcapp.applications.surface.stitching.surface import Surface
from hpcapp.cancellation import check_cancelled
from hpcapp.geometry.lattice import find_keys, number_keys, pack_places, unique_keys, unpack_keys
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.wording import say_count
from hpccomponent.dataclass import dataclass

if TYPE_CHECKING:
    from hpcapp.mending.handles import HandleCutter

GROUP, MARGIN = 16, 2
"""Bricks along the side of a group, and those that it sees around it: more than a handle with the
ring around it is wide. With a larger group memory grows, with a smaller one what is seen twice; it
is twice the margin at least."""
_ROUNDS = 16  # over the handles of a group: what one hides from the lattices comes in the next


@dataclass(slots=True, eq=False)
class Mended:
    """What has become of the small handles of a surface, of which none is wider than `width`.

    `hollows` are small closed pieces within, which were dropped; `place` (3,) is in the middle of a
    handle that was left, in the coordinates of the input.
    """

    cut: int = 0
    left: int = 0
    hollows: int = 0
    place: FloatArray = field(default_factory=lambda: np.zeros(3))
    width: float = 0.0

    def say(self) -> str:
        """Return it in words."""
        handles = f"cut {say_count(self.cut, 'small handle')}"
        return handles + (f", dropped {say_count(self.hollows, 'hollow')}" if self.hollows else "")

    def facts(self) -> dict[str, Any]:
        """Return it for the report: JSON values."""
        return {
            "handles_cut": self.cut,
            "hollows_dropped": self.hollows,
            "handles_left": self.left,
            **({"handle_place": self.place.tolist()} if self.left else {}),
            "handle_width": self.width,
        }


@dataclass(slots=True, eq=False)
class _Edits:
    """What is to become of a mesh of n vertices: those of patches have the numbers from n on."""

    vertex_count: int
    taken_out: list[IntArray] = field(default_factory=list)
    vertices: FloatArray = field(default_factory=lambda: np.empty((0, 3)))
    faces: IntArray = field(default_factory=lambda: np.empty((0, 3), np.int64))
    corners: FloatArray = field(default_factory=lambda: np.empty((0, 3, 3)))


def mend_handles(
    surface: Surface, suited_steps: Callable[[FloatArray], FloatArray]
) -> tuple[Surface, Mended]:
    """Cut the small handles of a closed, manifold surface, and drop small hollows in it.

    At places (n, 3) `suited_steps` says how long sides of faces are that show what the points tell
    there: where those of the surface are longer, handles as wide as some of them are no work of
    noise. The surface has one part more where anything was cut; else it is the one that was given.
    """
    found = Mended()
    while True:
        edits, found.left, before = _Edits(surface.plan.vertex_count), 0, found.cut
        with surface.fetched() as load:
            blocks = Blocks(surface.plan, load)
            for bricks in group_bricks(surface.plan.bricks.keys):
                check_cancelled()
                _mend_group(*blocks.take_faces(bricks), suited_steps, edits, found)
            if edits.taken_out:
                surface = _apply(surface, blocks, edits)
        # What one group has left another one may have cut, and two have seen: they look once more.
        if not found.left or found.cut == before:
            found.place = found.place + surface.origin
            return surface, found


def group_bricks(keys: IntArray) -> list[IntArray]:
    """Return the rows of the bricks of each group, with those around it, sorted.

    The keys (b,) are sorted and unique. Groups come by their places, none without bricks of its
    own.
    """
    places = unpack_keys(keys)
    low = places.min(axis=0) // GROUP - 1
    own = pack_places(places // GROUP - low)
    names, mine = number_keys(own)
    rows = np.arange(len(keys))
    found = [mine * len(keys) + rows]
    for corner in MARGIN * (2 * np.array(list(np.ndindex(2, 2, 2))) - 1):
        # Bricks near another group, if that has bricks of its own.
        near = pack_places((places + corner) // GROUP - low)
        group = find_keys(names, near)
        others = (near != own) & (group < len(names))
        found.append(group[others] * len(keys) + rows[others])
    pairs = unique_keys(np.concatenate(found))
    ends = np.searchsorted(pairs, len(keys) * np.arange(len(names) + 1))
    return [pairs[first:last] % len(keys) for first, last in pairwise(ends.tolist())]


def _mend_group(
    rows: IntArray,
    faces: IntArray,
    corners: FloatArray,
    suited_steps: Callable[[FloatArray], FloatArray],
    edits: _Edits,
    found: Mended,
) -> None:
    """Cut the handles of some faces of the mesh, whose `rows` are given."""
    if not len(rows):
        return
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    stays = ~np.isin(rows, np.concatenate([*edits.taken_out, np.empty(0, np.int64)]))
    near = np.flatnonzero(((edits.corners >= low) & (edits.corners <= high)).all(axis=(1, 2)))
    # Faces of the mesh by their rows, those of patches below zero.
    rows = np.concatenate([rows[stays], ~near])
    corners = np.concatenate([corners[stays], edits.corners[near]])
    faces = np.concatenate([faces[stays], edits.faces[near]])
    has_handles, closed = find_suspects(number_keys(faces.reshape(-1))[1].reshape(-1, 3))
    if not (has_handles or closed):
        return
    told = float(np.median(suited_steps(corners[:, 0])))
    width = BOX * min(measure_side(corners), told)
    hollows = [piece for piece in closed if is_hollow(corners[piece], width)]
    in_hollow = np.zeros(len(faces), np.bool_)
    in_hollow[np.concatenate([*hollows, np.empty(0, np.int64)])] = True
    is_near = in_hollow.copy()
    if has_handles:
        for piece in find_small_handles(faces, corners, width):
            some = corners[piece]
            low, high = some.min(axis=(0, 1)) - width, some.max(axis=(0, 1)) + width
            is_near |= ((corners[:, 0] >= low) & (corners[:, 0] <= high)).all(axis=1)
    if not is_near.any():
        return
    from hpcapp.mending.handles import HandleCutter  # it stands on scipy, which takes its time

    # Only what lies around them goes on: v vertices, and their numbers in the mesh.
    names, local = number_keys(faces[is_near].reshape(-1))
    vertices = np.empty((len(names), 3))
    vertices[local] = corners[is_near].reshape(-1, 3)
    cutter = HandleCutter(vertices, local.reshape(-1, 3))
    cutter.is_left[in_hollow[is_near]] = False
    if has_handles:
        _cut_handles(cutter, width)
    for place in cutter.uncut.values():
        found.left, found.place = found.left + 1, place
    if cutter.cuts or cutter.uncut:
        found.width = max(found.width, width)
    found.cut, found.hollows = found.cut + cutter.cuts, found.hollows + len(hollows)
    if cutter.cuts or hollows:
        _note(edits, cutter, rows[is_near], names)


def _cut_handles(cutter: HandleCutter, width: float) -> None:
    """Cut small handles, as many as can be."""
    for _ in range(_ROUNDS):
        cutter.uncut.clear()
        live, before = np.flatnonzero(cutter.is_left), cutter.cuts
        faces = cutter.faces[live]
        for piece in find_small_handles(faces, cutter.vertices[faces], width):
            if cutter.is_left[live[piece]].all():
                cutter.cut(live[piece])
        if cutter.cuts == before:
            break


def _note(edits: _Edits, cutter: HandleCutter, rows: IntArray, names: IntArray) -> None:
    """Take over what was done to a group: `rows` are those of its faces, `names` its vertices."""
    gone = rows[~cutter.is_left[: len(rows)]]
    edits.taken_out.append(gone[gone >= 0])
    stays = np.ones(len(edits.faces), np.bool_)
    stays[~gone[gone < 0]] = False
    added = np.flatnonzero(cutter.is_left[len(rows) :]) + len(rows)
    first = edits.vertex_count + len(edits.vertices)
    fresh = first + np.arange(len(cutter.vertices) - len(names))
    number = np.concatenate([names, fresh])
    edits.vertices = np.concatenate([edits.vertices, cutter.vertices[len(names) :]])
    edits.faces = np.concatenate([edits.faces[stays], number[cutter.faces[added]]])
    edits.corners = np.concatenate([edits.corners[stays], cutter.vertices[cutter.faces[added]]])


def _apply(surface: Surface, blocks: Blocks, edits: _Edits) -> Surface:
    """Return the surface with the edits."""
    bricks = surface.plan.bricks
    gone = unique_keys(np.concatenate(edits.taken_out))
    brick, number = blocks.find_faces(gone)
    parts, summaries, workers = [*surface.parts], [*surface.summaries], [*surface.workers]
    for index in range(len(parts)):
        # All copies of a brick stay alike, whichever of them counts.
        mine = bricks.place[bricks.of_part(index)]
        at = np.minimum(np.searchsorted(mine, brick), len(mine) - 1)
        is_here = mine[at] == brick if len(mine) else np.zeros(len(brick), np.bool_)
        if is_here.any():
            part = blocks.load(index)
            rows = starts_of(part.face_counts)[at[is_here]] + number[is_here]
            edited = drop_faces(part, rows)
            summaries[index] = summarize_part(edited)
            parts[index] = _keep(surface, parts[index], "mended", edited, summaries[index])
    patches = _make_part(blocks, edits)
    summaries.append(summarize_part(patches))
    # A second pass has patches of its own.
    parts.append(_keep(surface, surface.parts[0], f"patches-{len(parts)}", patches, summaries[-1]))
    mended = replace(
        surface, parts=parts, summaries=summaries, workers=workers + workers[:1],
        _plan=None, _topology=None, _checked=set(),
    )  # fmt: skip
    return mended.only(mended.plan.pieces()[0])  # without vertices that no face uses any more


def _make_part(blocks: Blocks, edits: _Edits) -> MeshPart:
    """Return the patches as a part: one brick, behind all others."""
    fresh, places = number_keys(edits.faces.reshape(-1))
    before = int(np.searchsorted(fresh, edits.vertex_count))
    # (2, g): brick and number of vertices that are there; sorted, as their rows in the mesh are.
    bricks, numbers = blocks.find_vertices(fresh[:before])
    last = blocks.plan.bricks.keys[-1:] + 1
    counts = np.array([[len(fresh) - before, len(edits.faces)]], np.int32)
    return replace(
        MeshPart.empty(),
        bricks=last,
        guests=np.zeros(1, np.bool_),
        vertex_counts=counts[:, 0],
        face_counts=counts[:, 1],
        vertices=edits.vertices[fresh[before:] - edits.vertex_count],
        faces=np.where(places < before, ~places, places - before).reshape(-1, 3).astype(np.int32),
        foreign_bricks=blocks.plan.bricks.keys[bricks],
        foreign_numbers=numbers.astype(np.int32),
        supported=np.zeros(len(fresh) - before, np.bool_),
    )


def _keep(
    surface: Surface, name: MeshPart | str, suffix: str, part: MeshPart, summary: PartSummary
) -> MeshPart | str:
    """Put a part where the one of a name is; it stays here where that one is here."""
    if isinstance(name, MeshPart) or surface.checkpoint is None:
        return part
    surface.checkpoint.store.put(f"{name}-{suffix}", (part, summary, np.empty(0, np.int64)))
    return f"{name}-{suffix}"
