"""The pyramid of lattices under a cloud: cells with moments, vertices with quadrics.

::

    points of level 0 --moments, sums of eight--> level 1 ... level L
                                                                |
    quadrics of level 0 <--prior-- level 1 <--prior-- ... <-- fits of level L
"""

from __future__ import annotations

from dataclasses import field, replace

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.field.cell_points import (
    CellMoments,
    PartMoments,
    SortedPoints,
    merge_parents,
    sort_cloud,
)
from hpcapp.applications.surface.field.refinement import Refinement
from hpcapp.applications.surface.field.robust import weigh_points
from hpcapp.applications.surface.field.support import sum_squares, surrounded_vertices
from hpcapp.applications.surface.field.weights import (
    CHANCE_SHARE,
    FIELD_LEVELS,
    Weights,
    find_agreement,
    localise_noise,
)
from hpcapp.geometry.lattice import BITS, OCTANTS, find_layers, step_keys
from hpcapp.geometry.points import BoolArray, Float32Array, FloatArray, IntArray, PointCloud
from hpcapp.kernels import BASIS
from hpcapp.kernels.parallel import run_batches
from hpccomponent.cutting import cut_equal
from hpccomponent.dataclass import dataclass
from hpccomponent.protocol.records import record

_COARSEST_CELLS = 6
_EXACT = 1e-6  # of a level: powers of two have theirs
# Corners in a batch: what it takes stays in the cache, and memory that was freed is used again.
_LEAST_BATCH, _MOST_BATCH = 1 << 12, 1 << 16
_LAYERS = 2  # of corners in a batch at least: the cells on both sides of its ends are summed twice
_FINER_UNITS = np.float32(4.0)  # the same variance, in cells of the next finer level squared
_LOCAL_FROM = 2  # levels further up, which tell a vertex the noise around it
# What a point counts one level further up, where the surface is 4 times larger.
_ANCESTORS = np.float32(0.25)
_DETAIL = np.float32(0.25)  # of what fits leave over: where they miss shape, points are right


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """One lattice of the pyramid: sorted keys of the occupied cells, (c,).

    Of the points in each is what the fits know: those of the finest level themselves. `squares`
    (c,) sums the squared counts of each cell's children; none at the finest level.
    """

    cells: IntArray
    points: SortedPoints | CellMoments | PartMoments
    squares: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Pyramid:
    """Lattices from a finer to a coarser one; `height` levels has the whole cloud, from level 0 on.

    Corner (0, 0, 0) of every level lies at `origin` (3,), and the cells of level 0 are of
    `cell_size`. The first of the `levels` is level `first`; `fit_levels` takes the points out of
    each as it goes, for they are most of the memory. Of each level `vertices` has the sorted keys
    of the corners that carry a quadric (see `lay_vertices`). The `refinement` is of the whole
    cloud's lattice.
    """

    origin: FloatArray
    cell_size: float
    levels: list[Level]
    vertices: list[IntArray]
    first: int
    height: int
    refinement: Refinement = field(default_factory=Refinement.none)


@dataclass(frozen=True, slots=True, eq=False)
class VertexQuadrics:
    """The quadrics of one level.

    Parameters
    ----------
    coefficients : ndarray of float32, shape (v, 10)
    counts : ndarray of float32, shape (v,)
        Points in the eight cells around each vertex; where there are finer ones, as far as the
        quadric agrees with their normals.
    inherited : ndarray of float32, shape (v,)
        The mean count of its parents, 0 for those that points do not surround (see
        `crowd_vertices`), plus a quarter of what these inherited.
    variances : ndarray of float32, shape (v, 3)
        What the fits leave over (see `hermite.residual_variances`), in cells squared: its own, the
        mean of its parents' and of theirs. Where points are few, its own is the parents'.
    misfits : ndarray of float32, shape (v,)
        How far its gradients are off the points' normals (see `hermite.evaluate_misfits`), 0
        where there are no points.
    """

    coefficients: Float32Array
    counts: Float32Array
    inherited: Float32Array
    variances: Float32Array
    misfits: Float32Array


@record("surface.parents")
@dataclass(frozen=True, slots=True, eq=False)
class Parents:
    """What the vertices of the next finer level take from a level: v of them, sorted by key.

    The `support` (v,) is the count of each vertex, 0 where points do not surround it, plus a
    quarter of what it inherited; `variances` (v, 2) are its own, and the mean of its parents', in
    cells of this level squared.
    """

    keys: IntArray
    coefficients: Float32Array
    support: Float32Array
    variances: Float32Array

    def between(self, first: int, last: int) -> Parents:
        """Return those whose x, in cells, is in a range with both ends; nothing is copied."""
        run = find_layers(self.keys, first, last)
        return Parents(
            self.keys[run], self.coefficients[run], self.support[run], self.variances[run]
        )


def count_levels(longest: float, cell_size: float) -> int:
    """Return how many levels a cloud has: floor(log2(longest side / cell_size / 6)) + 1, or 1."""
    return 1 + max(0, int(np.floor(np.log2(longest / cell_size / _COARSEST_CELLS) + _EXACT)))


def build_pyramid(
    cloud: PointCloud,
    origin: FloatArray,
    cell_size: float,
    height: int,
    threads: int = 1,
    refinement: Refinement | None = None,
) -> Pyramid:
    """Sort the points into the finest cells, and sum their moments over all coarser ones.

    The points have normals; corner (0, 0, 0) of every level lies at `origin` (3,), and the finest
    cells are of `cell_size`; for `height` see `count_levels`.
    """
    refinement = Refinement.none() if refinement is None else refinement
    finest = Level(*sort_cloud(cloud, origin, cell_size), np.empty(0))
    levels = raise_levels(finest, height, threads)
    below = refinement.levels
    base = kernels.spread_keys(levels[below].cells, -1, 2)
    *finer, base = refinement.lay([level.cells for level in levels[:below]], base)
    vertices = [*finer, *lay_vertices(base, height - below)]
    return Pyramid(origin, cell_size, levels, vertices, 0, height, refinement)


def raise_levels(finest: Level, levels: int, threads: int = 1) -> list[Level]:
    """Return a level and coarser ones upon it, finest first: `levels` of them."""
    raised = [finest]
    while len(raised) < levels:
        finer = raised[-1]
        cells, moments = merge_parents(finer.cells, finer.points, threads)
        squares = sum_squares(finer.cells, finer.points.counts, cells)
        raised.append(Level(cells, moments, squares))
    return raised


def lay_vertices(finest: IntArray, levels: int) -> list[IntArray]:
    """Return the corners that carry quadrics, level by level: some, and all their ancestors.

    The finest (v,) are sorted keys. Among the ancestors of the corners of cells are all corners of
    the coarser cells.
    """
    vertices = [finest]
    while len(vertices) < levels:
        vertices.append(kernels.parent_keys(vertices[-1]))
    return vertices


def fit_levels(
    pyramid: Pyramid,
    weights: list[Weights],
    parents: Parents | None = None,
    threads: int = 1,
    lowest: int = 0,
) -> tuple[list[VertexQuadrics], Parents | None]:
    """Fit every level, from the coarsest to the finest, each with the one above as prior.

    `pyramid` may lack vertices that nobody asks for, but no parent of one that is there. `weights`
    are of each level of the whole cloud, finest first, `parents` of the level above the coarsest of
    `pyramid`, where there is one. The `lowest` finest levels are left as they are.

    Return the quadrics of the fitted levels that a field is made of, finest first, and what the
    level below the finest of these takes from it; None where there is no such.
    """
    kept: list[VertexQuadrics] = []
    for index in reversed(range(lowest, len(pyramid.levels))):
        cells, vertices = pyramid.levels[index].cells, pyramid.vertices[index]
        depth = pyramid.first + index
        quadrics = _inherit_level(vertices, parents, threads)
        # (t,): the corners of the occupied cells, and where they stand among the vertices.
        touched = kernels.spread_keys(cells, 0, 1)
        rows = kernels.find_keys(vertices, touched, threads)
        asked = rows < len(vertices)
        if not asked.all():
            touched, rows = touched[asked], rows[asked]
        # (t,): the variance of the points around each, in cells squared, which tells how far off a
        # prior is only by chance.
        local = depth < pyramid.height - _LOCAL_FROM
        variances = pyramid.refinement.noise_around(touched, depth)
        lam = weights[depth].weigh_normals(variances)
        noise = _find_noise(CHANCE_SHARE * variances, quadrics.variances[rows], local)
        is_finest = pyramid.refinement.mark_finest(touched, cells, depth)
        arguments = touched, rows, quadrics, noise, lam, weights[depth], is_finest, threads
        if depth == 1 and index == 1 and np.isfinite(weights[1].tolerance):
            _fit_weighed(pyramid, *arguments)
        else:
            _fit_level(pyramid.levels[index], *arguments)
        _drop_points(pyramid, index)
        parents = _offer_level(vertices, cells, quadrics) if depth else None
        if depth < pyramid.refinement.levels + FIELD_LEVELS:
            kept.insert(0, quadrics)
    return kept, parents


def _drop_points(pyramid: Pyramid, index: int) -> None:
    """Take what a level knows of its points out of memory."""
    pyramid.levels[index] = replace(pyramid.levels[index], points=CellMoments([]))


def _inherit_level(vertices: IntArray, parents: Parents | None, threads: int) -> VertexQuadrics:
    """Return the means of the parents' quadrics, support and variances; zeros at the coarsest."""
    none = np.zeros(len(vertices), np.float32)
    if parents is None:
        coefficients, variances = (np.zeros((len(vertices), k), np.float32) for k in (BASIS, 3))
        return VertexQuadrics(coefficients, none, none.copy(), variances, none.copy())
    # (p, 3): averaged as the quadrics are.
    values = np.column_stack((parents.support, _FINER_UNITS * parents.variances))
    given = vertices, parents.keys, parents.coefficients, values
    means, inherited = kernels.inherit_level(*given, threads)
    support, variances = inherited[:, 0].copy(), inherited[:, [1, 1, 2]]
    return VertexQuadrics(means, none, support, variances, none.copy())


def _offer_level(vertices: IntArray, cells: IntArray, quadrics: VertexQuadrics) -> Parents:
    """Return what the next finer level takes from a level that is fitted."""
    surrounded = surrounded_vertices(vertices, cells)
    support = quadrics.counts * surrounded + _ANCESTORS * quadrics.inherited
    return Parents(vertices, quadrics.coefficients, support, quadrics.variances[:, :2])


def _find_noise(overall: FloatArray, variances: Float32Array, local: bool) -> Float32Array:
    """Return the noise at some vertices, told locally where there are two levels further up."""
    if local:
        return localise_noise(overall, variances[:, 1], variances[:, 2])
    return overall.astype(np.float32)


def _fit_level(
    level: Level,
    corners: IntArray,
    rows: IntArray,
    quadrics: VertexQuadrics,
    noise: Float32Array,
    lam: Float32Array,
    weights: Weights,
    is_finest: BoolArray,
    threads: int,
) -> None:
    """Fit the corners of a level's cells; `rows` says where they stand in `quadrics`."""

    def fit(cut: slice) -> None:
        touched, at = corners[cut], rows[cut]
        # The run of cells that these corners touch: keys sort by x first.
        first = step_keys(touched[0], -OCTANTS[-1])
        bounds = np.searchsorted(level.cells, (first, touched[-1] + 1))
        near = slice(int(bounds[0]), int(bounds[1]))
        coefficients, counts, variances, misfits = kernels.fit_corners(
            touched, level.cells[near], level.points.sum(near),
            quadrics.coefficients.take(at, axis=0),
            noise[cut], lam[cut], weights.least_mu, weights.most_mu,
        )  # fmt: skip
        quadrics.coefficients[at] = coefficients
        quadrics.misfits[at] = misfits
        # (b,): a quadric that no finer one replaces is supported by all of its points.
        agreeing = np.where(is_finest[cut], counts, counts * find_agreement(misfits))
        quadrics.counts[at] = agreeing
        known = ~np.isnan(variances)  # where points are many; elsewhere the parents' stand
        quadrics.variances[at[known], 0] = variances[known]

    if len(rows):
        run_batches(fit, _cut_corners(corners, threads), threads)


def _fit_weighed(
    pyramid: Pyramid,
    corners: IntArray,
    rows: IntArray,
    quadrics: VertexQuadrics,
    noise: Float32Array,
    lam: Float32Array,
    weights: Weights,
    is_finest: BoolArray,
    threads: int,
) -> None:
    """Fit the level above the finest, weigh the points of both by that, and fit it again.

    Counts and variances stay those of points that count alike.
    """
    finest = pyramid.levels[0]
    assert isinstance(finest.points, SortedPoints)  # noqa: S101 - the finest level has points
    # A first fit, over the parents' quadrics, which stay the prior of the second one.
    first = replace(quadrics, coefficients=quadrics.coefficients.copy())
    _fit_level(pyramid.levels[1], corners, rows, first, noise, lam, weights, is_finest, threads)
    _drop_points(pyramid, 1)  # before they are summed anew
    counts, variances = first.counts.copy(), first.variances.copy()
    # (t,): what a point may be off, of which a part is the noise, and a part missed detail.
    spread = np.maximum(noise, _DETAIL * variances[rows, 0])
    blend = corners, first.coefficients.take(rows, axis=0), spread
    points = weigh_points(finest.cells, finest.points, blend, weights.tolerance, threads)
    pyramid.levels[0] = replace(finest, points=points)
    moments = merge_parents(finest.cells, points, threads)[1]
    weighed = replace(pyramid.levels[1], points=moments)
    _fit_level(weighed, corners, rows, quadrics, noise, lam, weights, is_finest, threads)
    quadrics.counts[:], quadrics.variances[:] = counts, variances


def _cut_corners(touched: IntArray, threads: int) -> list[slice]:
    """Cut the corners of a level into batches: small ones, but not of less than two layers."""
    # How many layers of corners there are along x, which comes first in a key.
    layers = int((touched[-1] >> 2 * BITS) - (touched[0] >> 2 * BITS)) + 1
    wanted = max(_LAYERS * len(touched) // layers, _LEAST_BATCH)
    batches = -(-len(touched) // min(wanted, _MOST_BATCH))
    return cut_equal(len(touched), max(batches, threads))
