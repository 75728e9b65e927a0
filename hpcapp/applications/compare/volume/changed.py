"""Which pieces of a surface have changed: what stands out of the noise, and the rim around it."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from hpcapp.applications.compare.volume.errors import STAYED, Errors, Samples
from hpcapp.geometry.points import IntArray


def find_changed(samples: Samples, errors: Errors, pairs: IntArray) -> IntArray:
    """Return 1 for what was filled, -1 for what was cut, and 0 where no change is told.

    A region begins with neighbours whose changes each stand out of the noise. It grows ring by
    ring as long as the volume of the next ring does, too: the foot of a heap is thinner than the
    noise of a single piece, and is part of the heap all the same.

    Parameters
    ----------
    pairs : ndarray of int64, shape (p, 2)
        Neighbours.
    """
    change = samples.change - samples.effect @ errors.bias
    side = np.sign(change).astype(np.int64)
    side[np.abs(change) <= errors.detect(samples)] = 0
    region, sides = _join_alike(side, pairs)
    is_growing = np.ones(len(sides), dtype=bool)
    is_growing[0] = False
    both = np.concatenate([pairs, pairs[:, ::-1]])
    while True:
        inner, outer = both[is_growing[region[both[:, 0]]] & (region[both[:, 1]] == 0)].T
        claim = np.zeros(len(region), dtype=np.int64)
        np.maximum.at(claim, outer, region[inner])
        ring = np.flatnonzero(claim)
        owner = claim[ring]
        volume = samples.area * np.bincount(owner, change[ring], len(sides))
        is_growing = sides * volume > STAYED * errors.find_deviations(
            samples, ring, owner, len(sides)
        )
        if not is_growing.any():
            return sides[region]
        ring = ring[is_growing[owner]]
        region[ring] = claim[ring]


def _join_alike(side: IntArray, pairs: IntArray) -> tuple[IntArray, IntArray]:
    """Return the region of each piece, 0 of those on no side, and the side of each region."""
    alike = pairs[(side[pairs[:, 0]] == side[pairs[:, 1]]) & (side[pairs[:, 0]] != 0)]
    graph = coo_array((np.ones(len(alike), np.int8), alike.T), shape=(len(side), len(side)))
    part = connected_components(graph, directed=False)[1]
    part[side == 0] = -1
    _, region = np.unique(part, return_inverse=True)
    region = region.astype(np.int64) + int((side != 0).all())
    sides = np.zeros(int(region.max(initial=0)) + 1, dtype=np.int64)
    sides[region] = side
    return region, sides
