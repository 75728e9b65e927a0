"""Whether a tripod stood among points: from there they are even, on the surface they are not.

A scanner that turns takes as many points in every direction. So their density falls with the square
of the distance, and nothing but a scan from a place inside looks even from a place inside.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from hpcapp.applications.surface.normals.patches import CELL, Patches
from hpcapp.applications.surface.types.points import FloatArray, IntArray

__all__ = ["has_stand"]

_SAMPLE = 3000  # patches, about
_PLACES = 7  # along each side of the box
_BANDS = 12  # of directions, each of twice as many of equal solid angle
_PARTS = ((-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0))  # quarters of a patch
_NEAREST = 8  # patches whose points make the density of one
_LOW, _HIGH = 0.15, 0.85  # quantiles that a spread lies between
_EVEN = 0.66  # of the spread on the surface: that from a place where a tripod stood
_AROUND = 0.94  # share of the directions in which it saw something
_UNEVEN = 1.3  # spread on the surface, as logarithm, from which on this tells


def has_stand(patches: Patches, spacing: float) -> bool:
    """Tell whether a scanner stood in some place inside the box of a cloud, and saw all around.

    Parameters
    ----------
    patches : Patches
        Of a whole cloud.
    spacing : float
        Of the cloud, in length units of the input.

    Notes
    -----
    The spread of a density is the logarithm of its .85 by its .15 quantile. For 343 places it is
    taken of the points per solid angle, and once of the points per area.
    """
    if len(patches) <= _NEAREST:  # which are in too few directions from anywhere
        return False
    counts = patches.counts.astype(np.float64)
    near = cKDTree(patches.centres)
    every = slice(None, None, -(-len(patches) // _SAMPLE))
    centres, sampled = patches.centres[every], counts[every]
    far, rows = near.query(centres, _NEAREST + 1)
    density = counts[rows].sum(axis=1) / np.maximum(far[:, -1] ** 2, 1e-300)
    order = np.argsort(density)
    below = np.cumsum(sampled[order]) / sampled.sum()
    low, high = (density[order[np.searchsorted(below, share)]] for share in (_LOW, _HIGH))
    uneven = float(np.log(high / low))
    if uneven < _UNEVEN:
        return False
    parts = _quarter(patches.take(np.arange(len(patches))[every]), 0.25 * CELL * spacing)
    shares, cells = np.tile(0.25 * sampled, len(_PARTS)), 2 * _BANDS * _BANDS
    for place in _fill_box(patches.centres.min(axis=0), patches.centres.max(axis=0)):
        points = np.bincount(_find_directions(parts - place), shares, cells)
        seen = points[points > 0.0]
        if len(seen) < _AROUND * cells:
            continue
        fewest, most = np.quantile(seen, (_LOW, _HIGH))
        if np.log(most / fewest) < _EVEN * uneven:
            return True
    return False


def _fill_box(low: FloatArray, high: FloatArray) -> FloatArray:
    shares = np.arange(1, _PLACES + 1) / (_PLACES + 1)
    grid = np.stack(np.meshgrid(shares, shares, shares, indexing="ij"), axis=-1).reshape(-1, 3)
    places: FloatArray = low + grid * (high - low)
    return places


def _quarter(patches: Patches, reach: float) -> FloatArray:
    """Return the middles of four parts of each patch."""
    rows = np.arange(len(patches))
    axes = np.zeros((len(patches), 3))
    axes[rows, np.argmin(np.abs(patches.normals), axis=1)] = 1.0
    one = np.cross(patches.normals, axes)
    one /= np.sqrt(np.einsum("ij,ij->i", one, one))[:, None]
    other = np.cross(patches.normals, one)
    return np.concatenate(
        [patches.centres + reach * (along * one + across * other) for along, across in _PARTS]
    )


def _find_directions(arms: FloatArray) -> IntArray:
    """Return for each arm the number of the direction that it points in."""
    lengths = np.maximum(np.sqrt(np.einsum("ij,ij->i", arms, arms)), 1e-300)
    rows = np.floor((arms[:, 2] / lengths + 1.0) * (0.5 * _BANDS)).astype(np.int64)
    turns = np.arctan2(arms[:, 1], arms[:, 0]) / (2.0 * np.pi) + 0.5
    columns = np.floor(turns * 2 * _BANDS).astype(np.int64)
    numbers: IntArray = np.minimum(rows, _BANDS - 1) * 2 * _BANDS + np.minimum(
        columns, 2 * _BANDS - 1
    )
    return numbers
