"""The pyramid of lattices under a cloud: cells with moments, vertices with quadrics.

::

    points of level 0 --moments, sums of eight--> level 1 ... level L
                                                                |
    quadrics of level 0 <--prior-- level 1 <--prior-- ... <-- fits of level L
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface.cell_points import (
    CellMoments,
    SortedPoints,
    merge_finest,
    sort_cloud,
)
from hpcapp.applications.surface.crowding import sum_squares, surrounded_vertices
from hpcapp.applications.surface.method import Advance
from hpcapp.applications.surface.weights import FIELD_LEVELS, Weights, localise_noise
from hpcapp.batches import Workforce, cut_equal, map_batches
from hpccomponent.surface import kernels
from hpccomponent.surface.hermite import BASIS
from hpccomponent.surface.lattice import BITS, OCTANTS, step_keys
from hpccomponent.surface.moments import COLUMNS
from hpccomponent.surface.points import FloatArray, IntArray, PointCloud, bounding_box

__all__ = [
    "Level",
    "Pyramid",
    "VertexQuadrics",
    "build_pyramid",
    "fit_levels",
]

Float32Array = NDArray[np.float32]

_COARSEST_CELLS = 6
# Corners in a batch: what it takes stays in the cache, and memory that was freed is used again.
_LEAST_BATCH, _MOST_BATCH = 1 << 12, 1 << 16
_LAYERS = 2  # of corners in a batch at least: the cells on both sides of its ends are summed twice
_FINER_UNITS = np.float32(4.0)  # the same variance, in cells of the next finer level squared
_LOCAL_FROM = 2  # levels further up, which tell a vertex the noise around it
# What a point counts one level further up, where the surface is 4 times larger.
_ANCESTORS = np.float32(0.25)


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """One lattice of the pyramid.

    Parameters
    ----------
    cells : ndarray of int64, shape (c,)
        Sorted keys of the occupied cells.
    points : SortedPoints or CellMoments
        What the fits know of the points in each cell: those of the finest level themselves.
    touched : ndarray of int64, shape (t,)
        Sorted keys of the corners of the occupied cells: what is fitted.
    vertices : ndarray of int64, shape (v,)
        Sorted keys of these, and of what else carries a quadric, its parents'.
    squares : ndarray of float64, shape (c,)
        Sums of the squared counts of each cell's children; none at the finest level.
    """

    cells: IntArray
    points: SortedPoints | CellMoments
    touched: IntArray
    vertices: IntArray
    squares: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Pyramid:
    """Lattices from the finest (level 0) to the coarsest.

    Parameters
    ----------
    origin : ndarray of float64, shape (3,)
        Where corner (0, 0, 0) of every level lies.
    cell_size : float
        Edge of the finest cells, in length units of the input.
    levels : list of Level
        `fit_levels` takes the points out of each as it goes: they are most of the memory.
    """

    origin: FloatArray
    cell_size: float
    levels: list[Level]


@dataclass(frozen=True, slots=True, eq=False)
class VertexQuadrics:
    """The quadrics of one level.

    Parameters
    ----------
    coefficients : ndarray of float32, shape (v, 10)
    counts : ndarray of float32, shape (v,)
        Points in the eight cells around each vertex.
    inherited : ndarray of float32, shape (v,)
        The mean count of its parents, 0 for those that points do not surround (see `crowding`),
        plus a quarter of what these inherited.
    variances : ndarray of float32, shape (v, 3)
        What the fits leave over (see `hermite.residual_variances`), in cells squared: its own, the
        mean of its parents' and of theirs. Where points are few, its own is the parents'.
    """

    coefficients: Float32Array
    counts: Float32Array
    inherited: Float32Array
    variances: Float32Array


def build_pyramid(cloud: PointCloud, cell_size: float, workforce: Workforce) -> Pyramid:
    """Sort the points into the finest cells, and sum their moments over all coarser ones.

    Parameters
    ----------
    cloud : PointCloud
        With normals.
    cell_size : float
        Edge of the finest cells, in length units of the input.
    workforce : Workforce

    Returns
    -------
    Pyramid
        With floor(log2(longest side / cell_size / 6)) levels above the finest.
    """
    low, high = bounding_box(cloud.positions)
    longest = float((high - low).max())
    coarser = max(0, int(np.floor(np.log2(longest / cell_size / _COARSEST_CELLS))))
    cells, points = sort_cloud(cloud, low, cell_size)
    vertices = kernels.spread_keys(cells, -1, 2)
    levels = [Level(cells, points, kernels.spread_keys(cells, 0, 1), vertices, np.empty(0))]
    for above in range(1, coarser + 1):
        finer = levels[-1]
        if above == 1:
            cells, moments = merge_finest(cells, points, workforce)
        else:
            cells, moments = kernels.merge_cells(cells, moments)
        squares = sum_squares(finer.cells, finer.points.counts, cells)
        touched = kernels.spread_keys(cells, 0, 1)
        vertices = kernels.unite_keys(touched, kernels.parent_keys(vertices))
        levels.append(Level(cells, CellMoments(moments), touched, vertices, squares))
    return Pyramid(low, cell_size, levels)


def fit_levels(
    pyramid: Pyramid,
    weights: list[Weights],
    workforce: Workforce,
    advance: Advance | None = None,
) -> list[VertexQuadrics]:
    """Fit every level, from the coarsest to the finest, each with the one above as prior.

    Parameters
    ----------
    pyramid : Pyramid
    weights : list of Weights
        Of each level, finest first.
    workforce : Workforce
    advance : callable, optional
        Told (vertices fitted, vertices in all) after each level.

    Returns
    -------
    list of VertexQuadrics
        Of the finest levels, as many as a field is made of, finest first.
    """
    kept: list[VertexQuadrics] = []
    total = sum(len(level.touched) for level in pyramid.levels)
    done = 0
    above: tuple[Level, VertexQuadrics] | None = None
    for index in reversed(range(len(pyramid.levels))):
        level = pyramid.levels[index]
        quadrics = _inherit_level(level, above)
        rows = kernels.find_keys(level.vertices, level.touched)
        local = index < len(pyramid.levels) - _LOCAL_FROM
        noise = _find_noise(weights[index].noise, quadrics.variances[rows], local)
        cuts = _cut_corners(level.touched, workforce)
        at_once = len(workforce.cut(len(rows)))
        for first in range(0, len(cuts), at_once):
            wave = cuts[first : first + at_once]
            _fit_wave(level, wave, rows, quadrics, noise, weights[index], workforce)
        pyramid.levels[index] = level = replace(level, points=CellMoments(np.empty((0, COLUMNS))))
        above = (level, quadrics)
        kept = [quadrics, *kept][:FIELD_LEVELS]
        done += len(rows)
        if advance is not None:
            advance(done, total)
    return kept


def _inherit_level(level: Level, above: tuple[Level, VertexQuadrics] | None) -> VertexQuadrics:
    """Return the means of the parents' quadrics, support and variances; zeros at the coarsest."""
    vertices = len(level.vertices)
    none = np.zeros(vertices, np.float32)
    if above is None:
        coefficients, variances = (np.zeros((vertices, k), np.float32) for k in (BASIS, 3))
        return VertexQuadrics(coefficients, none, none.copy(), variances)
    parent_level, parents = above
    surrounded = surrounded_vertices(parent_level.vertices, parent_level.cells)
    support = parents.counts * surrounded + _ANCESTORS * parents.inherited
    values = np.column_stack((support, _FINER_UNITS * parents.variances[:, :2]))
    means, inherited = kernels.inherit_level(
        level.vertices, parent_level.vertices, parents.coefficients, values
    )
    return VertexQuadrics(means, none, inherited[:, 0].copy(), inherited[:, [1, 1, 2]])


def _find_noise(overall: float, variances: Float32Array, local: bool) -> Float32Array:
    """Return the noise at some vertices, told locally where there are two levels further up."""
    if local:
        return localise_noise(overall, variances[:, 1], variances[:, 2])
    return np.full(len(variances), overall, np.float32)


def _cut_corners(touched: IntArray, workforce: Workforce) -> list[slice]:
    """Cut the corners of a level into batches: small ones, but not of less than two layers."""
    layers = int((touched[-1] >> 2 * BITS) - (touched[0] >> 2 * BITS)) + 1
    wanted = max(_LAYERS * len(touched) // layers, _LEAST_BATCH)
    batches = -(-len(touched) // min(wanted, _MOST_BATCH))
    return cut_equal(len(touched), max(batches, len(workforce.cut(len(touched)))))


def _fit_wave(
    level: Level,
    cuts: list[slice],
    rows: IntArray,
    quadrics: VertexQuadrics,
    noise: Float32Array,
    weights: Weights,
    workforce: Workforce,
) -> None:
    """Fit some runs of corners on the workers; `rows` says where they stand in `quadrics`."""
    batches = [
        _fit_batch(level, cut, quadrics.coefficients[rows[cut]], noise[cut], weights)
        for cut in cuts
    ]
    fitted = map_batches(workforce, level.points.fit, batches)
    for cut, (coefficients, counts, variances) in zip(cuts, fitted, strict=True):
        quadrics.coefficients[rows[cut]] = coefficients
        quadrics.counts[rows[cut]] = counts
        known = ~np.isnan(variances)
        quadrics.variances[rows[cut][known], 0] = variances[known]


def _fit_batch(
    level: Level, cut: slice, prior: Float32Array, noise: Float32Array, weights: Weights
) -> tuple[NDArray[Any] | float, ...]:
    """Return the arguments of a fit: some corners, and a run of cells with all around them."""
    touched = level.touched[cut]
    first = step_keys(touched[0], -OCTANTS[-1])
    bounds = np.searchsorted(level.cells, (first, touched[-1] + 1))
    near = slice(int(bounds[0]), int(bounds[1]))
    points = (touched, level.cells[near], *level.points.cut(near))
    return *points, prior, noise, weights.lam, weights.least_mu, weights.most_mu
