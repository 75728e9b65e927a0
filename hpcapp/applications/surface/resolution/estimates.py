"""What the hierarchical method finds out about a cloud before it fits: spacing, noise, scale."""

from __future__ import annotations

from typing import Any

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.cloud.arranged import CloudMeasures
from hpcapp.applications.surface.field.cell_points import SortedPoints
from hpcapp.applications.surface.field.local_noise import (
    QUARTILE,
    SHARE,
    LocalNoise,
    Residuals,
    map_noise,
)
from hpcapp.applications.surface.field.pyramid import (
    Level,
    VertexQuadrics,
    build_pyramid,
    count_levels,
    fit_levels,
)
from hpcapp.applications.surface.field.refinement import Refinement
from hpcapp.applications.surface.field.robust import find_tolerance, measure_points, tell_kurtosis
from hpcapp.applications.surface.field.weights import LEAST_MU, Weights, tell_noise
from hpcapp.applications.surface.methods.method import MARGIN, MAX_GRID, Resolution
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.lattice import lay_lattice
from hpcapp.geometry.points import FloatArray, IntArray, PointCloud
from hpccomponent.dataclass import dataclass

_CHEAP, _SIXTEEN = 256, 16  # cells along the longest side
_EXACT = 1e-6  # of sixteen cells: whole numbers stay what they are
_SMOOTHER = 0.75  # of the step, while a grid is cheap
_SPACINGS = 1.5  # across a cell
_FEWEST = 1.25  # likewise, by the spacing there: from these to twice as many
_MOST_LEVELS = 3  # that cells are halved or doubled for
_SHARES = 0.02, 0.95  # of the points: levels that fewer of them ask for are not worth it
_NOISE_CELLS = 2.5  # standard deviations across a cell: its quadric has its prior to average with
_USUAL, _ENOUGH = 0.6, 0.2  # of the whole's spacing, of the points: by these noise is told
_PROBE_SPACINGS = 2.0
_PROBE_LAM = 0.3
_PROBE_ROUNDS = 5
_PROBE_POINTS = 14, 24, 24, 24  # in the finer and in the coarser cells of a probe
_FREE = 10
_AGREEING = 0.2  # misfits are about 1 where two sheets oppose; a gear's teeth tell .1, not .5
_NOISE_SHARE = 0.5  # of residuals: what remains is detail, and no point of it is wrong
_ROUNDING = 1e-4  # cells: points that lie so exactly have no outliers among them


@dataclass(frozen=True, slots=True, eq=False)
class Scale:
    """The cell size, and what led to it.

    `spacing` and `cell_size` are by the whole cloud, `noise` is along the normals. A point that is
    `tolerance` variances of the noise off counts half. Cells are halved `finer` times where points
    are dense, and doubled `coarser` times where they are sparse: `spacings` of the points around
    lie across one, at least.
    """

    spacing: float
    noise: LocalNoise
    cell_size: float
    tolerance: float
    finer: int
    coarser: int
    spacings: float

    @property
    def finest(self) -> float:
        """Edge of the finest cells, in length units of the input."""
        return self.cell_size * 2.0**-self.finer

    @property
    def levels(self) -> int:
        """From the finest cells up to those of the base, which cover the whole cloud."""
        return self.finer + self.coarser


@dataclass(frozen=True, slots=True, eq=False)
class _Noise:
    """What a probe finds: see `Scale`."""

    local: LocalNoise
    tolerance: float


@dataclass(frozen=True, slots=True, eq=False)
class _Probe:
    """What fits leave over in cells of a size, of its double and so on, the finest first.

    `origin`, (3,), is a corner of cells of any size; `agreeing` are the residuals of quadrics that
    agree with their normals, `kurtosis` is that in the finest cells.
    """

    origin: FloatArray
    residuals: list[Residuals]
    agreeing: list[Residuals]
    kurtosis: float

    def quartile(self, level: int) -> float:
        """Return the lower quartile of a level's variances; 0 where it has none."""
        variances = np.sort(self.residuals[min(level, len(self.residuals) - 1)].variances)
        return float(variances[int(QUARTILE * (len(variances) - 1))]) if len(variances) else 0.0


def _leave_dense(measured: CloudMeasures) -> PointCloud:
    """Return the sample without what is much denser than the whole cloud: its cells hold detail."""
    sample, scale = measured.sample, measured.scale
    rows = np.flatnonzero(scale.at(sample.positions) >= _USUAL * scale.spacing)
    return sample.take(rows) if len(rows) >= _ENOUGH * len(sample) else sample


def _probe(sample: PointCloud, spacing: float, threads: int) -> _Noise:
    """Estimate the noise, and how heavy its tails are where it is what most residuals are of.

    Notes
    -----
    A probe fits quadrics in cells of two to sixteen spacings. All sizes tell the noise of places
    (see `local_noise`), the two finer ones that of the whole cloud, by the lower quartile of the
    residual variances RSS / (n - 10): edges and thin parts, which no quadric fits, are in the
    upper ones. Noise is the same in cells of both sizes; what grows with the cell is detail that
    the quadrics miss, and is taken off. Where the noise exceeds 0.15 of the finer cells, they cut
    its tails off, and larger ones are probed. Large clouds are sampled by whole boxes.
    """
    first_size = cell_size = _PROBE_SPACINGS * spacing
    first = left = _fit_probe(sample, cell_size, threads)
    tolerance = find_tolerance(left.kurtosis)  # larger cells leave detail, too
    for _ in range(_PROBE_ROUNDS):
        if left.quartile(0) <= (SHARE * cell_size) ** 2:
            break
        cell_size *= 2.0
        left = _fit_probe(sample, cell_size, threads)
    finer, coarser = left.quartile(0), left.quartile(1)
    variance = float(tell_noise(np.array(finer), np.array(coarser or finer)))
    is_noise = variance > max(_NOISE_SHARE * finer, (_ROUNDING * cell_size) ** 2)
    deviation = float(np.sqrt(variance))
    local = map_noise(deviation, spacing, first.origin, first_size, first.agreeing)
    return _Noise(local, tolerance if is_noise else np.inf)


def _fit_probe(cloud: PointCloud, cell_size: float, threads: int) -> _Probe:
    """Fit quadrics in cells of a size, of its double and so on."""
    low, high = bound_points(cloud.positions)
    height = count_levels(float((high - low).max()), cell_size)
    origin = lay_lattice(low, cell_size)
    pyramid = build_pyramid(cloud, origin, cell_size, height, threads)
    levels = list(pyramid.levels[: len(_PROBE_POINTS)])  # a fit drops the moments of its level
    weights = [Weights(_PROBE_LAM, 0.0, LEAST_MU, LEAST_MU)] * len(pyramid.levels)
    quadrics, _ = fit_levels(pyramid, weights, None, threads)
    residuals = [
        _take_residuals(level, vertices, fitted, points, cell_size * 2.0**depth)
        for depth, (level, vertices, fitted, points) in enumerate(
            zip(levels, pyramid.vertices, quadrics, _PROBE_POINTS, strict=False)
        )
    ]
    kurtosis = _find_kurtosis(levels[0], pyramid.vertices[0], quadrics[0])
    every, agreeing = map(list, zip(*residuals, strict=True))
    return _Probe(origin, every, agreeing, kurtosis)


def _find_kurtosis(level: Level, vertices: IntArray, quadrics: VertexQuadrics) -> float:
    """Return that of the points' distances from the blend of a level's quadrics."""
    points = level.points
    assert isinstance(points, SortedPoints)  # noqa: S101 - the finest level has points
    blend = vertices, quadrics.coefficients, np.ones(len(vertices), np.float32)
    squares = measure_points(level.cells, points, slice(0, len(level.cells)), 0, blend)
    return tell_kurtosis(squares, level.cells, points.offsets)


def _take_residuals(
    level: Level, vertices: IntArray, quadrics: VertexQuadrics, points: int, cell_size: float
) -> tuple[Residuals, Residuals]:
    """Return what fits leave over at the vertices with enough points, and where normals agree."""
    in_cells = level.points.sum(slice(0, len(level.cells)))
    touched = kernels.spread_keys(level.cells, 0, 1)
    moments = kernels.corner_moments(touched, level.cells, in_cells)
    rich = moments[:, 0] >= points
    touched, moments = touched[rich], moments[rich]
    rows = kernels.find_keys(vertices, touched)
    squares = kernels.evaluate_residuals(moments, quadrics.coefficients[rows])
    variances = cell_size**2 * squares / (moments[:, 0] - _FREE)
    agree = quadrics.misfits[rows] <= _AGREEING
    return Residuals(touched, variances), Residuals(touched[agree], variances[agree])


def choose_scale(
    measured: CloudMeasures, step: float, smoothness: float, detail: float, threads: int = 1
) -> Scale:
    """Choose the cell size, no smaller than the evaluation grid's step.

    The lattice must reach the nodes on both sides of the surface. `smoothness` multiplies the
    noise, `detail` divides the cell size.
    """
    spacing = measured.spacing
    noise = _probe(_leave_dense(measured), spacing, threads)
    averaged, spacings = _NOISE_CELLS * noise.local.whole * smoothness / detail, _FEWEST / detail
    cell_size = max(_SPACINGS / detail * spacing, averaged, step)
    dense, sparse = (measured.scale.quantile(share) for share in _SHARES)
    finest = max(spacings * dense, averaged, step)
    finer = _count_halvings(np.floor(np.log2(cell_size / finest)))
    coarser = _count_halvings(np.round(np.log2(_SPACINGS / detail * sparse / cell_size)))
    # Where scans of unlike noise meet, their residuals have heavy tails together.
    tolerance = np.inf if finer or coarser else noise.tolerance
    return Scale(spacing, noise.local, cell_size, tolerance, finer, coarser, spacings)


def _count_halvings(levels: np.floating[Any]) -> int:
    return int(np.clip(levels, 0, _MOST_LEVELS))


def suggest_grid(
    measured: CloudMeasures, longest: float, smoothness: float, detail: float, threads: int = 1
) -> Resolution:
    """Choose the evaluation grid: about as many vertices as points, fewer where noise is large.

    `longest` is the longest side of the box around all points; the grid has up to 4096 cells, in
    sixteens.

    Notes
    -----
    A step is 1/1.5 of the finest cells that `choose_scale` takes where no grid keeps it from that:
    the spacing of the points, or 1.7 standard deviations of the noise. Smaller steps show the same
    quadrics by more triangles. Up to 256 cells, which cost little, it is 3/4 of that.
    """
    scale = choose_scale(measured, 0.0, smoothness, detail, threads)
    step = scale.finest / _SPACINGS
    if step * MAX_GRID < longest:
        return Resolution(MAX_GRID, f"the most; the points lie {scale.spacing:.3g} apart")
    coarse, fine = (_count_cells(longest, some) for some in (step, _SMOOTHER * step))
    cells = max(coarse, min(fine, _CHEAP))
    is_noisy = scale.cell_size > _SPACINGS * scale.spacing
    what = f"noise of {scale.noise.whole:.3g}" if is_noisy else f"points {scale.spacing:.3g} apart"
    if scale.finer:
        what = f"points {measured.scale.range[0]:.3g} to {measured.scale.range[1]:.3g} apart"
    step = longest / (cells - 2 * MARGIN)
    return Resolution(min(cells, MAX_GRID), f"steps of {step:.3g} for {what}")


def suited_steps(refinement: Refinement, places: FloatArray) -> FloatArray:
    """Return the steps (n,) of grids that show what points tell at places (n, 3).

    They follow from spacing, noise and the detail that was asked for; see `suggest_grid`.
    """
    noise = np.sqrt(refinement.noise.variances_at(places))
    steps = np.maximum(refinement.scale.at(places), _NOISE_CELLS / _SPACINGS * noise)
    told: FloatArray = steps * refinement.spacings / _FEWEST
    return told


def _count_cells(longest: float, step: float) -> int:
    """Return how many cells of about a step lie along the longest side, margins included."""
    return _SIXTEEN * int(np.ceil((longest / step + 2 * MARGIN) / _SIXTEEN - _EXACT))
