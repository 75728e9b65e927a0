"""The paper's partition: a kd-tree whose leaves are the patches that get one quadric each.

All boxes of a level are judged and split together, so the cost is one pass of numpy over the
points for each level of the tree.
"""

from __future__ import annotations

import heapq

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.points import FloatArray, IntArray
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError, UsageError

#: Boxes of this part of the root's side are not split: without an end the halving would go on
#: through a thousand levels to the smallest float.
SMALLEST_BOX = 2.0**-70


@dataclass(frozen=True, slots=True)
class SplitRule:
    """When a box of the tree is split; a UsageError is raised where a value is outside its range.

    It is where it holds more than `max_points`, or some normal has ``n . n_mean <= limit``,
    `n_mean` being normalised. By the `cone` "paper" the limit is `delta`, from -1 to 1, as the
    paper prints it; by "complement" 1 - delta, as its text and its Figures 2 and 4 ask; by "none"
    normals do not matter.
    """

    delta: float = 0.1
    cone: str = "paper"
    max_points: int | None = None

    def __post_init__(self) -> None:
        if not -1.0 <= self.delta <= 1.0:
            raise UsageError(f"delta is {self.delta}", "give a number from -1 to 1, such as 0.1")
        if self.cone not in ("paper", "complement", "none"):
            raise UsageError(f"cone is {self.cone!r}", "choose paper, complement or none")
        if self.max_points is not None and self.max_points < 1:
            raise UsageError(f"max_points is {self.max_points}", "give 1 or more, or leave it out")

    @property
    def limit(self) -> float:
        """The smallest cosine to the mean normal that a patch may not have."""
        return {"paper": self.delta, "complement": 1.0 - self.delta, "none": -2.0}[self.cone]


@dataclass(frozen=True, slots=True, eq=False)
class TreePatches:
    """The leaves of the tree that hold points, in depth-first order (low side first); p of them.

    The points of patch i are ``order[offsets[i]:offsets[i + 1]]``, ascending; its box, from
    `box_low` to `box_high` (p, 3), is in the frame of the positions.
    """

    order: IntArray
    offsets: IntArray
    box_low: FloatArray
    box_high: FloatArray

    def __len__(self) -> int:
        return len(self.box_low)

    @property
    def centers(self) -> FloatArray:
        """Box centres, shape (p, 3): the origins of the patch coordinates."""
        return self.box_low + 0.5 * (self.box_high - self.box_low)

    @property
    def scales(self) -> FloatArray:
        """Half the longest side of each box, shape (p,): the units of the patch coordinates.

        1 where a box has no extent.
        """
        half = 0.5 * (self.box_high - self.box_low).max(axis=1, initial=0.0)
        return np.where(half > 0.0, half, 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class _Boxes:
    """Boxes of one level: runs of the point order, and where they lie.

    `size` is kept beside low and high because halving it is exact: the sides of a cube stay
    equal to the last bit, and ties between its axes stay ties.
    """

    starts: IntArray
    counts: IntArray
    low: FloatArray
    high: FloatArray
    size: FloatArray

    def __len__(self) -> int:
        return len(self.starts)

    def take(self, selection: NDArray[np.bool_] | IntArray) -> _Boxes:
        return _Boxes(
            self.starts[selection],
            self.counts[selection],
            self.low[selection],
            self.high[selection],
            self.size[selection],
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Members:
    """The points of some boxes side by side."""

    points: IntArray  # point indices, box after box
    owner: IntArray  # which box each belongs to
    first: IntArray  # where each box begins in `points`

    @classmethod
    def of(cls, boxes: _Boxes, order: IntArray) -> _Members:
        # (m,): the box of each point, where the b boxes hold m points
        owner = np.repeat(np.arange(len(boxes)), boxes.counts)
        # (b,): where each box begins among them; then order[...], (m,): the points, box after box
        first = np.cumsum(boxes.counts) - boxes.counts
        return cls(order[np.arange(len(owner)) + (boxes.starts - first)[owner]], owner, first)


def partition_by_rule(
    positions: FloatArray, normals: FloatArray, rule: SplitRule, root: str = "cube"
) -> TreePatches:
    """Split boxes at the midpoint of their longest axis for as long as the rule asks.

    Positions and unit normals are (n, 3). InputError where there is no point, or arrays do not fit
    each other or hold NaN; UsageError where the root is unknown.

    Parameters
    ----------
    root : {"cube", "box", "tight"}
        "cube": the root is the cube about the centre of the bounding box whose side is the longest
        of the box; no other place for it gives the paper's 240 patches. "box": the bounding box.
        "tight": the same, and every box is shrunk onto its points before it is split.

    Notes
    -----
    Equal lengths: the axis of lowest index; a point on the midplane goes to the low side. Points
    that coincide (or lie nearer than 2^-70 of the root's side) are not separated, whatever their
    normals: such a box becomes a patch.

    References
    ----------
    Hussein, Mousa, A High Performance of 3D Object Reconstruction in a Cloud Environment, 2015,
    doi:10.15680/ijircce.2015.0306090; Section V names the bunny's 240 patches.
    """
    _check(positions, normals)
    order = np.arange(len(positions))
    boxes = _root_box(positions, root)
    smallest = SMALLEST_BOX * float(boxes.size.max())
    leaves = []
    while len(boxes):
        members = _Members.of(boxes, order)
        split = _asks_for_split(boxes, members, normals, rule)
        split &= _can_be_split(boxes, members, positions, smallest)
        leaves.append(boxes.take(~split))
        boxes = _split(boxes.take(split), order, positions, root)
    return _assemble(order, leaves)


def partition_by_count(positions: FloatArray, patches: int, root: str = "cube") -> TreePatches:
    """Split the box with the most points (n, 3) until exactly `patches` of them hold points.

    Of equally full boxes the older is split first. InputError where no point is there or one is not
    finite; UsageError where fewer than one patch, more than distinct points, or an unknown root is
    asked for.
    """
    _check(positions, positions)
    if patches < 1:
        raise UsageError(f"{patches} patches asked for", "ask for 1 or more")
    order = np.arange(len(positions))
    made = [_root_box(positions, root)]
    smallest = SMALLEST_BOX * float(made[0].size.max())
    queue = [(-len(positions), 0)]
    final: list[_Boxes] = []
    while queue and len(queue) + len(final) < patches:
        box = made[heapq.heappop(queue)[1]]
        if not _can_be_split(box, _Members.of(box, order), positions, smallest)[0]:
            final.append(box)
            continue
        children = _split(box, order, positions, root)
        for i in range(len(children)):
            heapq.heappush(queue, (-int(children.counts[i]), len(made)))
            made.append(children.take(np.array([i])))
    if len(queue) + len(final) < patches:
        raise UsageError(
            f"{patches} patches asked for, but only {len(final)} of the points are distinct",
            f"ask for {len(final)} or fewer",
        )
    return _assemble(order, final + [made[i] for _, i in queue])


def _check(positions: FloatArray, normals: FloatArray) -> None:
    if positions.ndim != 2 or positions.shape[1:] != (3,) or normals.shape != positions.shape:
        raise InputError(
            f"positions have shape {positions.shape}, normals {normals.shape}",
            "give both as arrays of shape (n, 3)",
        )
    if not len(positions):
        raise InputError("the cloud holds no point", "give at least one")
    if not (np.isfinite(positions).all() and np.isfinite(normals).all()):
        raise InputError("the cloud holds NaN or infinite values", "drop these points first")


def _root_box(positions: FloatArray, root: str) -> _Boxes:
    if root not in ("cube", "box", "tight"):
        raise UsageError(f"root is {root!r}", "choose cube, box or tight")
    low, high = bound_points(positions)
    size = high - low
    if root == "cube":
        size = np.full(3, size.max())
        corner = 0.5 * (low + high) - 0.5 * size
        # Rounding may leave a point an ulp outside the cube; the box must hold it all the same.
        low, high = np.minimum(corner, low), np.maximum(corner + size, high)
    count = np.array([len(positions)])
    return _Boxes(np.zeros(1, np.int64), count, low[None], high[None], size[None])


def _asks_for_split(
    boxes: _Boxes, members: _Members, normals: FloatArray, rule: SplitRule
) -> NDArray[np.bool_]:
    too_many = np.zeros(len(boxes), bool)
    if rule.max_points is not None:
        too_many = boxes.counts > rule.max_points
    if rule.cone == "none":
        return too_many
    # (m, 3): the normals of all points; (b, 3): their mean in each box, of unit length or zero
    local = normals[members.points]
    mean = np.add.reduceat(local, members.first, axis=0)
    length = np.linalg.norm(mean, axis=1, keepdims=True)
    mean = np.divide(mean, length, out=np.zeros_like(mean), where=length > 0.0)
    # (m,): each normal against its box's mean; (b,): the smallest of a box
    cosines = (local * mean[members.owner]).sum(axis=1)
    narrowest: NDArray[np.bool_] = np.minimum.reduceat(cosines, members.first) <= rule.limit
    return narrowest | too_many


def _can_be_split(
    boxes: _Boxes, members: _Members, positions: FloatArray, smallest: float
) -> NDArray[np.bool_]:
    local = positions[members.points]
    # (m,): whether a point lies elsewhere than the first of its box; (b,): whether any does
    differs = (local != local[members.first][members.owner]).any(axis=1)
    separable: NDArray[np.bool_] = np.logical_or.reduceat(differs, members.first)
    separable &= boxes.size.max(axis=1) > smallest
    return separable


def _split(boxes: _Boxes, order: IntArray, positions: FloatArray, root: str) -> _Boxes:
    """Halve every box, sort its points in `order` in place, and return the halves with points."""
    if not len(boxes):
        return boxes
    members = _Members.of(boxes, order)
    if root == "tight":
        boxes = _shrink(boxes, members, positions)
    # (b,): the longest axis of each box, the first of equals, and half its length
    row, axis = np.arange(len(boxes)), boxes.size.argmax(axis=1)
    half = 0.5 * boxes.size[row, axis]
    # Below the top by at least one step: two neighbouring floats must come apart as well.
    top = np.nextafter(boxes.high[row, axis], -np.inf)
    middle = np.minimum(boxes.low[row, axis] + half, top)
    # (m,): whether a point lies beyond the midplane of its box
    right = positions[members.points, axis[members.owner]] > middle[members.owner]
    # (b,): points that stay below it; `order` now has each box's low half before its high one
    left_counts = boxes.counts - _part(boxes, members, right, order)

    # (2 b,), (2 b, 3): the halves, box 2 i below the midplane of box i and box 2 i + 1 above
    starts = np.stack([boxes.starts, boxes.starts + left_counts], axis=1).ravel()
    counts = np.stack([left_counts, boxes.counts - left_counts], axis=1).ravel()
    low, high, size = (np.repeat(x, 2, axis=0) for x in (boxes.low, boxes.high, boxes.size))
    high[2 * row, axis] = middle
    low[2 * row + 1, axis] = middle
    size[2 * row, axis] = size[2 * row + 1, axis] = half
    return _Boxes(starts, counts, low, high, size).take(counts > 0)


def _part(boxes: _Boxes, members: _Members, right: NDArray[np.bool_], order: IntArray) -> IntArray:
    """Move each box's `right` points behind its others, stably; return how many they are."""
    # (b,): how many go right; (m,): how many of them precede a point within its own box
    n_right = np.add.reduceat(right.astype(np.int64), members.first)
    ahead: IntArray = np.cumsum(right) - right
    ahead -= ahead[members.first][members.owner]
    # (m,): a point's place in its box now, and the place that it goes to if it goes right
    rank = np.arange(len(right)) - members.first[members.owner]
    behind = (boxes.counts - n_right)[members.owner] + ahead
    order[boxes.starts[members.owner] + np.where(right, behind, rank - ahead)] = members.points
    return n_right


def _shrink(boxes: _Boxes, members: _Members, positions: FloatArray) -> _Boxes:
    local = positions[members.points]
    low = np.minimum.reduceat(local, members.first, axis=0)
    high = np.maximum.reduceat(local, members.first, axis=0)
    return _Boxes(boxes.starts, boxes.counts, low, high, high - low)


def _assemble(order: IntArray, leaves: list[_Boxes]) -> TreePatches:
    starts = np.concatenate([boxes.starts for boxes in leaves])
    # (p,): runs of `order` do not overlap, so that their starts are the depth-first order
    by_start = np.argsort(starts)
    low = np.concatenate([boxes.low for boxes in leaves])[by_start]
    high = np.concatenate([boxes.high for boxes in leaves])[by_start]
    return TreePatches(order, np.append(starts[by_start], len(order)), low, high)
