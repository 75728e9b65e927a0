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
from scipy.sparse import coo_matrix, csc_matrix, eye
from scipy.sparse.csgraph import laplacian
from scipy.sparse.linalg import splu
from scipy.stats import t as student

from hpcapp.geometry.points import BoolArray, FloatArray
from hpcapp.terrain.errors import CONFIDENCE
from hpcapp.terrain.heights import Heights
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
    is_membrane: bool, areas: FloatArray, ground: Heights, is_near: BoolArray,
    is_known: BoolArray, lattice: Lattice,
) -> Base:  # fmt: skip
    """Continue the heights of a rim below a heap, as a membrane or as a plane.

    Parameters
    ----------
    areas : ndarray of float64, shape (rows, columns)
        What of each cell the heap stands on.
    ground : Heights
        Those outside of the heap.
    is_near : ndarray of bool, shape (rows, columns)
        The cells of the heap and of its rim.
    is_known : ndarray of bool, shape (rows, columns)
        Those of the rim that have a height.
    """
    # (rows, columns): where cells are from the middle of the rim, in its extents
    places = lattice.middles - lattice.middles[is_known].mean(axis=0)
    x, y = np.moveaxis(places / np.ptp(places[is_known], axis=0).max(), -1, 0)
    square = x**2 + y**2
    # so that heights far from zero keep their digits
    middle = float(ground.values[is_known].mean())
    rim = ground.values[is_known] - middle  # (k,)
    terms = np.stack([np.ones_like(x), x, y, x**2 - y**2, 2.0 * x * y], axis=-1)
    saddles = np.linalg.lstsq(terms[is_known], rim, rcond=None)[0][3:]
    membrane = _Membrane(is_near, is_known)
    # weights (k,): what of the volume below each height of the rim makes
    base, weights, between = membrane.solve(rim), membrane.weigh(areas), 0.0
    if not is_membrane:
        plane = terms[..., :3]
        inverse = np.linalg.pinv(plane[is_known])  # (3, k)
        stretched, base = base, np.where(is_near, plane @ (inverse @ rim), 0.0)
        weights = (areas[..., None] * plane).sum(axis=(0, 1)) @ inverse
        between = abs(float((areas * (base - stretched)).sum()))
    bowl = abs(float(weights @ square[is_known] - (areas * square).sum()))
    variance = float((weights**2 * ground.variances[is_known]).sum())
    return Base(base + middle, variance, _UNSURE * hypot(*saddles.tolist()) * bowl + between)


def interpolate(values: FloatArray, is_known: BoolArray, is_in: BoolArray) -> FloatArray:
    """Return values (rows, columns) that are continued as a membrane to all cells inside.

    Parts without a known cell have their mean.
    """
    mean = float(values[is_known].mean())
    if not (is_in & ~is_known).any():
        return np.where(is_known, values, mean)
    return mean + _Membrane(is_in, is_known).solve(values[is_known] - mean)


class _Membrane:
    """Laplace's equation on some cells: the known ones hold it up, elsewhere its rim is free."""

    def __init__(self, is_near: BoolArray, is_known: BoolArray) -> None:
        self._near, count = is_near, np.count_nonzero(is_near)
        number = np.full(is_near.shape, -1, dtype=np.int64)
        number[is_near] = np.arange(count)
        sides = (number[:, :-1], number[:, 1:]), (number[:-1], number[1:])
        # (p, 2): the cells, by number, that touch along x, then along y
        pairs = np.concatenate([np.stack([a.ravel(), b.ravel()], axis=1) for a, b in sides])
        row, column = pairs[(pairs >= 0).all(axis=1)].T
        links = coo_matrix((np.ones(len(row)), (row, column)), shape=(count, count))
        held = is_known[is_near]
        self._free, self._held = np.flatnonzero(~held), np.flatnonzero(held)
        rows = laplacian(links + links.T).tocsr()[self._free]
        self._links, inner = -rows[:, self._held], rows[:, self._free]
        # a part that nothing holds up lies at zero
        ridge = _RIDGE * eye(len(self._free))
        self._factors = splu(csc_matrix(inner + ridge)) if len(self._free) else None

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
