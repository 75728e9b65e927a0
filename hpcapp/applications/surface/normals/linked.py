"""What is known of some patches, spread over their links to the others."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, diags
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import cg

from hpcapp.applications.surface.normals.patches import Links, Patches
from hpcapp.cancellation import check_cancelled
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray

_POWER = 4  # of the agreement of two patches, in the strength of their link
_MOST_CONTACTS = 4.0  # by the square root of the points: more make a link no stronger
_STACKED = 4.0  # standard deviations between two sheets that are told apart
_HOLDING = 0.05  # strength from which on a link makes two patches one component
_FREE = 1e-6  # how strongly patches that nobody sees are drawn to no side
_TOLERANCE = 1e-4
_STEPS = 300


class LinkedPatches:
    """The equations that spread leanings over links.

    Parameters
    ----------
    patches : Patches
    links : Links

    Notes
    -----
    The strength w of a link is the agreement of the two normals, one of them mirrored along the
    line between the centres, so that it holds around edges and on both sides of a plate.

    References
    ----------
    Koenig and Gumhold (2009), Consistent propagation of normal orientations in point clouds.
    """

    def __init__(self, patches: Patches, links: Links) -> None:
        self._first, self._second = links.first, links.second
        self._strengths = _rate_links(patches, links)
        self._count = len(patches)
        # (2 l,): each link in both directions, as the matrix is symmetric.
        ends = (links.first, links.second), (links.second, links.first)
        rows, columns = (np.concatenate(pair) for pair in zip(*ends, strict=True))
        both = np.concatenate([self._strengths, self._strengths])
        self._links = csr_matrix((both, (rows, columns)), shape=(self._count, self._count))
        # (p,): the diagonal of the Laplacian, and a little more: a component of which nothing is
        # known would make the matrix singular.
        self._sums = np.bincount(rows, np.abs(both), self._count) + _FREE

    def spread(self, weights: FloatArray, leanings: FloatArray, start: FloatArray) -> FloatArray:
        """Return sides.

        They minimize

            sum over links  |w| (x_a - sign(w) x_b)^2  +  sum over patches  c (x - u)^2

        with the weights c and the leanings u; by conjugate gradients.

        Parameters
        ----------
        weights, leanings, start : ndarray of float64, shape (p,)

        Returns
        -------
        ndarray of float64, shape (p,)
        """
        diagonal = self._sums + weights
        sides: FloatArray
        # Where its gradient vanishes, a system that is symmetric and positive definite.
        sides, _ = cg(
            diags(diagonal) - self._links,
            weights * leanings,
            x0=start,
            rtol=_TOLERANCE,
            maxiter=_STEPS,
            M=diags(1.0 / diagonal),
            callback=lambda _: check_cancelled(),
        )
        return sides

    def share_broken(self, sides: FloatArray) -> float:
        """Return how much of the strength of all links some sides contradict: 0 to 1."""
        strengths = np.abs(self._strengths)
        signs = np.where(sides < 0.0, -1.0, 1.0)
        is_broken = signs[self._first] * signs[self._second] * self._strengths < 0.0
        return float(strengths[is_broken].sum() / max(float(strengths.sum()), 1e-300))

    def components(self, chosen: BoolArray | None = None) -> IntArray:
        """Return the number of the connected component of each patch.

        Parameters
        ----------
        chosen : ndarray of bool, shape (p,), optional
            The patches that hold others; each other one is its own.
        """
        holding = np.abs(self._strengths) > _HOLDING
        if chosen is not None:
            holding &= chosen[self._first] & chosen[self._second]
        ends = self._first[holding], self._second[holding]
        graph = coo_matrix((np.ones(len(ends[0])), ends), shape=(self._count, self._count))
        numbers: IntArray = connected_components(graph, directed=False)[1].astype(np.int64)
        return numbers


def _rate_links(patches: Patches, links: Links) -> FloatArray:
    """Return how strongly two patches are linked: below 0 where their normals disagree."""
    first, second = links.first, links.second
    one, other = patches.normals[first], patches.normals[second]
    arms = patches.centres[second] - patches.centres[first]
    lengths = np.maximum(np.sqrt(_dot(arms, arms)), 1e-300)
    arms = arms / lengths[:, None]
    along_one, along_other = _dot(arms, one), _dot(arms, other)
    cosines = _dot(one, other)
    # (l,): n . (m - 2 (m . e) e) with the unit vector e from centre to centre.
    agreement: FloatArray = cosines - 2.0 * along_one * along_other
    # (l,): the rim of a patch has about the square root of its points, and these touch others.
    fewer = np.minimum(patches.counts[first], patches.counts[second])
    strengths: FloatArray = np.sign(agreement) * np.abs(agreement) ** _POWER
    strengths *= np.minimum(links.contacts / np.sqrt(fewer), _MOST_CONTACTS)
    # Two layers of one noisy sheet look like the two sides of a plate.
    apart = np.minimum(np.abs(along_one), np.abs(along_other)) * lengths
    noise = np.sqrt(patches.noise[first] * patches.noise[second])
    is_stacked = (agreement * cosines < 0.0) & (np.abs(cosines) > 0.5)
    strengths[is_stacked & (apart < _STACKED * noise)] = 0.0
    return strengths


def _dot(first: FloatArray, second: FloatArray) -> FloatArray:
    dots: FloatArray = np.einsum("ij,ij->i", first, second)
    return dots
