"""Poses of many scans: pairs until all hang together, then all overlaps at once.

A pair is searched only where nothing connects its scans so far; scans near to each other in the
order of the files first. Overlaps of scans that are placed already are refined where they lie, and
what is left of the errors is spread over the loops: least squares over all pairs, each as stiff as
its overlap holds it (a pose graph).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from hpcapp.alignment.pair import PairPose, align_pair
from hpcapp.alignment.pose import difference, invert, move, step_pose
from hpcapp.alignment.sample import Sample
from hpcapp.geometry.points import FloatArray
from hpccomponent.dataclass import dataclass

_LEAST_OVERLAP, _LEAST_WORTH = 0.1, 0.1  # of overlaps that hold scans that are placed already
_STRAY = 0.03  # of a scan's extent: such an overlap that leads farther away holds another pose
_DAMPING = 1e-9  # of the stiffness, so that it has a root where the overlap leaves a slide


@dataclass(frozen=True, slots=True, eq=False)
class Link:
    """What was found between two scans, by their numbers."""

    fixed: int
    moved: int
    pair: PairPose


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """Poses of scans in the frame of the first.

    Parameters
    ----------
    poses : sequence of ndarray of float64, shape (4, 4)
        From each scan's coordinates; None for scans that nothing sure connects with the first.
    links : tuple of Link
        Those that hold the poses.
    unsure : tuple of Link
        Those that were looked at, and left out.
    """

    poses: tuple[FloatArray | None, ...]
    links: tuple[Link, ...]
    unsure: tuple[Link, ...]


def align_scans(
    samples: Sequence[Sample],
    near: float | None = None,
    tell: Callable[[int, int], object] = lambda *_: None,
) -> Alignment:
    """Find the poses of scans in the frame of the first.

    Parameters
    ----------
    near : float, optional
        The scans lie right up to this length.
    tell : callable
        Hears of every pair that is searched.
    """
    group = list(range(len(samples)))
    links, unsure = list[Link](), list[Link]()
    for first, second in sorted(combinations(group, 2), key=lambda pair: pair[1] - pair[0]):
        if group[first] == group[second]:
            continue
        tell(first, second)
        link = Link(first, second, align_pair(samples[first], samples[second], near))
        (links if link.pair.is_sure else unsure).append(link)
        if link.pair.is_sure:
            group = [group[first] if one == group[second] else one for one in group]
    poses = _place(len(samples), links)
    known = {(link.fixed, link.moved) for link in links}
    for first, second in combinations(range(len(samples)), 2):
        start, end = poses[first], poses[second]
        if (first, second) in known or start is None or end is None:
            continue
        between, moved = invert(start) @ end, samples[second]
        pair = align_pair(samples[first], moved, given=between)
        verdict = pair.verdict
        strays = difference(pair.pose, between, moved.positions + moved.centre)
        if (
            verdict.overlap >= _LEAST_OVERLAP
            and verdict.worth >= _LEAST_WORTH
            and strays <= _STRAY * moved.extent
        ):
            links.append(Link(first, second, pair))
    unsure = [link for link in unsure if poses[link.fixed] is None or poses[link.moved] is None]
    return Alignment(tuple(spread_errors(poses, links)), tuple(links), tuple(unsure))


def _place(count: int, links: Sequence[Link]) -> list[FloatArray | None]:
    """Return the poses that follow from the first scan over links; None beyond them."""
    poses: list[FloatArray | None] = [np.eye(4), *(None for _ in range(1, count))]
    for _ in links:
        for link in links:
            start, end = poses[link.fixed], poses[link.moved]
            if start is not None and end is None:
                poses[link.moved] = start @ link.pair.pose
            elif end is not None and start is None:
                poses[link.fixed] = end @ invert(link.pair.pose)
    return poses


def spread_errors(
    poses: Sequence[FloatArray | None], links: Sequence[Link]
) -> list[FloatArray | None]:
    """Return poses that fit all links best; the first stays."""
    placed = {number: pose for number, pose in enumerate(poses) if pose is not None}
    held = [link for link in links if link.fixed in placed]
    free = list(placed)[1:]
    if len(held) <= len(free):
        return list(poses)
    roots = [_root(link.pair.stiffness) for link in held]

    def change(steps: FloatArray) -> dict[int, FloatArray]:
        moved = {
            number: step_pose(placed[number], step, placed[number][:3, 3])
            for number, step in zip(free, steps.reshape(-1, 6), strict=True)
        }
        return placed | moved

    def residuals(steps: FloatArray) -> FloatArray:
        changed, parts = change(steps), list[FloatArray]()
        for link, root in zip(held, roots, strict=True):
            pair = link.pair
            # What is left of the pair's pose, (4, 4), near 1: a turn about its middle and a shift.
            off = invert(changed[link.fixed]) @ changed[link.moved] @ invert(pair.pose)
            turn = Rotation.from_matrix(off[:3, :3]).as_rotvec()
            parts.append(root @ np.append(turn, move(off, pair.middle[None])[0] - pair.middle))
        return np.concatenate(parts)

    # Lengths and angles differ in size by far: each is scaled by its column.
    solved = least_squares(residuals, np.zeros(6 * len(free)), x_scale="jac", loss="soft_l1")
    changed = change(solved.x)
    return [changed.get(number) for number in range(len(poses))]


def _root(stiffness: FloatArray) -> FloatArray:
    """Return R with R^T R = the stiffness."""
    values, vectors = np.linalg.eigh(stiffness)
    return np.asarray(np.sqrt(np.maximum(values, _DAMPING * values[-1]))[:, None] * vectors.T)
