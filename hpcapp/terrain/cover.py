"""Where points cover the ground, also between them and at the border of a scan."""

from __future__ import annotations

from math import ceil

import numpy as np
from scipy.ndimage import distance_transform_edt, uniform_filter

from hpcapp.geometry.points import FloatArray
from hpcapp.terrain.lattice import Lattice

_REACH = 2.0
"""Spacings: gaps up to double of it are closed. Of points at random a disc of that radius is empty
in 3 of a million places, and of the fields that people scan none is thinner."""
_BORDER = 0.75
"""Spacings between the outermost points, where gaps are closed, and the border of what was scanned:
0.70 to 0.85 of points at random, jittered and in rows (`benchmarks/volumes.py`)."""
_AROUND = 10.0  # spacings across which a density is told
_FINEST = 64.0  # squares of a raster along a cell
_AT_ONCE = 4_000_000  # of which distances are told at once


def cover_cells(points: FloatArray, spacing: float, lattice: Lattice) -> FloatArray:
    """Return the share of each cell that points (n, 3) cover, (rows, columns).

    The spacing is that where they are sparse.
    """
    fine = round(min(max(2.0 * lattice.step / spacing, 1.0), _FINEST))
    square = lattice.step / fine
    reach, around = _REACH * spacing / square, max(ceil(_AROUND * spacing / square), 1)
    halo = ceil((2.0 * reach + around) / fine)  # cells
    rows, columns = lattice.shape
    high = max(_AT_ONCE // (fine**2 * (columns + 2 * halo)), 4 * halo)
    shares = np.zeros(lattice.shape)
    counts = _rasterize(points, lattice, fine, halo)
    inner = slice(fine * halo, -fine * halo)
    for first in range(0, rows, high):
        last = min(first + high, rows)
        band = counts[fine * first : fine * (last + 2 * halo)]
        cover = _close(band, reach, around)[inner, inner]
        shares[first:last] = cover.reshape(last - first, fine, columns, fine).mean(axis=(1, 3))
    return shares


def _rasterize(points: FloatArray, lattice: Lattice, fine: int, halo: int) -> FloatArray:
    """Return how many points the squares of a raster hold, with a halo of cells around."""
    rows, columns = (fine * (side + 2 * halo) for side in lattice.shape)
    places = np.floor(fine * (lattice.in_cells(points) + 0.5 + halo)).astype(np.int64)
    column, row = places.T
    is_in = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    counts = np.bincount((row * columns + column)[is_in], minlength=rows * columns)
    return counts.reshape(rows, columns).astype(np.float32)


def _close(counts: FloatArray, reach: float, around: int) -> FloatArray:
    """Return the share of each square that is covered; lengths are in squares."""
    if not counts.any():
        return np.zeros(counts.shape)
    discs = distance_transform_edt(counts == 0.0) <= reach
    if discs.all():
        return np.ones(counts.shape)
    depth = distance_transform_edt(discs) - reach
    near = uniform_filter((depth > 0.0).astype(np.float32), around)
    density = np.maximum(uniform_filter(counts, around), 1e-6) / np.maximum(near, 1e-6)
    # of a border that crosses squares those count that hold a point: half a square too much
    border = _BORDER / np.sqrt(density) + 0.5 * np.expm1(-density)
    cover: FloatArray = np.clip(depth + np.minimum(border, reach), 0.0, 1.0)
    return cover
