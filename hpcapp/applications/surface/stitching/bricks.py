"""The bricks of all parts in one row, which copy of each counts, and the components in them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hpcapp import kernels
from hpcapp.applications.surface.extraction.part_places import starts_of
from hpcapp.applications.surface.extraction.summary import PartSummary
from hpcapp.geometry.lattice import find_keys, unique_keys, unpack_keys
from hpcapp.geometry.points import IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import JobError

Integers = IntArray | NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class PartBricks:
    """The bricks of all parts, part after part; n in all, B different ones.

    Components of all parts are numbered through as well ("labels"): those of a part follow those of
    the part before. `is_taken`, `guests` and the counts are of each brick, (n,).

    Parameters
    ----------
    keys : ndarray of int64, shape (B,)
        Sorted, unique.
    taken : ndarray of int64, shape (B,)
        The row of the copy that counts.
    parts, label_starts : ndarray of int64, shape (parts + 1,)
        Where the bricks and the labels of each part begin.
    place : ndarray of int64, shape (n,)
        Where each brick stands in `keys`.
    labels : ndarray of int64, shape (n,)
        Of all the vertices of a brick; -1 where they have several, or there are none.
    mixed : ndarray of int64
        The labels of the vertices of bricks with several.
    mixed_starts : ndarray of int64, shape (n,)
        Where those of each brick begin.
    """

    keys: IntArray
    taken: IntArray
    parts: IntArray
    place: IntArray
    is_taken: NDArray[np.bool_]
    guests: NDArray[np.bool_]
    vertex_counts: NDArray[np.int32]
    face_counts: NDArray[np.int32]
    label_starts: IntArray
    labels: IntArray
    mixed: IntArray
    mixed_starts: IntArray

    def of_part(self, index: int) -> slice:
        """Return the rows of the bricks of a part."""
        return slice(int(self.parts[index]), int(self.parts[index + 1]))

    def part_of(self, bricks: IntArray) -> IntArray:
        """Return the indices of the parts that bricks, rows (k,), are of."""
        return np.searchsorted(self.parts, bricks, side="right") - 1

    def labels_in(self, index: int) -> IntArray:
        """Return the label of every vertex of a part, in their order."""
        mine = self.of_part(index)
        labels = np.repeat(self.labels[mine], self.vertex_counts[mine])
        several = labels < 0
        # The mixed bricks of a part stand side by side in `mixed`, in the order of its vertices.
        first = int(self.mixed_starts[mine.start]) if mine.start < mine.stop else 0
        labels[several] = self.mixed[first : first + int(several.sum())]
        return labels

    def labels_at(self, bricks: IntArray, numbers: Integers) -> IntArray:
        """Return the labels of vertices that are known by brick (a row) and number in it, (k,)."""
        labels = self.labels[bricks]
        several = labels < 0
        labels[several] = self.mixed[(self.mixed_starts[bricks] + numbers)[several]]
        return labels

    def ranks_at(self, kept: NDArray[np.bool_], bricks: IntArray, numbers: Integers) -> IntArray:
        """Return how many vertices of each vertex's brick come before it and have kept labels.

        They are named by brick (a row) and number, (k,); a rank of one that is dropped means
        nothing.
        """
        ranks = numbers.astype(np.int64)
        several = self.labels[bricks] < 0
        # (m + 1,): how many vertices of mixed bricks stay before each. In other bricks all stay or
        # none does: there, numbers are ranks already.
        before = starts_of(kept[self.mixed])
        first = self.mixed_starts[bricks[several]]
        ranks[several] = before[first + numbers[several]] - before[first]
        return ranks


def collect_bricks(summaries: Sequence[PartSummary]) -> PartBricks:
    """Find out which part gives each brick; JobError where the parts contradict one another."""
    keys = np.concatenate([s.bricks for s in summaries])
    guests = np.concatenate([s.guests for s in summaries])
    vertex_counts = np.concatenate([s.vertex_counts for s in summaries])
    face_counts = np.concatenate([s.face_counts for s in summaries])
    order = np.lexsort((guests, keys))  # stable: copies of a brick come in the order of the parts
    # Of the copies of a brick the one of its owner comes first, else the guest of the first part.
    first = np.ones(len(keys), np.bool_)
    np.not_equal(keys[order][1:], keys[order][:-1], out=first[1:])
    taken = order[first]
    place = np.empty(len(keys), np.int64)
    # (n,): from each copy to the row of its key.
    place[order] = np.cumsum(first) - 1
    is_taken = np.zeros(len(keys), np.bool_)
    is_taken[taken] = True
    # (n,): the copy that counts. The others must be like it, and none but guests.
    twin = taken[place]
    unlike = (vertex_counts != vertex_counts[twin]) | (face_counts != face_counts[twin])
    unlike |= ~guests & ~is_taken
    if unlike.any():
        raise JobError(
            f"two tiles disagree about brick {_name(keys[np.argmax(unlike)])}",
            "this is an error of hpcapp: please report it",
        )
    labels, mixed, mixed_starts, label_starts = _collect_labels(summaries, vertex_counts)
    parts = starts_of(np.array([len(s.bricks) for s in summaries], np.int32))
    return PartBricks(
        keys[taken],
        taken,
        parts,
        place,
        is_taken,
        guests,
        vertex_counts,
        face_counts,
        label_starts,
        labels,
        mixed,
        mixed_starts,
    )


def missing_bricks(summaries: Sequence[PartSummary]) -> IntArray:
    """Return the bricks of foreign vertices that no part has, by sorted, unique keys (m,)."""
    wanted = unique_keys(np.concatenate([s.foreign_bricks for s in summaries]))
    held = unique_keys(np.concatenate([s.bricks for s in summaries]))
    missing: IntArray = wanted[find_keys(held, wanted) == len(held)]
    return missing


def check_foreign(summaries: Sequence[PartSummary], bricks: PartBricks) -> None:
    """Refuse foreign vertices that no part has: the JobError names the brick of one of them."""
    missing = missing_bricks(summaries)
    if not len(missing):
        for summary in summaries:
            # (g,): the copies that count, all of which are there; so must their vertices be.
            there = bricks.taken[np.searchsorted(bricks.keys, summary.foreign_bricks)]
            beyond = summary.foreign_numbers >= bricks.vertex_counts[there]
            if beyond.any():
                missing = summary.foreign_bricks[beyond]
                break
    if len(missing):
        raise JobError(
            f"no tile has the vertices of brick {_name(missing[0])} that another refers to",
            "this is an error of hpcapp: please report it",
        )


def join_labels(summaries: Sequence[PartSummary], bricks: PartBricks) -> IntArray:
    """Return for each label the component of the whole mesh, from 0 on, that it is a piece of.

    Two labels are pieces of one component where they name the same vertex: a foreign one, or one of
    a brick that several parts have.
    """
    # A copy that does not count has the vertices of the one that does: their labels are joined.
    copies = np.flatnonzero(~bricks.is_taken & (bricks.vertex_counts > 0))
    copies, numbers = _representatives(bricks, copies)
    left = [bricks.labels_at(copies, numbers)]
    right = [bricks.labels_at(bricks.taken[bricks.place[copies]], numbers)]
    for start, summary in zip(bricks.label_starts, summaries, strict=False):
        # (g,): so are the label of a foreign vertex here, and the one that it has where it is from.
        there = bricks.taken[np.searchsorted(bricks.keys, summary.foreign_bricks)]
        left.append(start + summary.foreign_labels)
        right.append(bricks.labels_at(there, summary.foreign_numbers))
    count = int(bricks.label_starts[-1])
    # Both labels as one number, each pair once: a seam has many vertices, and few labels.
    pairs = unique_keys(np.concatenate(left) * count + np.concatenate(right))
    one, other = pairs // max(count, 1), pairs % max(count, 1)
    edges = np.stack([one, other, other], axis=1)  # edges as faces with a corner twice
    component = kernels.label_components(edges, count)[1]
    return component.astype(np.int64, copy=False)


def _representatives(bricks: PartBricks, copies: IntArray) -> tuple[IntArray, IntArray]:
    """Return one vertex of each copy, and all of them where it or the taken one is mixed."""
    # (k,): where all vertices have one label in both copies, one vertex tells it.
    several = (bricks.labels[copies] < 0) | (bricks.labels[bricks.taken[bricks.place[copies]]] < 0)
    counts = np.where(several, bricks.vertex_counts[copies], 1)
    # (m,): where each copy's vertices begin in the row of all, to number them from 0 in each.
    first = np.repeat(np.cumsum(counts) - counts, counts)
    return np.repeat(copies, counts), np.arange(len(first)) - first


def _collect_labels(
    summaries: Sequence[PartSummary], vertex_counts: NDArray[np.int32]
) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    label_starts = starts_of(np.array([len(s.bounds) for s in summaries], np.int32))
    labels, kinds = [], []
    for start, summary in zip(label_starts, summaries, strict=False):
        with_vertices = summary.entry_vertices > 0
        # (e,): the brick of each entry, which is a component that the brick has something of.
        brick = np.repeat(np.arange(len(summary.bricks)), np.diff(summary.entry_starts))
        # (b,): the label of its vertices; of several, any, as those are looked up in `mixed`.
        of_brick = np.full(len(summary.bricks), -1, np.int64)
        of_brick[brick[with_vertices]] = start + summary.entry_labels[with_vertices]
        labels.append(of_brick)
        kinds.append(np.bincount(brick[with_vertices], minlength=len(summary.bricks)))
    # (n,): bricks whose vertices are of several components.
    several = np.concatenate(kinds) > 1
    mixed = [start + s.mixed_labels for start, s in zip(label_starts, summaries, strict=False)]
    return (
        np.where(several, -1, np.concatenate(labels)),
        np.concatenate(mixed),
        starts_of(np.where(several, vertex_counts, 0))[:-1],
        label_starts,
    )


def _name(key: np.int64) -> str:
    x, y, z = unpack_keys(np.array([key]))[0]
    return f"({x}, {y}, {z})"
