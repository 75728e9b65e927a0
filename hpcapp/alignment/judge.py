"""What speaks for a pose, and what against it, in one unit: shares of the smaller scan.

For it: cells that lie on the other scan's surface, with its normal, and face its way. Against it:
cells where the other scanner has looked through.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from hpcapp.alignment.pose import invert, move
from hpcapp.alignment.sample import Cells, Sample
from hpcapp.alignment.viewpoint import View
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpccomponent.dataclass import dataclass

REACH = 2.0  # edges of a cell: farther away cells are not compared
SHARPNESS = 0.25  # edges of a cell: how far off its plane a cell may lie, one sigma
_AGREE, _AGREE_WIDTH = 0.7, 0.25  # cosine from which normals agree, up to .95
_THROUGH = 2.0  # edges before what was seen: there the scanner has looked through
AGAINST = 6.0
"""How much more a share that was looked through counts than one that fits: right poses have .00 to
.03 of it, half of the best wrong ones of rooms, streets and works .02 to .2, and fit as well."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """How well a pose explains two scans.

    Parameters
    ----------
    worth : float
        What speaks for it less what speaks against it; 1 where a scan lies in another entirely.
    overlap : float
        Share of the moved scan's cells that have one of the other nearby.
    through : float
        Share of the cells that the other scanner has looked through, of both scans.
    """

    worth: float
    overlap: float
    through: float


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """What the m cells of a moved scan meet.

    Parameters
    ----------
    places : ndarray of float64, shape (m, 3)
        Where they are.
    normals, heights : ndarray of float64, shape (m, 3) and (m,)
        Of the surface that they meet, and how high above it they are.
    weights : ndarray of float64, shape (m,)
        How well they fit there, times the weight of each; 0 where they meet none.
    meets : ndarray of bool, shape (m,)
        Whether there is one within reach.
    """

    places: FloatArray
    normals: FloatArray
    heights: FloatArray
    weights: FloatArray
    meets: BoolArray


class Judge:
    """Judges poses that bring a scan, `moved`, into the frame of another, `fixed`."""

    def __init__(self, fixed: Sample, moved: Sample, edge: float) -> None:
        self.fixed, self.moved = fixed.at(edge), moved.at(edge)
        self._eyes = fixed.eye, moved.eye
        self._sides = None
        if fixed.eye is not None and moved.eye is not None:
            self._sides = _sides(self.fixed, fixed.eye), _sides(self.moved, moved.eye)

    @cached_property
    def _views(self) -> list[View | None]:
        return [
            None if eye is None else View.of(cells, eye)
            for cells, eye in zip((self.fixed, self.moved), self._eyes, strict=True)
        ]

    def match(
        self, pose: FloatArray, rows: IntArray | slice, reach: float, sharpness: float
    ) -> Match:
        """Find what rows of the moved scan's cells meet; `reach` and `sharpness` are lengths."""
        fixed, moved = self.fixed, self.moved
        places = move(pose, moved.positions[rows])
        turned = moved.normals[rows] @ pose[:3, :3].T
        distances, met = fixed.tree.query(places, distance_upper_bound=reach)
        meets = np.isfinite(distances)
        met = np.where(meets, met, 0)
        normals = fixed.normals[met]
        heights = np.einsum("ni,ni->n", places - fixed.positions[met], normals)
        # Normals have no side of their own; what both scanners have seen faces both.
        cosines = np.einsum("ni,ni->n", turned, normals)
        if self._sides is None:
            cosines = np.abs(cosines)
        else:
            cosines *= self._sides[0][met] * self._sides[1][rows]
        agree = np.clip((cosines - _AGREE) / _AGREE_WIDTH, 0.0, 1.0)
        weights = np.exp(-0.5 * (heights / sharpness) ** 2) * agree * moved.weights[rows]
        return Match(places, normals, heights, np.where(meets, weights, 0.0), meets)

    def judge(self, pose: FloatArray) -> Verdict:
        """Weigh a pose."""
        edge = self.fixed.edge
        match = self.match(pose, slice(None), REACH * edge, SHARPNESS * edge)
        through = self._share_through(0, self.moved, pose)
        through += self._share_through(1, self.fixed, invert(pose))
        smaller = min(self.fixed.weights.sum(), self.moved.weights.sum())
        worth = match.weights.sum() / smaller - AGAINST * through
        return Verdict(float(worth), float(match.meets.mean()), through)

    def _share_through(self, number: int, cells: Cells, pose: FloatArray) -> float:
        """Return the share of cells that one of the views has looked through."""
        view = self._views[number]
        if view is None:
            return 0.0
        covered, beyond, _ = view.compare(move(pose, cells.positions))
        return float(cells.weights[covered & (beyond > _THROUGH)].sum() / cells.weights.sum())


def _sides(cells: Cells, eye: FloatArray) -> FloatArray:
    """Return on which side of each normal the eye is: 1 or -1."""
    return np.asarray(np.sign(np.einsum("ni,ni->n", eye - cells.positions, cells.normals)))
