"""Whether the numbers of a file are too coarse for its points.

Map coordinates have seven digits before the point, and single precision holds seven in all: the
points of a scan come to lie on lines half a metre apart. Too few decimals, or too coarse a scale,
put many points in one place. What lies on a lattice of its own is neither: a raster or a voxel has
one point at each node.
"""

from __future__ import annotations

import math

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpcapp.io.points.no_data import sum_coordinates

_FEWEST = 100  # points: fewer say nothing of how far they are apart
_STEP = 0.25
"""Of the spacing, for a step of single precision: 1e-2 at most in 386 clouds at hand, 4.3 in a scan
of the ground in map coordinates (``utm_float32_dense.ply`` of the cases)."""
_OWN = 0.5  # of the spacing, for the step of a raster's columns, or its rows
_SHARED = 3.0
"""Points at a place of a lattice, on average: 1.6 at most in the same clouds, 4.1 where a step is
twice the spacing, as n / (1 - exp(-n)) of n points a step says."""
_INNER = (0.01, 0.99)  # quantiles: outliers make no cloud wide


def find_lost_digits(positions: FloatArray, points: int) -> str | None:
    """Say that coordinates have lost their digits, if they have, and what to do.

    Positions (n, 3) are in the file's coordinates, of some of so many points.
    """
    if len(positions) < _FEWEST:
        return None
    columns = np.ascontiguousarray(positions.T)
    return _find_single(columns, points) or _find_rounded(columns)


def _find_single(columns: FloatArray, points: int) -> str | None:
    """Say that single precision is too coarse for so many points, if they have no more."""
    with np.errstate(over="ignore"):
        singles = columns.astype(np.float32)
    if (singles != columns).any():
        return None
    steps = np.spacing(np.abs(singles).max(axis=1)).astype(np.float64)
    spacing = _estimate_spacing(columns, points)
    is_coarse = steps > _STEP * spacing
    if not 0 < spacing < np.inf or not is_coarse.any():
        return None
    own = np.array([_find_step(column) for column in columns])
    if ((own >= 2 * steps) & (own >= _OWN * spacing)).any():
        return None
    named = ", ".join(f"{steps[i]:.2g} in {'xyz'[i]}" for i in np.flatnonzero(is_coarse))
    return (
        f"the coordinates have lost digits: single precision has steps of {named} there, and "
        f"points are some {spacing:.2g} apart: export the file in double precision, or subtract "
        "an origin first"
    )


def _find_rounded(columns: FloatArray) -> str | None:
    """Say that most points share their places with others, if these are those of a lattice."""
    if _SHARED * len(np.unique(columns[0])) > columns.shape[1]:
        return None
    places = len(np.unique(sum_coordinates(columns.T)))
    if places * _SHARED > columns.shape[1]:
        return None
    steps = np.array([_find_step(column) for column in columns])
    if np.sort(steps)[1] <= _STEP * _estimate_spacing(columns, places):
        return None
    return (
        f"the coordinates have lost digits: they come in steps of {steps.max():.2g}, and only "
        f"{places} of {columns.shape[1]} places that were looked at differ: export the file with "
        "more decimals, or a finer scale"
    )


def _estimate_spacing(columns: FloatArray, points: int) -> float:
    """Return how far points of a sheet as wide as most of the cloud are apart."""
    low, high = np.quantile(columns, _INNER, axis=1)
    return math.sqrt(math.prod(np.sort(high - low)[1:].tolist()) / points)  # of the longer two


def _find_step(column: FloatArray) -> float:
    """Return the least distance of two numbers; zero where all are the same."""
    steps = np.diff(np.unique(column))
    return float(steps.min()) if len(steps) else 0.0
