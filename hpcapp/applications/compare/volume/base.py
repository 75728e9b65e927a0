"""The base of a heap: what the ground round it is continued to below.

A membrane over the rim (Laplace's equation) is a plane over ground that is one, and any saddle over
a saddle; what it cannot know is a bowl. Of ground that looks alike in all directions a bowl is as
likely as a saddle: on a disc, the mean height less that of the rim has the variance of the second
harmonic along the rim, whatever the spectrum of the ground, because 2 J1(x) / x - J0(x) = J2(x). So
a saddle is fitted to the rim, and its size tells that of the bowl, by Student's distribution of two
degrees of freedom.
"""

from __future__ import annotations

from math import hypot

import numpy as np
from scipy.sparse import coo_matrix, csc_matrix, diags
from scipy.sparse.linalg import splu
from scipy.stats import t as student

from hpcapp.geometry.points import BoolArray, FloatArray
from hpcapp.terrain.errors import CONFIDENCE
from hpcapp.terrain.lattice import Lattice
from hpccomponent.dataclass import dataclass

_SADDLES = 2  # the two that a rim shows: along the axes, and between them
_RIDGE = 1e-12  # of a link
_UNSURE = float(student.isf(0.5 - 0.5 * CONFIDENCE, _SADDLES))


@dataclass(frozen=True, slots=True, eq=False)
class Base:
    """The heights of a base, (rows, columns), and how sure its volume is.

    Parameters
    ----------
    variance : float
        Of the volume below the heap, by the noise of the rim.
    uncertainty : float
        Of that volume, by what the ground may do below the heap.
    """

    heights: FloatArray
    variance: float
    uncertainty: float


def fit_base(
    is_membrane: bool, areas: FloatArray, heights: FloatArray, variances: FloatArray,
    is_near: BoolArray, is_known: BoolArray, lattice: Lattice,
) -> Base:  # fmt: skip
    """Continue the heights of a rim below a heap, as a membrane or as a plane.

    Parameters
    ----------
    areas : ndarray of float64, shape (rows, columns)
        What of each cell the heap stands on.
    heights, variances : ndarray of float64, shape (rows, columns)
        Of the ground.
    is_near : ndarray of bool, shape (rows, columns)
        The cells of the heap and of its rim.
    is_known : ndarray of bool, shape (rows, columns)
        Those of the rim that have a height.
    """
    places = lattice.middles
    places = (places - places[is_known].mean(axis=0)) / np.ptp(places[is_known], axis=0).max()
    x, y = places[..., 0], places[..., 1]
    square = x**2 + y**2
    rim = heights[is_known]
    middle = float(rim.mean())  # so that heights far from zero keep their digits
    terms = np.stack([np.ones_like(x), x, y, x**2 - y**2, 2.0 * x * y], axis=-1)
    saddles = np.linalg.lstsq(terms[is_known], rim - middle, rcond=None)[0][3:]
    membrane = _Membrane(is_near, is_known)
    stretched = membrane.solve(rim - middle)
    weights = membrane.weigh(areas)
    if is_membrane:
        base, between = stretched, 0.0
    else:
        plane, told = terms[..., :3], terms[is_known][:, :3]
        inverse = np.linalg.pinv(told)
        base = np.where(is_near, plane @ (inverse @ (rim - middle)), 0.0)
        weights = (areas[..., None] * plane).sum(axis=(0, 1)) @ inverse
        between = abs(float((areas * (base - stretched)).sum()))
    bowl = abs(float(weights @ square[is_known] - (areas * square).sum()))
    variance = float((weights**2 * variances[is_known]).sum())
    return Base(base + middle, variance, _UNSURE * hypot(*saddles.tolist()) * bowl + between)


def interpolate(values: FloatArray, is_known: BoolArray, is_in: BoolArray) -> FloatArray:
    """Return values (rows, columns) that are continued as a membrane to all cells inside.

    Parts without a known cell have their mean.
    """
    filled = np.where(is_known, values, values[is_known].mean())
    if (is_in & ~is_known).any():
        found = _Membrane(is_in, is_known).solve(filled[is_known])
        filled = np.where(is_in, found, filled)
    return filled


class _Membrane:
    """Laplace's equation on some cells: the known ones hold it up, elsewhere its rim is free."""

    def __init__(self, is_near: BoolArray, is_known: BoolArray) -> None:
        self._near, self._known = is_near, is_known
        number = np.full(is_near.shape, -1, dtype=np.int64)
        number[is_near] = np.arange(np.count_nonzero(is_near))
        pairs = np.concatenate([
            np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], axis=1),
            np.stack([number[:-1].ravel(), number[1:].ravel()], axis=1),
        ])  # fmt: skip
        pairs = pairs[(pairs >= 0).all(axis=1)]
        row, column = np.concatenate([pairs, pairs[:, ::-1]]).T
        links = coo_matrix(
            (np.ones(len(row)), (row, column)), shape=(number.max() + 1,) * 2
        ).tocsr()
        held = is_known[is_near]
        self._free, self._held = np.flatnonzero(~held), np.flatnonzero(held)
        self._links = links[self._free][:, self._held]
        degree = np.asarray(links.sum(axis=1)).ravel()[self._free]
        inner = links[self._free][:, self._free]
        # a part that nothing holds up lies at zero
        self._factors = splu(csc_matrix(diags(degree + _RIDGE) - inner)) if len(degree) else None

    def solve(self, heights: FloatArray) -> FloatArray:
        """Return the heights of all cells, given those of the known ones; zero elsewhere."""
        values = np.zeros(np.count_nonzero(self._near))
        values[self._held] = heights
        if self._factors is not None:
            values[self._free] = self._factors.solve(self._links @ heights)
        every = np.zeros(self._near.shape)
        every[self._near] = values
        return every

    def weigh(self, areas: FloatArray) -> FloatArray:
        """Return what of the volume below each known cell's height makes: of areas of all cells."""
        near = areas[self._near]
        weights: FloatArray = near[self._held]
        if self._factors is not None:
            weights = weights + self._links.T @ self._factors.solve(near[self._free])
        return weights
