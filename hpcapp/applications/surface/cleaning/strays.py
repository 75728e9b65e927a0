"""Strays near a surface: points that lie apart from neighbours which lie close together.

::

    all points ── few others nearby ──> candidates ── nearest points ──> strays
                                             │               ▲
                                             └── of each of these, the nearest

How far the 8th and the 24th nearest point is tells how sparse it is around a point. Around a stray
it is far sparser than around most of its neighbours, which lie on a surface. Where a scan is sparse
throughout, at its border, on a wire or in a crown, the neighbours have it no better. Twenty-four
outnumber a clump of eight. A sparse sheet beside a dense one stays: it is flat.
"""

from __future__ import annotations

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.scale.local_scale import LocalScale
from hpcapp.geometry.lattice import lay_lattice, unpack_keys
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray

_COUNTS = (8, 24)  # neighbours; on a surface the last of them lie 1.6 and 2.8 spacings away
_CROWDED = 3.6  # local spacings: with so many so near, a point is none
_SPARSER = (2.2, 1.7)  # times as sparse as around the median neighbour
_FLAT_COUNT = 6  # neighbours: fewer than a clump of eight has of its own
_FEWEST = 4  # points may lie on a plane by chance
_FLAT = 0.01  # share of the variance: a sparse sheet beside a dense one is flat, a wire, too
_LIMIT = 12.0  # spacings of the whole cloud: farther points are no neighbours

MARGIN = 2.0 * _LIMIT
"""Spacings of the whole cloud: as far as what decides over a point lies."""

ROUNDS = 2
"""At most: once some flying pixels are gone, the others lie apart."""


def find_strays(
    positions: FloatArray, own: BoolArray, low: FloatArray, scale: LocalScale, threads: int = 1
) -> BoolArray:
    """Tell which own points (m,) of a region are strays.

    `positions` (n, 3) are all of the cloud in the region and within `MARGIN` spacings of it, `own`
    (n,) tells which lie in it, and `low` (3,) are the least coordinates of the cloud.
    """
    edge = _CROWDED * scale.spacing
    corner = lay_lattice(low, edge)
    cells = kernels.sort_points(positions, corner, edge)
    # A dense place has its own spacing. A sparse one has not: strays are sparse.
    centres = corner + edge * (unpack_keys(cells[0]) + 0.5)
    radii = _CROWDED * np.minimum(scale.at(centres), scale.spacing)
    is_candidate = kernels.find_sparse(positions, *cells, radii, _COUNTS[-1], threads)
    candidates = np.flatnonzero(is_candidate & own)
    limit = _LIMIT * scale.spacing

    def search(rows: IntArray) -> tuple[FloatArray, IntArray]:
        """Return the squares of how far the last neighbours of each count are, and who all are."""
        squares, nearest = kernels.find_nearest(
            positions, *cells, edge, rows, _COUNTS[-1], limit, threads
        )
        return np.minimum(squares[:, np.array(_COUNTS) - 1], limit * limit), nearest

    reach, nearest = search(candidates)
    # (n + 1, k): of each neighbour; infinite where a point has none
    reaches = np.full((len(positions) + 1, len(_COUNTS)), np.inf)
    reaches[candidates] = reach
    is_asked = np.zeros(len(reaches), np.bool_)
    is_asked[nearest] = True
    is_asked[candidates] = is_asked[-1] = False  # those are known, that is none
    others = np.flatnonzero(is_asked)
    reaches[others] = search(others)[0]
    strays = np.zeros(len(positions), np.bool_)
    for column, (count, sparser) in enumerate(zip(_COUNTS, _SPARSER, strict=True)):
        # (m, count): how sparse it is around each neighbour, in squares; missing ones are last.
        ordered = np.sort(reaches[nearest[:, :count], column], axis=1)
        held = np.count_nonzero(nearest[:, :count] < len(positions), axis=1)
        median = ordered[np.arange(len(ordered)), held // 2]
        strays[candidates] |= reach[:, column] > sparser**2 * median
    found = np.flatnonzero(strays[candidates])
    strays[candidates[found]] = ~_lie_flat(positions, candidates[found], nearest[found])
    of_own: BoolArray = strays[own]
    return of_own


def _lie_flat(positions: FloatArray, rows: IntArray, nearest: IntArray) -> BoolArray:
    """Tell which points lie on one plane, or line, with their next neighbours."""
    near = np.column_stack([rows, nearest[:, :_FLAT_COUNT]])
    held = (near < len(positions)).astype(np.float64)
    arms = positions[np.where(held > 0, near, rows[:, None])] - positions[rows, None]
    number = held.sum(axis=1)
    # (m, k, 3): from the mean of a point and its neighbours; missing ones are made 0.
    arms -= (arms.sum(axis=1) / number[:, None])[:, None]
    arms *= held[..., None]
    variances = np.linalg.eigvalsh(np.einsum("nki,nkj->nij", arms, arms))
    is_flat: BoolArray = variances[:, 0] <= _FLAT * variances.sum(axis=1)
    is_flat &= number > _FEWEST
    return is_flat
