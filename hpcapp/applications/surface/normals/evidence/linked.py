"""What is known of some patches, spread over their links to the others."""

from __future__ import annotations

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.normals.patches import Links, Patches
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray

_POWER = 4  # of the agreement of two patches, in the strength of their link
_MOST_CONTACTS = 4.0  # by the square root of the points: more make a link no stronger
_STACKED = 6.0  # standard deviations between two sheets that are told apart
_HOLDING = 0.05  # strength from which on a link makes two patches one component
_FREE = 1e-6  # how strongly patches that nobody sees are drawn to no side
_TOLERANCE = 1e-4
_STEPS = 300


class LinkedPatches:
    """The equations that spread leanings over links.

    Notes
    -----
    The strength w of a link is the agreement of the two normals, one of them mirrored along the
    mean arm between points that touch, so that it holds around edges and on both sides of a plate.

    References
    ----------
    Koenig and Gumhold (2009), Consistent propagation of normal orientations in point clouds.
    """

    def __init__(self, patches: Patches, links: Links) -> None:
        self._first, self._second = links.first, links.second
        self._strengths = _rate_links(patches, links)
        self._count = len(patches)
        # (p,): the diagonal of the Laplacian, and a little more: a component of which nothing is
        # known would make the matrix singular.
        sums = np.zeros(self._count)
        for ends in (links.first, links.second):
            sums += np.bincount(ends, np.abs(self._strengths), self._count)
        self._sums = sums + _FREE

    def spread(self, weights: FloatArray, leanings: FloatArray, start: FloatArray) -> FloatArray:
        """Return the sides x, (p,), by conjugate gradients.

        They minimize

            sum over links  |w| (x_a - sign(w) x_b)^2  +  sum over patches  c (x - u)^2

        with the weights c and the leanings u, each (p,), as is the start.
        """
        links = self._first, self._second, self._strengths
        # Where its gradient vanishes, a system that is symmetric and positive definite.
        system = *links, self._sums + weights, weights * leanings
        return kernels.spread_leanings(*system, start, _TOLERANCE, _STEPS)

    def share_broken(self, sides: FloatArray) -> float:
        """Return how much of the strength of all links some sides contradict: 0 to 1."""
        strengths = np.abs(self._strengths)
        signs = np.where(sides < 0.0, -1.0, 1.0)
        is_broken = signs[self._first] * signs[self._second] * self._strengths < 0.0
        return float(strengths[is_broken].sum() / max(float(strengths.sum()), 1e-300))

    def components(self, chosen: BoolArray | None = None) -> IntArray:
        """Return the number of the connected component of each patch, (p,).

        Only `chosen` patches, (p,), hold others; each other one is its own.
        """
        holding = np.abs(self._strengths) > _HOLDING
        if chosen is not None:
            holding &= chosen[self._first] & chosen[self._second]
        first, second = self._first[holding], self._second[holding]
        edges = np.column_stack([first, second, second])  # as faces without an area
        return kernels.label_components(edges, self._count)[1].astype(np.int64)


def _rate_links(patches: Patches, links: Links) -> FloatArray:
    """Return how strongly two patches are linked: below 0 where their normals disagree."""
    first, second = links.first, links.second
    one, other = patches.normals[first], patches.normals[second]
    # (l, 3): not from centre to centre, which may lie beside each other on both sides of a plate.
    arms = links.arms.astype(np.float64)
    arms /= np.maximum(np.sqrt(_dot(arms, arms)), 1e-300)[:, None]
    cosines = _dot(one, other)
    # (l,): n . (m - 2 (m . e) e) with the unit vector e along the arm.
    agreement: FloatArray = cosines - 2.0 * _dot(arms, one) * _dot(arms, other)
    # (l,): the rim of a patch has about the square root of its points, and these touch others.
    fewer = np.minimum(patches.counts[first], patches.counts[second])
    strengths: FloatArray = np.sign(agreement) * np.abs(agreement) ** _POWER
    strengths *= np.minimum(links.contacts / np.sqrt(fewer), _MOST_CONTACTS)
    # Two layers of one noisy sheet look like the two sides of a plate.
    between = patches.centres[second] - patches.centres[first]
    apart = np.minimum(np.abs(_dot(between, one)), np.abs(_dot(between, other)))
    noise = np.sqrt(patches.noise[first] * patches.noise[second])
    is_stacked = (agreement * cosines < 0.0) & (np.abs(cosines) > 0.5)
    strengths[is_stacked & (apart < _STACKED * noise)] = 0.0
    return strengths


def _dot(first: FloatArray, second: FloatArray) -> FloatArray:
    dots: FloatArray = np.einsum("ij,ij->i", first, second)
    return dots
