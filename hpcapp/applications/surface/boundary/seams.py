"""What the parts of a surface that is cut open must know of one another.

::

    plan of the closed parts ──> where foreign vertices are
    seams of all parts       ──> bare patches joined, small ones stay; numbers of foreign vertices
                                 and of cuts through edges that two parts share
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.boundary.opening import OpeningSeams
from hpcapp.applications.surface.extraction.part_places import starts_of
from hpcapp.applications.surface.stitching.plan import StitchingPlan
from hpcapp.geometry.lattice import find_keys
from hpcapp.geometry.points import BoolArray, FloatArray, Int32Array, IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import JobError


@dataclass(frozen=True, slots=True, eq=False)
class MatchedSeams:
    """What is decided for each part (see `cut_opening`); `holes` of the whole surface stay."""

    stays: list[BoolArray]
    foreign_numbers: list[IntArray]
    seam_cuts: list[IntArray]
    holes: int


class _Rims:
    """The vertices that parts may name of one another, in one row."""

    def __init__(self, plan: StitchingPlan) -> None:
        self._bricks = plan.bricks
        rims = [summary.rim for summary in plan.summaries]
        self.starts = starts_of(np.array([len(rim) for rim in rims], np.int64))
        owners = np.repeat(np.arange(len(rims)), np.diff(self.starts))
        # (r,): part and row as one number; they rise, as each rim does.
        self._keys = owners << 32 | np.concatenate(rims)
        self._vertex_starts = starts_of(plan.bricks.vertex_counts)

    def find(self, bricks: IntArray, numbers: Int32Array) -> IntArray:
        """Return where vertices, by brick and number, stand in the row."""
        found = self.look_up(bricks, numbers)
        if (found == len(self._keys)).any():
            raise _refuse_unknown()
        return found

    def look_up(self, bricks: IntArray, numbers: Int32Array) -> IntArray:
        """Return the same; where a vertex is not there, the length of the row."""
        there = find_keys(self._bricks.keys, bricks)
        is_known = there < len(self._bricks.keys)
        copies = self._bricks.taken[there[is_known]]
        owners = self._bricks.part_of(copies)
        starts = self._vertex_starts
        # (k,): the row in the part whose copy of the brick counts: only that one's rim has it.
        rows = starts[copies] - starts[self._bricks.parts[owners]] + numbers[is_known]
        found = np.full(len(bricks), len(self._keys), np.int64)
        found[is_known] = find_keys(self._keys, owners << 32 | rows)
        return found


def _refuse_unknown() -> JobError:
    return JobError(
        "no tile has the vertices on its rim that another refers to",
        "this is an error of hpcapp: please report it",
    )


def place_foreign(plan: StitchingPlan) -> list[FloatArray]:
    """Return where the foreign vertices of each part are, (g, 3).

    NaN where only guest bricks that another part gives use the vertex: inside of that part it may
    be no part of the rim.
    """
    rims = _Rims(plan)
    places = np.concatenate([summary.rim_places for summary in plan.summaries])
    places = np.append(places, np.full((1, 3), np.nan), axis=0)
    return [
        places[rims.look_up(summary.foreign_bricks, summary.foreign_numbers)]
        for summary in plan.summaries
    ]


def match_seams(
    plan: StitchingPlan, seams: Sequence[OpeningSeams], fill: Callable[[FloatArray], FloatArray]
) -> MatchedSeams:
    """Join the bare patches of all closed parts, and match what they cut along their seams.

    `fill`, given places, returns how large patches there may be that stay, in length units of the
    input: the diagonal of the box around one.
    """
    rims = _Rims(plan)
    label_starts = starts_of(np.array([len(some.extents) for some in seams], np.int64))
    # (r,): shifted, the labels of a part are those of all; -1 of supported ones is never looked up.
    shifts = np.repeat(label_starts[:-1], np.diff(rims.starts))
    rim_labels = np.concatenate([some.rim_labels for some in seams]) + shifts
    rim_numbers = np.concatenate([some.rim_numbers for some in seams]).astype(np.int64)
    left, right, foreign_numbers = [], [], []
    for start, some in zip(label_starts, seams, strict=False):
        rows = rims.find(some.foreign_bricks, some.foreign_numbers)
        foreign_numbers.append(rim_numbers[rows])
        bare = some.foreign_labels >= 0
        # The patch that a vertex is in here and the one that it is in where it is from are one.
        left.append(start + some.foreign_labels[bare])
        right.append(rim_labels[rows[bare]])
    stays, holes = _choose_small(seams, np.concatenate(left), np.concatenate(right), fill)
    return MatchedSeams(
        np.split(stays, label_starts[1:-1]),
        foreign_numbers,
        _match_cuts([some.edges for some in seams]),
        holes,
    )


def _choose_small(
    seams: Sequence[OpeningSeams],
    left: IntArray,
    right: IntArray,
    fill: Callable[[FloatArray], FloatArray],
) -> tuple[BoolArray, int]:
    """Tell which labels are of small patches with a boundary, and how many these patches are.

    A patch may bulge out of a small hole, and around all that was scanned.
    """
    extents = np.concatenate([some.extents for some in seams])
    bounded = np.concatenate([some.is_bounded for some in seams])
    if not len(extents):
        return np.zeros(0, np.bool_), 0
    joined = np.stack([left, right, right], axis=1)  # edges as faces with a corner twice
    count, patch = kernels.label_components(joined.astype(np.int64), len(extents))
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, patch, extents[:, :3])
    np.maximum.at(high, patch, extents[:, 3:])
    is_small = np.zeros(count, np.bool_)
    is_small[patch[bounded]] = True
    # (s, 3): sizes and middles of the boxes around the patches.
    size, middle = high[is_small] - low[is_small], 0.5 * (high[is_small] + low[is_small])
    is_small[is_small] = (size * size).sum(axis=1) <= fill(middle) ** 2
    return is_small[patch], int(is_small.sum())


def _match_cuts(edges: list[IntArray]) -> list[IntArray]:
    """Name each cut by the lowest brick with a face at its edge."""
    every = np.concatenate(edges)
    # (m, 6) of all parts: edge by edge, by the names of both ends, and then by the faces' bricks.
    order = np.lexsort(every[:, 4::-1].T)
    ends = every[order, :4]
    first = np.ones(len(order), np.bool_)
    first[1:] = (ends[1:] != ends[:-1]).any(axis=1)
    named = np.empty((len(order), 2), np.int64)
    # (m, 2): all copies of an edge get brick and number from the first row of it.
    named[order] = every[order[first], 4:][np.cumsum(first) - 1]
    return np.split(named, np.cumsum([len(some) for some in edges])[:-1])
