"""Normals from positions: a plane through as many neighbours as noise and curvature allow.

::

    nested neighbourhoods ── moments ──> planes ── noise of the cell ──> the best of each point

The result has no side yet: `orientation` finds it.
"""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.lattice import cells_of, pack_places
from hpcapp.geometry.points import BoolArray, Float32Array, FloatArray
from hpcapp.kernels import fit_planes

_REACH = 12.0  # spacings: farther points are no neighbours
_CELL = 5.0  # spacings: the noise is that of the median point of a cell
_ROUNDED = 2.0**-16  # spacings: more than distances change when positions are rounded

MARGIN = _REACH + _CELL * 3.0**0.5 + _ROUNDED
"""Spacings: as far as what decides over a normal lies."""


def estimate_normals(
    positions: FloatArray, asked: BoolArray, low: FloatArray, spacing: float, threads: int = 1
) -> Float32Array:
    """Estimate the normals of points without a side, (m, 3), by planes through their neighbours.

    See `kernels.portable.around.planes.fit_planes`; their length is the standard deviation of the
    points around the plane. Positions (n, 3) are of a cloud, or of a region of it and all points
    within `MARGIN`, in its order; `asked`, (n,), tells the m points, `low`, (3,), the cloud's least
    coordinates. InputError where the cloud spans more cells than a lattice has.
    """
    refuse_wide(positions, low, _CELL * spacing)
    return fit_planes(positions, asked.astype(np.uint8), low, spacing, threads)


def keep_directions(vectors: Float32Array, normals: FloatArray | Float32Array) -> Float32Array:
    """Give known unit normals (m, 3) the lengths of those that `estimate_normals` has returned."""
    wide = vectors.astype(np.float64)
    lengths = np.sqrt(np.einsum("ij,ij->i", wide, wide))
    kept: Float32Array = (normals * lengths[:, None]).astype(np.float32)
    return kept


def refuse_wide(positions: FloatArray, low: FloatArray, cell_size: float) -> None:
    """Refuse, by an InputError, positions (n, 3) that span more cells than a lattice has.

    Its corner (0, 0, 0) lies at `low`, (3,).
    """
    if len(positions):
        corners = np.floor(cells_of(np.stack(bound_points(positions)), low, cell_size))
        pack_places(corners.astype(np.int64) + 4)  # the last ones have no cells around them
