"""The plan of the weld: which part gives which brick, what is dropped, where everything goes.

Made from the parts' summaries alone; its size grows with the bricks and the seams, not with the
vertices. Vertices are known by their brick and their number in it, never by where they are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface.extraction.part_places import PartPlaces, starts_of
from hpcapp.applications.surface.extraction.summary import PartSummary
from hpcapp.applications.surface.stitching.bricks import (
    PartBricks,
    check_foreign,
    collect_bricks,
    join_labels,
)
from hpcapp.applications.surface.stitching.part_topology import Components, judge_parts, sum_areas
from hpcapp.applications.surface.stitching.topology import Topology
from hpcapp.geometry.lattice import find_first, unique_keys
from hpcapp.geometry.points import FloatArray, IntArray
from hpccomponent.dataclass import dataclass

SMALL_SIZES = ((0.02, 0.0), (0.002, 0.5), (0.0005, 0.75))
"""A component stays that has so many faces, by those of the largest one, and of whose vertices so
many are supported, by the share of the largest one's that are."""

_CLUMP = 24.0  # points, by the faces that a point has: a clump of strays has no more


@dataclass(frozen=True, slots=True, eq=False)
class StitchingPlan:
    """How parts become one mesh; B bricks in all.

    It is `kept` which of the parts' components stay, part after part; `component` is the one of the
    mesh that each belongs to. In the order of the keys, `vertex_starts` and `face_starts` (B + 1,)
    are where the vertices and faces of each brick begin in the mesh; `entries` are what each brick
    has of the components that stay, and `dropped` counts those with faces that do not. The `box`
    (2, 3) has the lowest and highest coordinates of the vertices, in the local frame; zeros without
    any.
    """

    summaries: tuple[PartSummary, ...]
    bricks: PartBricks
    kept: NDArray[np.bool_]
    vertex_starts: IntArray
    face_starts: IntArray
    box: FloatArray
    component: IntArray
    entries: Components
    dropped: int

    def givers(self, bricks: IntArray) -> Iterator[tuple[int, IntArray]]:
        """Yield each part that gives some of the bricks, and their rows in it, sorted.

        The bricks (k,) are rows in the order of the keys.
        """
        taken = self.bricks.taken[bricks]
        owners = self.bricks.part_of(taken)
        for index in unique_keys(owners).tolist():
            yield index, taken[owners == index] - self.bricks.parts[index]

    def locate_foreign(
        self, index: int, foreign: IntArray | NDArray[np.int32]
    ) -> tuple[IntArray, IntArray]:
        """Return which parts foreign vertices (m,) of a part are from, and the rows in these."""
        summary = self.summaries[index]
        wanted, numbers = summary.foreign_bricks[foreign], summary.foreign_numbers[foreign]
        copies = self.bricks.taken[np.searchsorted(self.bricks.keys, wanted)]
        # The vertices of all copies in one row; less those of parts before, rows of their part.
        starts = starts_of(self.bricks.vertex_counts)
        owners = self.bricks.part_of(copies)
        return owners, starts[copies] - starts[self.bricks.parts[owners]] + numbers

    @property
    def vertex_count(self) -> int:
        """Vertices of the mesh."""
        return int(self.vertex_starts[-1])

    @property
    def face_count(self) -> int:
        """Faces of the mesh."""
        return int(self.face_starts[-1])

    def pieces(self) -> tuple[IntArray, FloatArray]:
        """Return the components with faces, in the order of their first ones, and their areas.

        Both are (p,), the areas in squared length units of the input.
        """
        found, first = find_first(self.entries.component)
        components = found[np.argsort(first)]
        areas = sum_areas(self.summaries, self.bricks, self.component, self.entries)
        faces = self.entries.count(self.entries.faces, len(areas))
        components = components[faces[components] > 0]
        return components, areas[components]

    def only(self, components: IntArray) -> StitchingPlan:
        """Return the plan of some of the components of `pieces` alone."""
        return _keep_some(self.summaries, self.bricks, self.component, self.entries, components)

    def judge(self) -> Topology:
        """Return what `check_mesh` would find on the mesh."""
        return judge_parts(self.summaries, self.bricks, self.component, self.kept, self.entries)

    def places(self, index: int) -> PartPlaces:
        """Return where the vertices and faces of a part go."""
        bricks, summary = self.bricks, self.summaries[index]
        mine = bricks.of_part(index)
        place = bricks.place[mine]
        # (g,): whether foreign vertices stay, and where, tells the copy of their brick that counts.
        there = np.searchsorted(bricks.keys, summary.foreign_bricks)
        copies, foreign = bricks.taken[there], summary.foreign_numbers
        is_kept = self.kept[bricks.labels_at(copies, foreign)]
        numbers = self.vertex_starts[there] + bricks.ranks_at(self.kept, copies, foreign)
        return PartPlaces(
            self.vertex_starts[place],
            np.where(bricks.is_taken[mine], self.face_starts[place], -1),
            self._dropped(index),
            np.where(is_kept, numbers, -1),
        )

    def _dropped(self, index: int) -> NDArray[np.int32]:
        starts = self.bricks.label_starts
        if self.kept[starts[index] : starts[index + 1]].all():
            return np.empty(0, np.int32)
        return np.flatnonzero(~self.kept[self.bricks.labels_in(index)]).astype(np.int32)


def plan_stitching(
    summaries: Sequence[PartSummary], crumb: int | None = None, points: int | None = None
) -> StitchingPlan:
    """Plan the weld of all the parts of a mesh, of one or more.

    Of guests that no part owns the first part's copy is taken. Components with fewer faces than
    `crumb` are dropped; by default those with few beside the largest, and, where the cloud's
    `points` are given, what a clump of strays would have made. JobError where the parts contradict
    one another, or one refers to a brick that none has.
    """
    bricks = collect_bricks(summaries)
    check_foreign(summaries, bricks)
    component = join_labels(summaries, bricks)
    entries = _collect_entries(summaries, bricks, component)
    total = int(component.max(initial=-1)) + 1
    faces = entries.count(entries.faces, total)
    if crumb is None:
        # As many faces as a clump of strays has, with as many a point as the whole mesh.
        fewest = 0.0 if points is None else _CLUMP * int(faces.sum()) / points
        large = find_large(faces, entries.count(entries.supports, total), fewest)
    else:
        large = faces >= max(crumb, 1)
    return _keep_some(tuple(summaries), bricks, component, entries, np.flatnonzero(large))


def _keep_some(
    summaries: tuple[PartSummary, ...],
    bricks: PartBricks,
    component: IntArray,
    entries: Components,
    chosen: IntArray,
) -> StitchingPlan:
    """Return the plan of some components, and of how many with faces are dropped."""
    total = int(component.max(initial=-1)) + 1
    stays = np.zeros(total, np.bool_)
    stays[chosen] = True
    kept = stays[component]
    components = entries.only(stays[entries.component])
    # (B + 1,) each: only what stays takes places in the mesh.
    vertex_starts, face_starts = (
        starts_of(np.bincount(components.place, counts, len(bricks.keys)).astype(np.int32))
        for counts in (components.vertices, components.faces)
    )
    box = _bound(np.concatenate([s.bounds for s in summaries])[kept])
    return StitchingPlan(
        summaries,
        bricks,
        kept,
        vertex_starts,
        face_starts,
        box,
        component,
        components,
        int(((entries.count(entries.faces, total) > 0) & ~stays).sum()),
    )


def _collect_entries(
    summaries: Sequence[PartSummary], bricks: PartBricks, component: IntArray
) -> Components:
    """Put the entries of the bricks that are taken into the order of the mesh."""
    starts = [s.entry_starts for s in summaries]
    # (e,): the brick of each entry, as a row of those of all parts, and below its label.
    brick = np.repeat(np.arange(len(bricks.place)), np.concatenate([np.diff(s) for s in starts]))
    counts = np.array([len(s.entry_labels) for s in summaries])
    labels = np.concatenate([s.entry_labels for s in summaries])
    labels = labels + np.repeat(bricks.label_starts[:-1], counts)
    # By the keys of the bricks, each brick once.
    order = np.argsort(bricks.place[brick], kind="stable")
    order = order[bricks.is_taken[brick[order]]]
    return Components(
        bricks.place[brick[order]],
        component[labels[order]],
        np.concatenate([s.entry_vertices for s in summaries])[order],
        np.concatenate([s.entry_faces for s in summaries])[order],
        np.concatenate([s.entry_sums for s in summaries])[order],
        np.concatenate([s.entry_supports for s in summaries])[order],
    )


def _bound(bounds: FloatArray) -> FloatArray:
    """Return the box around some boxes."""
    if not len(bounds) or np.isinf(bounds[:, 0].min()):
        return np.zeros((2, 3))
    return np.stack([bounds[:, :3].min(axis=0), bounds[:, 3:].max(axis=0)])


def find_large(faces: IntArray, supports: IntArray, fewest: float = 0.0) -> NDArray[np.bool_]:
    """Tell which components (c,) of a mesh are no mere crumbs of it.

    A vertex that no face uses is one without faces; `supports` counts vertices that points support
    (see `MeshPart`); beside the largest one a component needs `fewest` faces. All stay where none
    with faces is small: what no face uses, too.

    Notes
    -----
    What grew around a few outliers has many faces and few points; the tip of a horn whose neck was
    too thin has few faces, and points everywhere. So the smaller a component is, the more of it
    must be supported, by what is supported of the largest one.
    """
    # (c,): supported vertices by faces, which may be compared whatever the size.
    shares = supports / np.maximum(faces, 1.0)
    largest = int(np.argmax(faces)) if len(faces) else 0
    sizes = faces / max(int(faces.max(initial=0)), 1)
    is_large = np.zeros(len(faces), np.bool_)
    for size, support in SMALL_SIZES:
        is_large |= (sizes >= size) & (shares >= support * shares[largest : largest + 1])
    # The largest one stays, however few faces it has.
    is_large &= (faces >= fewest) | (sizes >= 1.0)
    return is_large | bool(is_large[faces > 0].all())
