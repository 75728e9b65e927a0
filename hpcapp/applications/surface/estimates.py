"""What the hierarchical method finds out about a cloud before it fits: spacing, noise, scale."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from hpccomponent.errors import InputError
from hpccomponent.surface import kernels
from hpccomponent.surface.arranged_cloud import ArrangedCloud, Points
from hpccomponent.surface.points import FloatArray, IntArray, PointCloud, bounding_box
from hpccomponent.surface.pyramid import (
    Level,
    VertexQuadrics,
    build_pyramid,
    count_levels,
    fit_levels,
)
from hpccomponent.surface.spacing import estimate_group_spacing, estimate_spacing
from hpccomponent.surface.weights import LEAST_MU, Weights, tell_noise

__all__ = ["Scale", "choose_scale", "estimate_noise", "probe_noise", "sample_groups"]

_PROBE_SPACINGS = 2.0
_PROBE_LAM = 0.3
_PROBE_SHARE = 0.15
_PROBE_ROUNDS = 5
_PROBE_POINTS = 14, 24  # in the finer and in the coarser cells of a probe
_SAMPLED_POINTS = 15_000
_SAMPLED_BOX = 24.0  # spacings: large against the cells of a probe
_QUANTILE, _TO_MEDIAN = 0.25, 1.0
_FREE = 10
_POINTS_AT_ONCE = 2_000_000


@dataclass(frozen=True, slots=True)
class Scale:
    """The cell size and what led to it.

    Parameters
    ----------
    spacing, noise, cell_size : float
        In length units of the input; the noise is a standard deviation along the normal.
    """

    spacing: float
    noise: float
    cell_size: float


def estimate_noise(cloud: PointCloud, spacing: float, threads: int = 1) -> float:
    """Estimate the noise of the positions along the normals.

    Parameters
    ----------
    cloud : PointCloud
        With normals.
    spacing : float
        In length units of the input.
    threads : int
        The result does not depend on it.

    Returns
    -------
    float
        Standard deviation, in length units of the input; 0 where no vertex has enough points.

    Notes
    -----
    A probe fits quadrics in cells of two sizes, two and four spacings, and takes the lower
    quartile of the residual variances RSS / (n - 10): edges and thin parts, which no quadric
    fits, are in the upper ones. Noise is the same in cells of both sizes; what grows with the
    cell is detail that the quadrics miss, and is taken off. Where the noise exceeds 0.15 of the
    finer cells, they cut its tails off, and a probe with larger ones is made. Large clouds are
    sampled by whole boxes.
    """
    if cloud.normals is None:
        raise InputError("the cloud has no normals", "give oriented points")
    points = cloud.positions, cloud.normals
    low, _ = bounding_box(cloud.positions)
    return probe_noise(sample_groups(lambda: [points], len(cloud), low, spacing), spacing, threads)


def probe_noise(sample: PointCloud, spacing: float, threads: int = 1) -> float:
    """Estimate the noise of a cloud by a sample of it; see `estimate_noise`, `sample_groups`."""
    cell_size = _PROBE_SPACINGS * spacing
    finer, coarser = _probe_variances(sample, cell_size, threads)
    for _ in range(_PROBE_ROUNDS):
        if finer <= (_PROBE_SHARE * cell_size) ** 2:
            break
        cell_size *= 2.0
        finer, coarser = _probe_variances(sample, cell_size, threads)
    noise = tell_noise(np.array(finer), np.array(coarser))
    return _TO_MEDIAN * float(np.sqrt(noise))


def sample_groups(
    groups: Callable[[], Iterable[Points]], points: int, low: FloatArray, spacing: float
) -> PointCloud:
    """Return the points in a sample of boxes: what `probe_noise` looks at.

    Parameters
    ----------
    groups : callable
        Gives the points of the cloud, some at a time.
    points : int
        In all.
    low : ndarray of float64, shape (3,)
        The least coordinates of all.
    spacing : float
        In length units of the input.

    Returns
    -------
    PointCloud
        About 15,000 points; of a cloud in few boxes more, and all of a small one.
    """
    one_in = points // _SAMPLED_POINTS
    while one_in > 1:
        sample = [
            (positions[rows], normals[rows])
            for positions, normals in groups()
            for rows in [kernels.sample_boxes(positions, low, _SAMPLED_BOX * spacing, one_in)]
        ]
        if sum(len(positions) for positions, _ in sample) > _SAMPLED_POINTS // 4:
            break
        one_in //= 8
    else:
        sample = list(groups())
    if len(sample) == 1:
        return PointCloud(*sample[0])
    positions, normals = (np.concatenate(parts) for parts in zip(*sample, strict=True))
    return PointCloud(positions, normals)


def _probe_variances(cloud: PointCloud, cell_size: float, threads: int) -> tuple[float, float]:
    """Return the lower quartiles of the residual variances in cells of a size and of its double.

    In length units of the input squared; 0 where no vertex has enough points.
    """
    low, high = bounding_box(cloud.positions)
    height = count_levels(float((high - low).max()), cell_size)
    pyramid = build_pyramid(cloud, low, cell_size, height, threads)
    levels = list(pyramid.levels[:2])  # a fit drops the moments of its level
    weights = [Weights(_PROBE_LAM, 0.0, LEAST_MU, LEAST_MU)] * len(pyramid.levels)
    quadrics, _ = fit_levels(pyramid, weights, None, threads)
    variances = [
        cell_size**2 * 4.0**depth * _lower_quartile(level, vertices, fitted, points)
        for depth, (level, vertices, fitted, points) in enumerate(
            zip(levels, pyramid.vertices, quadrics, _PROBE_POINTS, strict=False)
        )
    ]
    return variances[0], variances[-1] or variances[0]


def _lower_quartile(
    level: Level, vertices: IntArray, quadrics: VertexQuadrics, points: int
) -> float:
    """Return that of RSS / (n - 10), in cells squared, over the vertices with enough points."""
    in_cells = level.points.sum(slice(0, len(level.cells)))
    touched = kernels.spread_keys(level.cells, 0, 1)
    moments = kernels.corner_moments(touched, level.cells, in_cells)
    rich = moments[:, 0] >= points
    if not rich.any():
        return 0.0
    rows = kernels.find_keys(vertices, touched[rich])
    residuals = kernels.evaluate_residuals(moments[rich], quadrics.coefficients[rows])
    variances = np.sort(residuals / (moments[rich, 0] - _FREE))
    return float(variances[int(_QUANTILE * (len(variances) - 1))])


def choose_scale(
    cloud: PointCloud | ArrangedCloud,
    step: float,
    smoothness: float,
    detail: float,
    threads: int = 1,
) -> Scale:
    """Choose the cell size.

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
    threads : int
        The result does not depend on it.

    Returns
    -------
    Scale

    Raises
    ------
    InputError
        All points are the same.
    """
    if isinstance(cloud, PointCloud):
        spacing = estimate_spacing(cloud.positions)
        noise = estimate_noise(cloud, spacing, threads)
    else:
        spacing, noise = _estimate_parts(cloud, threads)
    wanted = max(1.5 * spacing, 6.0 * noise * smoothness) / detail
    cell_size = max(wanted, step)
    return Scale(spacing, noise, cell_size)


def _estimate_parts(cloud: ArrangedCloud, threads: int) -> tuple[float, float]:
    """Return spacing and noise of a cloud that is never in memory as a whole."""

    def groups() -> Iterator[Points]:
        return cloud.groups(_POINTS_AT_ONCE)

    count = len(cloud)
    spacing = estimate_group_spacing(
        lambda: (positions for positions, _ in groups()), count, cloud.low, cloud.high
    )
    return spacing, probe_noise(sample_groups(groups, count, cloud.low, spacing), spacing, threads)
