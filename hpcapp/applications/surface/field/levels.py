"""From moments to the levels of a field: fitted, and each quadric trusted as far as it deserves.

::

    levels from 1 up ── fitted as a whole ──> trust
         │ parents
    level 0 ── fitted for a slab of the grid, some layers of vertices at a time ──> trust

The finest level has most of the vertices, a hundred bytes for each point, and what a fit takes
beside its result is twice as much as that. Keys sort by x first: a slab of the grid across x, and
some layers of vertices in it, ask for one run of cells and of parents.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.field.cell_points import SortedPoints
from hpcapp.applications.surface.field.features import (
    find_features,
    find_features_above,
    join_features,
)
from hpcapp.applications.surface.field.pyramid import (
    Level,
    Parents,
    Pyramid,
    VertexQuadrics,
    fit_levels,
)
from hpcapp.applications.surface.field.support import crowd_vertices
from hpcapp.applications.surface.field.weights import Weights, trust_vertices
from hpcapp.geometry.lattice import (
    ancestor_keys,
    find_keys,
    find_layers,
    pack_places,
    unique_keys,
    unpack_keys,
)
from hpcapp.geometry.points import BoolArray, Float32Array, FloatArray, IntArray
from hpcapp.kernels import BASIS
from hpcapp.kernels.parallel import run_batches
from hpcapp.kernels.types.field import FarField, Features, Field, FieldLevel
from hpcapp.kernels.types.grid import BRICK, Grid
from hpccomponent.cutting import cut_equal
from hpccomponent.dataclass import dataclass

_AT_ONCE = 1 << 15  # vertices of the finest level, in a thread
# Of bricks in a slab, for each layer that may be evaluated beside it on either side.
_LEAST_LAYERS = 8
_TRUST_ROWS = 1 << 16


def fit_above(
    pyramid: Pyramid,
    weights: list[Weights],
    parents: Parents | None,
    far: FarField,
    threads: int = 1,
) -> tuple[tuple[FieldLevel, ...], tuple[Features, ...], Parents | None]:
    """Fit every level but the finest, and tell how far each quadric is to be trusted.

    What is above level 0 is taken out of `pyramid`: nobody asks for it any more. Return the levels,
    finest first, the features of those that are somewhere the finest, and what level 0 asks for.
    """
    quadrics, parents = fit_levels(pyramid, weights, parents, threads, lowest=1)
    levels, vertices = pyramid.levels, pyramid.vertices
    above = replace(pyramid, levels=levels[1:], vertices=vertices[1:], first=1)
    coarser = find_trust(above, quadrics, far, threads)
    features = _find_features_above(pyramid, quadrics, weights, threads)
    del levels[1:], vertices[1:]
    return coarser, features, parents


def _find_features_above(
    pyramid: Pyramid, quadrics: list[VertexQuadrics], weights: list[Weights], threads: int
) -> tuple[Features, ...]:
    """Find the edges and corners of those levels above the finest that have leaves."""
    finest, features = pyramid.levels[0], []
    for depth in range(1, pyramid.refinement.levels + 1):
        vertices, cells = pyramid.vertices[depth], pyramid.levels[depth].cells
        rows = np.flatnonzero(pyramid.refinement.mark_finest(vertices, cells, depth))
        assert isinstance(finest.points, SortedPoints)  # noqa: S101 - the finest level has points
        of_leaves = vertices[rows], quadrics[depth - 1].misfits[rows], weights[depth].noise
        features.append(
            find_features_above(*of_leaves, depth, finest.cells, finest.points, threads)
        )
    return tuple(features)


@dataclass(frozen=True, slots=True, eq=False)
class SlabFields:
    """The field, whose finest level is fitted for a slab of the grid at a time.

    The only level of the `pyramid` is 0, or none where that has no vertices; `weights` are of every
    level, `parents` of level 1, where there is one. `above` are all coarser levels, finest first,
    and `features_above` those of the first of these.
    """

    pyramid: Pyramid
    weights: list[Weights]
    parents: Parents | None
    above: tuple[FieldLevel, ...]
    features_above: tuple[Features, ...]
    far: FarField
    grid: Grid
    threads: int = 1

    def let_go(self) -> None:
        """Take points and corners out of the pyramid, whoever else holds it: no more is fitted."""
        self.pyramid.levels.clear()
        self.pyramid.vertices.clear()

    def mark_supported(self, places: FloatArray) -> BoolArray:
        """Tell which places (n, 3), in length units, have points in their base cell, (n,)."""
        if not self.pyramid.levels:
            return np.zeros(len(places), np.bool_)
        below = self.pyramid.refinement.levels
        cells = self.pyramid.levels[0].cells
        if below:
            cells = unique_keys(ancestor_keys(cells, below))
        size = self.pyramid.cell_size * 2.0**below
        inside = np.floor((places - self.pyramid.origin) / size)
        supported: BoolArray = find_keys(cells, pack_places(inside.astype(np.int64))) < len(cells)
        return supported

    def cut(self, first: int, end: int, quadrics: int, least: int = 1) -> list[int]:
        """Cut layers of bricks along x, `first` to before `end`, into slabs; return their bounds.

        A slab has about so many `quadrics` of the finest level, or fewer, and 8 layers or more, on
        average; where there are layers enough, there are `least` slabs or more.
        """
        vertices, grid = self.pyramid.vertices[0], self.grid
        most = max(1, (end - first) // (_LEAST_LAYERS * grid.rim))
        count = min(max(-(-len(vertices) // quadrics), least), most)
        rows = np.arange(1, count) * len(vertices) // max(count, 1)
        # (s - 1,): x of the vertices between equal runs of these, and the layers of bricks there.
        corners = self.pyramid.cell_size * unpack_keys(vertices[rows])[:, 0]
        shift = self.pyramid.origin[0] - grid.origin[0]
        cuts = np.floor((corners + shift) / (BRICK * grid.step)).astype(np.int64)
        bounds: list[int] = unique_keys(np.clip([first, *cuts, end], first, end)).tolist()
        return bounds

    def fit(self, first: int, end: int) -> Field:
        """Return the field of layers of bricks, from `first` to before `end`."""
        pyramid, grid = self.pyramid, self.grid
        nodes = BRICK * np.array([first, end]) * grid.step
        places = (grid.origin[0] + nodes - pyramid.origin[0]) / pyramid.cell_size
        # The layers of vertices around all nodes between the two planes.
        low, high = int(np.floor(places[0])), int(np.floor(places[1])) + 1
        vertices = pyramid.vertices[0]
        part = replace(pyramid, vertices=[vertices[find_layers(vertices, low, high)]])
        finest, features = _fit_finest(part, self.weights, self.parents, self.far, self.threads)
        levels = (finest, *self.above)
        all_features = (features, *self.features_above)
        return Field(pyramid.origin, pyramid.cell_size, levels, self.far, all_features)


def _fit_finest(
    pyramid: Pyramid,
    weights: list[Weights],
    parents: Parents | None,
    far: FarField,
    threads: int = 1,
) -> tuple[FieldLevel, Features]:
    """Fit the finest level, some layers of vertices at a time; `parents` are those of level 1."""
    vertices = pyramid.vertices[0]
    coefficients = np.empty((len(vertices), BASIS), np.float32)
    trust = np.empty(len(vertices), np.float32)

    def fit(rows: slice) -> Features:
        finest = pyramid.levels[0]
        points = finest.points
        assert isinstance(points, SortedPoints)  # noqa: S101 - the finest level has points
        # The cells around some layers of vertices, and the parents of these, are runs too.
        low, high = unpack_keys(vertices[[rows.start, rows.stop - 1]])[:, 0].tolist()
        run = find_layers(finest.cells, low - 1, high)
        level = Level(finest.cells[run], points.run(run), finest.squares)
        part = replace(pyramid, levels=[level], vertices=[vertices[rows]])
        near = parents and parents.between(low // 2, -(-high // 2))
        quadrics, _ = fit_levels(part, weights, near)
        (fitted,) = find_trust(part, quadrics, far)
        coefficients[rows], trust[rows] = fitted.coefficients, fitted.trust
        of_run = vertices[rows], quadrics[0].misfits, weights[0].noise
        return find_features(*of_run, finest.cells, points)

    features = run_batches(fit, _cut_layers(vertices), threads)
    return FieldLevel(vertices, coefficients, trust), join_features(features)


def find_trust(
    pyramid: Pyramid, quadrics: list[VertexQuadrics], far: FarField, threads: int = 1
) -> tuple[FieldLevel, ...]:
    """Tell how far each quadric of some levels is to be trusted (see `weights`).

    `quadrics` are those of the finest of these levels.
    """
    levels = []
    for index, of_level in enumerate(quadrics):
        level, keys, depth = pyramid.levels[index], pyramid.vertices[index], pyramid.first + index
        is_finest = pyramid.refinement.mark_finest(keys, level.cells, depth)
        crowds = np.zeros(len(keys))
        if depth:
            # Where points are dense, coarse quadrics reach as far as they do elsewhere: else the
            # far field, which is no finer there, would begin beside the surface.
            squares = level.squares
            if pyramid.refinement.levels:
                squares = squares * pyramid.refinement.thin(level.cells, depth)
            of_all = crowd_vertices(keys, of_level.counts, level.cells, squares)
            crowds = np.where(is_finest, 0.0, of_all)
        origin = (pyramid.origin - far.origin) / far.step
        spacing = pyramid.cell_size * 2.0**depth / far.step
        given = keys, of_level, crowds, is_finest, (far.values, origin, spacing, far.step)
        rows = cut_equal(len(keys), -(-len(keys) // _TRUST_ROWS))
        parts = run_batches(partial(_trust_rows, *given), rows, threads)
        trust = np.concatenate([np.empty(0, np.float32), *parts])
        levels.append(FieldLevel(keys, of_level.coefficients, trust))
    return tuple(levels)


def _trust_rows(
    keys: IntArray,
    quadrics: VertexQuadrics,
    crowds: FloatArray,
    is_finest: BoolArray,
    far: tuple[Float32Array, FloatArray, float, float],
    rows: slice,
) -> Float32Array:
    """Trust some vertices of a level; `far` is a grid with its origin, spacing and step."""
    values, origin, spacing, step = far
    distances = kernels.sample_corners(values, keys[rows], origin, spacing) / step
    return trust_vertices(
        quadrics.coefficients[rows, 0], distances, quadrics.counts[rows],
        quadrics.inherited[rows], crowds[rows], is_finest[rows],
    )  # fmt: skip


def _cut_layers(vertices: IntArray) -> list[slice]:
    """Cut sorted vertices into about equal runs of whole layers."""
    bounds = [0]
    for piece in cut_equal(len(vertices), -(-len(vertices) // _AT_ONCE))[:-1]:
        layer = int(unpack_keys(vertices[[piece.stop]])[0, 0])
        start = find_layers(vertices, layer, layer).start
        if start > bounds[-1]:
            bounds.append(start)
    return [slice(*run) for run in pairwise([*bounds, len(vertices)]) if len(vertices)]
