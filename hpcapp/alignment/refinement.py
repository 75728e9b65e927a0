"""The best pose near a given one: iteratively reweighted least squares, point to plane."""

from __future__ import annotations

import numpy as np

from hpcapp.alignment.judge import Judge
from hpcapp.alignment.pose import step_pose
from hpcapp.geometry.points import FloatArray
from hpccomponent.dataclass import dataclass

_MOST_CELLS = 6000
_ROUNDS = ((3.0, 1.0), (3.0, 1.0), (2.5, 0.7), (2.5, 0.7), (2.0, 0.5), (2.0, 0.5)) + 6 * (
    (2.0, 0.3),
)
"""Reach and sharpness of each round, in edges of a cell: far and blunt, then near and sharp."""
_DAMPING = 1e-4  # of the mean of the normal matrix's diagonal: what nothing holds does not move

_SHARPEST = 1e-3  # edges of a cell: a residual below it is one of made-up points


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """A pose that no small move betters; `stiffness`, (6, 6), is what holds it about `middle`."""

    pose: FloatArray
    stiffness: FloatArray
    middle: FloatArray
    residual: float


def refine(judge: Judge, pose: FloatArray) -> Refined:
    """Climb from a pose, within a few edges of a cell.

    What is minimized is what `Judge` weighs: heights above the planes of those cells whose normals
    agree. Cells that meet none, as of what one scan alone has seen, have no part in it.
    """
    edge, count = judge.fixed.edge, len(judge.moved.positions)
    rows = np.random.default_rng(0).permutation(count)[:_MOST_CELLS]
    stiffness, middle, residual = np.zeros((6, 6)), np.zeros(3), np.inf
    for reach, sharpness in _ROUNDS:
        match = judge.match(pose, rows, reach * edge, sharpness * edge)
        heights, weights, middle = match.heights, match.weights, match.places.mean(axis=0)
        # (m, 6): how each height grows with turns about the middle, and with shifts.
        turns = np.cross(match.places - middle, match.normals)
        lever = np.concatenate([turns, match.normals], axis=1)
        stiffness = np.einsum("n,ni,nj->ij", weights, lever, lever)
        if not stiffness.any():
            break
        residual = float(np.sqrt(np.average(heights**2, weights=weights)))
        # Turns are of the scan's size: the damping of both kinds is of their own.
        damping = _DAMPING * np.repeat(
            [np.trace(stiffness[:3, :3]) / 3, np.trace(stiffness[3:, 3:]) / 3], 3
        )
        step = np.linalg.solve(
            stiffness + np.diag(damping + 1e-300), -lever.T @ (weights * heights)
        )
        pose = step_pose(pose, step, middle)
    return Refined(pose, stiffness / max(residual, _SHARPEST * edge) ** 2, middle, residual)
