"""The pose between two scans, and how sure it is."""

from __future__ import annotations

import numpy as np

from hpcapp.alignment.judge import Judge, Verdict
from hpcapp.alignment.pose import difference, shift_pose, step_pose
from hpcapp.alignment.refinement import Refined, refine
from hpcapp.alignment.sample import FEWEST, Sample
from hpcapp.alignment.search import propose
from hpcapp.geometry.points import FloatArray
from hpccomponent.dataclass import dataclass

_COARSE, _MIDDLE, _FINE = 32, 60, 120  # cells along the smaller scan's diagonal
_LEAST_EDGE = 2.0  # spacings: finer cells have one point each
_FINEST = 1.2
_CANDIDATES, _RIVALS = 10, 4
_SAME = 1.5  # edges of a cell: nearer poses are one
WORTH, MARGIN = 0.30, 0.30
"""A pose is sure whose worth is at least the first, and of whose worth the best other pose lacks at
least the second share. Of 60 pairs the wrong ones of symmetric things lack up to .27 (a screw)."""
SLIDES = 0.85
"""Share of its worth that a pose may keep while the scan slides: pipes, plains and round things
keep .95 and more, what is sure otherwise and right up to .82 (a terrain)."""
THROUGH = 0.03
"""Share of two scans that may lie where the other scanner has looked through: sure poses that are
right have up to .028, two different facades .034."""
_SLIDE = 3.0  # edges of a cell


@dataclass(frozen=True, slots=True, eq=False)
class PairPose:
    """How a scan, the moved one, lies in the frame of another.

    Parameters
    ----------
    pose : ndarray of float64, shape (4, 4)
        From the moved scan's coordinates into the fixed one's.
    verdict : Verdict
    next_worth : float
        Worth of the best other pose; infinite where the best lies farther off than it may.
    slid_worth : float
        Worth where the scan slides or turns the way that the overlap holds least.
    residual : float
        Root mean square distance from the other's surface, where both overlap.
    stiffness : ndarray of float64, shape (6, 6)
        How strongly the overlap holds turns about `middle` and shifts, in units of the residual.
    middle : ndarray of float64, shape (3,)
        Of the overlap, in the fixed scan's coordinates.
    """

    pose: FloatArray
    verdict: Verdict
    next_worth: float
    slid_worth: float
    residual: float
    stiffness: FloatArray
    middle: FloatArray

    @property
    def is_sure(self) -> bool:
        """Whether nothing else explains the scans as well."""
        worth = self.verdict.worth
        return (
            worth >= WORTH
            and worth - self.next_worth >= MARGIN * worth
            and self.slid_worth < SLIDES * worth
            and self.verdict.through <= THROUGH
        )


def align_pair(
    fixed: Sample,
    moved: Sample,
    near: float | None = None,
    given: FloatArray | None = None,
) -> PairPose:
    """Find how a scan lies in the frame of another.

    Parameters
    ----------
    near : float, optional
        The scans lie right up to this length; poses farther away are no rivals.
    given : ndarray of float64, shape (4, 4), optional
        The pose, known up to some spacings: nothing is searched.
    """
    extent, spacing = min(fixed.extent, moved.extent), max(fixed.spacing, moved.spacing)
    coarse, middle, fine = (
        max(extent / cells, _LEAST_EDGE * spacing) for cells in (_COARSE, _MIDDLE, _FINE)
    )
    if min(len(one.at(coarse).positions) for one in (fixed, moved)) < FEWEST:
        nothing = Verdict(0.0, 0.0, 0.0)
        return PairPose(np.eye(4), nothing, 0.0, 0.0, 0.0, np.zeros((6, 6)), np.zeros(3))
    apart = shift_pose(-fixed.centre), shift_pose(moved.centre)
    start = apart[0] @ (np.eye(4) if given is None else given) @ apart[1]
    poses = [start] if near is not None or given is not None else []
    if given is None:
        poses += propose(fixed, moved, coarse)
    ranked = _rank(Judge(fixed, moved, coarse), moved, poses, _CANDIDATES)

    def is_near(pose: FloatArray) -> bool:
        return near is None or difference(pose, start, moved.positions) <= near

    ranked = [one for one in ranked if is_near(one[1].pose)] or ranked[:1]
    judge = Judge(fixed, moved, middle)
    ranked = _rank(judge, moved, [one.pose for _, one in ranked], _RIVALS)
    refined = ranked[0][1]
    for edge in (fine, _FINEST * spacing):
        refined = refine(Judge(fixed, moved, edge), refined.pose)
    next_worth = max((verdict.worth for verdict, _ in ranked[1:]), default=0.0)
    return PairPose(
        shift_pose(fixed.centre) @ refined.pose @ shift_pose(-moved.centre),
        judge.judge(refined.pose),
        next_worth if is_near(refined.pose) else np.inf,
        _slide(judge, ranked[0][1], extent),
        refined.residual,
        refined.stiffness,
        refined.middle + fixed.centre,
    )


def _rank(
    judge: Judge, moved: Sample, poses: list[FloatArray], most: int
) -> list[tuple[Verdict, Refined]]:
    """Return the best refined poses that differ, the best first."""
    refined = [refine(judge, pose) for pose in poses]
    judged = [(judge.judge(one.pose), one) for one in refined]
    judged.sort(key=lambda pair: -pair[0].worth)
    kept = list[tuple[Verdict, Refined]]()
    places = moved.positions[:: max(1, len(moved.positions) // 500)]
    tolerance = _SAME * judge.fixed.edge
    for verdict, one in judged:
        if all(difference(one.pose, other.pose, places) > tolerance for _, other in kept):
            kept.append((verdict, one))
        if len(kept) == most:
            break
    return kept


def _slide(judge: Judge, refined: Refined, extent: float) -> float:
    """Return the worth after a small move, either way, that the overlap holds least."""
    lengths = np.repeat([extent / 3, 1.0], 3)  # what a turn moves, by its radians
    _, ways = np.linalg.eigh(refined.stiffness / np.outer(lengths, lengths))
    step = ways[:, 0] / lengths * _SLIDE * judge.fixed.edge
    return max(
        judge.judge(step_pose(refined.pose, sign * step, refined.middle)).worth for sign in (1, -1)
    )
