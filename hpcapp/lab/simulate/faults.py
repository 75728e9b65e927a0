"""What is wrong with a scan: depths that drift, views registered wrongly, outliers."""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.lab.simulate.implicit import Solid, diagonal_of
from hpcapp.lab.simulate.rays import run_in_blocks
from hpccomponent.dataclass import dataclass

_WAVES = 64


def draw_drift(
    positions: FloatArray, view: IntArray, length: float, rng: np.random.Generator
) -> FloatArray:
    """Return errors (n,) that are smooth along the surface, of standard deviation 1.

    Positions (n, 3) ascend by their view (n,): the errors of one view say nothing of another's. A
    sum of 64 plane waves with normally distributed wave vectors is nearly a Gaussian process with
    the covariance exp(-r^2 / (2 length^2)) (Rahimi and Recht 2007).
    """
    drift = np.empty(len(positions))
    for number in range(int(view.max(initial=0)) + 1):
        waves = rng.standard_normal((3, _WAVES)) / length
        phases = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
        first, last = np.searchsorted(view, [number, number + 1])
        drift[first:last] = _add_waves(positions[first:last], waves, phases)
    return drift


@dataclass(frozen=True, slots=True, eq=False)
class Moves:
    """Small motions of the views: shifts (v, 3), in length units, and turns (v, 3).

    These are axes as long as twice the tangent of half the angle.
    """

    shifts: FloatArray
    turns: FloatArray

    def apply(
        self, positions: FloatArray, normals: FloatArray, view: IntArray, middle: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Move points (n, 3) and their normals with the view of each; views turn about a middle."""
        turn = self.turns[view]
        moved = middle + _rotate(positions - middle, turn) + self.shifts[view]
        return moved, _rotate(normals, turn)


def draw_moves(views: int, error: float, diagonal: float, rng: np.random.Generator) -> Moves:
    """Return a small shift and a small rotation for each view.

    The error is the standard deviation of the shift along each axis; the rotation moves what is
    half a diagonal away as far.
    """
    shifts = error * rng.standard_normal((views, 3))
    return Moves(shifts, 2.0 * error / diagonal * rng.standard_normal((views, 3)))


def strew_outliers(
    shape: Solid,
    share: float,
    positions: FloatArray,
    rays: FloatArray,
    rng: np.random.Generator,
) -> tuple[FloatArray, BoolArray]:
    """Replace a share of points (n, 3) by outliers; tell which these are.

    Half of them lie 2 to 10 % of the diagonal away along their rays (n, 3), half anywhere in twice
    the bounding box.
    """
    low, high = shape.bounds
    chosen = rng.permutation(len(positions))[: round(share * len(positions))]
    near, far = np.array_split(chosen, 2)
    offset = (
        diagonal_of(shape) * rng.uniform(0.02, 0.10, len(near)) * rng.choice([-1, 1], len(near))
    )
    strewn = positions.copy()
    strewn[near] += offset[:, None] * rays[near]
    strewn[far] = 0.5 * (low + high) + (high - low) * rng.uniform(-1.0, 1.0, (len(far), 3))
    is_outlier = np.zeros(len(positions), dtype=bool)
    is_outlier[chosen] = True
    return strewn, is_outlier


def _add_waves(positions: FloatArray, waves: FloatArray, phases: FloatArray) -> FloatArray:
    """Return the sum of plane waves at each position, scaled to a standard deviation of 1."""
    parts = run_in_blocks(
        lambda part: np.cos(positions[part] @ waves + phases).sum(axis=1), len(positions)
    )
    total: FloatArray = np.sqrt(2.0 / len(phases)) * np.concatenate(parts)
    return total


def _rotate(vectors: FloatArray, turn: FloatArray) -> FloatArray:
    """Rotate each vector about its `turn`: a Cayley rotation, for which no angle is too large."""
    half = 0.5 * turn
    first = np.cross(half, vectors)
    scale = 2.0 / (1.0 + np.einsum("ij,ij->i", half, half))
    rotated: FloatArray = vectors + scale[:, None] * (first + np.cross(half, first))
    return rotated
