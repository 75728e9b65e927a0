"""Whether a scan draws together at its border: what stood on a table does, a terrain does not.

The normals of a closed surface add up to zero. Where a piece was not seen, the sum of the others
points away from it: out of a table. At the border of an object the surface goes on towards the
table; at the border of a terrain or of a view it goes on sideways, along itself.
"""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import BoolArray, FloatArray

_NEIGHBOURS = 24
_ONE_SIDED = 0.33  # of the distance of the last of them: their mean, at a border
_DRAWN = 0.4  # mean cosine between the way on and the way to the missing side
_FEWEST = 100  # points that tell


def draws_together(positions: FloatArray, normals: FloatArray, areas: FloatArray) -> bool:
    """Tell whether a surface goes on, at its border, towards what is missing.

    Parameters
    ----------
    positions, normals : ndarray of float64, shape (n, 3)
        Points of the surface, and their unit normals, whose side is known.
    areas : ndarray of float64, shape (n,)
        What each stands for; in any unit.
    """
    if len(positions) < _FEWEST:
        return False
    is_border, onwards = _find_border(positions, normals)
    weights = areas[is_border]
    drawn = float((weights * (onwards @ _find_missing(normals, areas))).sum())
    return drawn > _DRAWN * float(weights.sum())


def _find_missing(normals: FloatArray, areas: FloatArray) -> FloatArray:
    """Return the unit vector to the side that is missing."""
    missing = -(areas[:, None] * normals).sum(axis=0)
    unit: FloatArray = missing / max(float(np.sqrt(missing @ missing)), 1e-300)
    return unit


def _find_border(positions: FloatArray, normals: FloatArray) -> tuple[BoolArray, FloatArray]:
    """Return which points have neighbours on one side only, and the way on from each of these."""
    from scipy.spatial import cKDTree  # takes its time

    far, near = cKDTree(positions).query(positions, _NEIGHBOURS + 1)
    # (n, 3): to the mean of the neighbours, along the surface: inwards at a border, else about 0.
    arms = positions[near[:, 1:]].mean(axis=1) - positions
    arms -= np.einsum("ij,ij->i", arms, normals)[:, None] * normals
    lengths = np.sqrt(np.einsum("ij,ij->i", arms, arms))
    is_border = lengths > _ONE_SIDED * far[:, -1]
    onwards: FloatArray = -arms[is_border] / lengths[is_border, None]
    return is_border, onwards
