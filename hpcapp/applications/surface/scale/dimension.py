"""What points lie on: a surface, or only a curve, or nothing less than a volume.

::

    points ── look_around ──> Neighbourhoods ──┬─ fill_volume   round, and grow as a volume does
                                               ├─ follow_curve  spread along one direction
                                               └─ lie_flat      spread along two

A point's k nearest neighbours are looked at for several k, from a few to a quarter of the points.
Noise makes a surface round at small k, folds and near sheets make it round at large k: only points
of a volume have round neighbourhoods at all of them.
"""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import BoolArray, FloatArray
from hpccomponent.dataclass import dataclass

FEWEST = 15
"""Neighbours that tell their spread."""

_QUERIES = 128  # points that are looked around: the share of a kind is known to 4 %
_PARTS = (128, 32, 8, 4)  # of all points: the neighbours that are looked at
_ROUND = 0.22  # variance across the thinnest direction, of that along the longest
_NARROW = 0.1  # likewise across a curve, of that along it
_GROWTH = 2.3  # power of the distance: 2 on a surface, 3 in a volume, less at its border


@dataclass(frozen=True, slots=True, eq=False)
class Neighbourhoods:
    """The nearest neighbours of q points, for k rising counts of them.

    `radii` (q, k) are how far away the last of them lies, in length units of the input; `variances`
    (q, k, 3) those along their principal directions, rising.
    """

    counts: tuple[int, ...]
    radii: FloatArray
    variances: FloatArray

    def fill_volume(self) -> BoolArray:
        """Tell around which points the neighbours fill a volume at all counts, shape (q,)."""
        thin, _, long = np.moveaxis(self.variances, 2, 0)
        is_round: BoolArray = (thin >= _ROUND * long).all(axis=1)
        return is_round & (self.growth() >= _GROWTH)

    def follow_curve(self) -> BoolArray:
        """Tell around which points they spread along one direction, shape (q,).

        At the three largest counts: at the smallest noise may make a line round.
        """
        _, middle, long = np.moveaxis(self.variances[:, -3:], 2, 0)
        is_narrow: BoolArray = (middle <= _NARROW * long).all(axis=1)
        return is_narrow

    def lie_flat(self) -> BoolArray:
        """Tell around which points they spread along two directions at some count, shape (q,)."""
        thin, middle, long = np.moveaxis(self.variances, 2, 0)
        is_flat: BoolArray = ((thin < _ROUND * middle) & (middle > _NARROW * long)).any(axis=1)
        return is_flat

    def growth(self) -> FloatArray:
        """Return by which power of the distance the neighbours become more, shape (q,)."""
        farther = np.log(self.radii[:, -1] / self.radii[:, 0])
        with np.errstate(divide="ignore"):  # all of them equally far
            powers: FloatArray = np.log(self.counts[-1] / self.counts[0]) / farther
        return powers


def choose_counts(points: int) -> tuple[int, ...]:
    """Return for how many neighbours to look around a point of so many; none where too few."""
    return tuple(points // part for part in _PARTS if points // part >= FEWEST)


def look_around(positions: FloatArray, counts: tuple[int, ...]) -> Neighbourhoods:
    """Look around some of the points (n, 3), evenly picked in their order.

    There must be more than the largest of the rising counts, no two at one place. Distances are
    found between 128 points and all: 4 kB a point.
    """
    step = -(-len(positions) // _QUERIES)
    # (q, 3, n): all points as seen from each of q.
    offsets = positions.T[None] - positions[::step][:, :, None]
    squares = np.einsum("qcn,qcn->qn", offsets, offsets)
    # (q, most + 1): its nearest, itself included; the first k + 1 are the nearest k.
    ends = np.array(counts)
    nearest = np.argpartition(squares, ends, axis=1)[:, : ends[-1] + 1]
    squares = np.take_along_axis(squares, nearest, axis=1)
    offsets = np.take_along_axis(offsets, nearest[:, None], axis=2)
    radii, variances = [], []
    for count in counts:
        near = offsets[:, :, : count + 1]
        near = near - near.mean(axis=2, keepdims=True)
        spread = np.einsum("qcn,qdn->qcd", near, near) / (count + 1)
        radii.append(np.sqrt(squares[:, count]))
        variances.append(np.linalg.eigvalsh(spread).clip(0.0))
    return Neighbourhoods(counts, np.stack(radii, axis=1), np.stack(variances, axis=1))
