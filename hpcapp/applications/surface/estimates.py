"""What the hierarchical method finds out about a cloud before it fits: spacing, noise, scale."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hpcapp.applications.surface.pyramid import build_pyramid, fit_pyramid
from hpcapp.batches import Workforce
from hpccomponent.surface import kernels
from hpccomponent.surface.points import PointCloud
from hpccomponent.surface.spacing import estimate_spacing

__all__ = ["MU", "Scale", "choose_scale", "estimate_noise"]

MU = 0.3
"""Weight of a vertex's prior, in points."""

_PROBE_SPACINGS = 4.0
_PROBE_LAM = 0.3
_PROBE_SHARE = 0.15
_PROBE_ROUNDS = 4
_PROBE_POINTS = 24
_PROBE_CORNERS = 100_000
_FREE = 10


@dataclass(frozen=True, slots=True)
class Scale:
    """The cell size and what led to it.

    Parameters
    ----------
    spacing, noise, cell_size : float
        In length units of the input; the noise is a standard deviation along the normal.
    lam : float
        Weight of the normals against the positions, dimensionless.
    """

    spacing: float
    noise: float
    cell_size: float
    lam: float


def estimate_noise(cloud: PointCloud, spacing: float, workforce: Workforce) -> float:
    """Estimate the noise of the positions along the normals.

    Parameters
    ----------
    cloud : PointCloud
        With normals.
    spacing : float
        In length units of the input.
    workforce : Workforce

    Returns
    -------
    float
        Standard deviation, in length units of the input; 0 where no vertex has enough points.

    Notes
    -----
    Quadrics in cells of four spacings; the median over the vertices with 24 points or more of
    the residual variance, RSS / (n - 10). Where the noise exceeds 0.15 of such a cell, the cells
    cut its tails off, and larger ones are tried.
    """
    cell_size = _PROBE_SPACINGS * spacing
    noise = _probe_noise(cloud, cell_size, workforce)
    for _ in range(_PROBE_ROUNDS):
        if noise <= _PROBE_SHARE * cell_size:
            break
        cell_size *= 2.0
        noise = _probe_noise(cloud, cell_size, workforce)
    return noise


def _probe_noise(cloud: PointCloud, cell_size: float, workforce: Workforce) -> float:
    """Return the median residual of quadrics in cells of one size."""
    pyramid = build_pyramid(cloud, cell_size, workforce)
    finest = pyramid.levels[0]
    quadrics = fit_pyramid(pyramid, _PROBE_LAM, MU, workforce)
    # The median over a sample is as good: every so many-th corner of a large cloud.
    touched = finest.touched[:: len(finest.touched) // _PROBE_CORNERS + 1]
    moments = kernels.corner_moments(touched, finest.cells, finest.moments)
    rich = moments[:, 0] >= _PROBE_POINTS
    if not rich.any():
        return 0.0
    coefficients = quadrics.coefficients[kernels.find_keys(finest.vertices, touched)]
    residuals = kernels.evaluate_residuals(moments[rich], coefficients[rich])
    return pyramid.cell_size * float(np.sqrt(np.median(residuals / (moments[rich, 0] - _FREE))))


def choose_scale(
    cloud: PointCloud, step: float, smoothness: float, detail: float, workforce: Workforce
) -> Scale:
    """Choose the cell size and the weight of the normals.

    Parameters
    ----------
    cloud : PointCloud
        With normals.
    step : float
        Of the evaluation grid, in length units of the input; no cell is smaller, because the
        lattice must reach the nodes on both sides of the surface.
    smoothness : float
        Multiplies the noise, dimensionless.
    detail : float
        Divides the cell size, dimensionless.
    workforce : Workforce

    Returns
    -------
    Scale

    Raises
    ------
    InputError
        All points are the same.
    """
    spacing = estimate_spacing(cloud.positions)
    noise = estimate_noise(cloud, spacing, workforce)
    wanted = max(1.5 * spacing, 6.0 * noise * smoothness) / detail
    cell_size = max(wanted, step)
    lam = float(np.clip(5.0 * (noise * smoothness / cell_size) ** 2, 0.01, 1.0))
    return Scale(spacing, noise, cell_size, lam)
