"""Normals from positions: a plane through as many neighbours as noise and curvature allow.

::

    nested neighbourhoods ── moments ──> planes ── noise of the cell ──> the best of each point

The result has no side yet: `orientation` finds it.
"""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface.kernels import fit_planes
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.lattice import cells_of, pack_places
from hpcapp.geometry.points import BoolArray, Float32Array, FloatArray

_REACH = 12.0  # spacings: farther points are no neighbours
_CELL = 5.0  # spacings: the noise is that of the median point of a cell
_ROUNDED = 2.0**-16  # spacings: more than distances change when positions are rounded

MARGIN = _REACH + _CELL * 3.0**0.5 + _ROUNDED
"""Spacings: as far as what decides over a normal lies."""


def estimate_normals(
    positions: FloatArray, asked: BoolArray, low: FloatArray, spacing: float, threads: int = 1
) -> Float32Array:
    """Estimate the normals of points, without a side.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
        Of a cloud, or of a region of it and all points within `MARGIN`; in its order.
    asked : ndarray of bool, shape (n,)
        The points whose normals are wanted.
    low : ndarray of float64, shape (3,)
        The least coordinates of the cloud.
    spacing : float
        Of the cloud, in length units of the input.

    Returns
    -------
    ndarray of float32, shape (m, 3)
        Of the points that were asked for. The length is the standard deviation of the points
        around the plane, in length units of the input.

    Raises
    ------
    InputError
        The cloud spans more cells than a lattice has.

    Notes
    -----
    See `kernels.portable.around.planes.fit_planes`.
    """
    refuse_wide(positions, low, _CELL * spacing)
    return fit_planes(positions, asked.astype(np.uint8), low, spacing, threads)


def keep_directions(vectors: Float32Array, normals: FloatArray | Float32Array) -> Float32Array:
    """Give normals that are known already the lengths of estimated ones.

    Parameters
    ----------
    vectors : ndarray of float32, shape (m, 3)
        What `estimate_normals` has returned.
    normals : ndarray of float64 or float32, shape (m, 3)
        Unit length.

    Returns
    -------
    ndarray of float32, shape (m, 3)
    """
    wide = vectors.astype(np.float64)
    lengths = np.sqrt(np.einsum("ij,ij->i", wide, wide))
    kept: Float32Array = (normals * lengths[:, None]).astype(np.float32)
    return kept


def refuse_wide(positions: FloatArray, low: FloatArray, cell_size: float) -> None:
    """Refuse positions that do not lie on a lattice.

    Parameters
    ----------
    positions : ndarray of float64, shape (n, 3)
    low : ndarray of float64, shape (3,)
        Where corner (0, 0, 0) lies.
    cell_size : float
        In length units of the input.

    Raises
    ------
    InputError
        They span more cells than a lattice has.
    """
    if len(positions):
        corners = np.floor(cells_of(np.stack(bound_points(positions)), low, cell_size))
        pack_places(corners.astype(np.int64) + 4)  # the last ones have no cells around them
