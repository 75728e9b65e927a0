"""The pyramid of lattices under a cloud: cells with moments, vertices with quadrics.

::

    points --cells--> moments of level 0 --sums of eight--> level 1 ... level L
                                                                        |
    quadrics of level 0 <--prior-- level 1 <--prior-- ... <--prior-- fits of level L
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hpcapp.applications.surface.method import Advance
from hpcapp.batches import Workforce, map_batches
from hpccomponent.surface.hermite import BASIS, fit_vertices, inherit_quadrics
from hpccomponent.surface.lattice import (
    OCTANTS,
    cells_of,
    corner_parents,
    find_keys,
    pack_places,
    spread_keys,
    step_keys,
    unique_keys,
    unpack_keys,
)
from hpccomponent.surface.moments import accumulate_moments, scale_moments, shift_moments
from hpccomponent.surface.points import FloatArray, IntArray, PointCloud, bounding_box

__all__ = ["Level", "Pyramid", "VertexQuadrics", "build_pyramid", "corner_moments", "fit_pyramid"]

_COARSEST_CELLS = 6
_ANCESTORS = 0.25  # what a point counts one level further up, where the surface is 4 times larger


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """One lattice of the pyramid.

    Parameters
    ----------
    cells : ndarray of int64, shape (c,)
        Sorted keys of the occupied cells.
    moments : ndarray of float64, shape (c, 44)
        Of each cell, about its centre, in its own units.
    touched : ndarray of int64, shape (t,)
        Sorted keys of the corners of the occupied cells: what is fitted.
    vertices : ndarray of int64, shape (v,)
        Sorted keys of these, and of what else carries a quadric, its parents'.
    """

    cells: IntArray
    moments: FloatArray
    touched: IntArray
    vertices: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Pyramid:
    """Lattices from the finest (level 0) to the coarsest.

    Parameters
    ----------
    origin : ndarray of float64, shape (3,)
        Where corner (0, 0, 0) of every level lies.
    cell_size : float
        Edge of the finest cells, in length units of the input.
    levels : tuple of Level
    """

    origin: FloatArray
    cell_size: float
    levels: tuple[Level, ...]


@dataclass(frozen=True, slots=True, eq=False)
class VertexQuadrics:
    """The quadrics of one level.

    Parameters
    ----------
    coefficients : ndarray of float64, shape (v, 10)
    counts : ndarray of float64, shape (v,)
        Points in the eight cells around each vertex.
    inherited : ndarray of float64, shape (v,)
        The mean count of its parents, plus a quarter of what these inherited.
    """

    coefficients: FloatArray
    counts: FloatArray
    inherited: FloatArray


def build_pyramid(cloud: PointCloud, cell_size: float, workforce: Workforce) -> Pyramid:
    """Sum the moments of the finest cells on the workers, and of all coarser ones from these.

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
    cells, moments = _finest_moments(cloud, low, cell_size, workforce)
    vertices = spread_keys(cells, -1, 2)
    levels = [Level(cells, moments, spread_keys(cells, 0, 1), vertices)]
    for _ in range(coarser):
        cells, moments = _merge_cells(cells, moments)
        touched = spread_keys(cells, 0, 1)
        vertices = unique_keys(np.concatenate([touched, _all_parents(vertices)]))
        levels.append(Level(cells, moments, touched, vertices))
    return Pyramid(low, cell_size, tuple(levels))


def _finest_moments(
    cloud: PointCloud, origin: FloatArray, cell_size: float, workforce: Workforce
) -> tuple[IntArray, FloatArray]:
    """Sort the points by cell and sum the moments of each cell."""
    assert cloud.normals is not None  # noqa: S101 - checked by the method, at its border
    places = cells_of(cloud.positions, origin, cell_size)
    corners = np.floor(places)
    keys = pack_places(corners.astype(np.int64))
    order = np.argsort(keys, kind="stable")
    local = (places - corners - 0.5)[order]
    normals = cloud.normals[order]
    cells = unique_keys(keys)
    offsets = np.append(np.searchsorted(keys[order], cells), len(keys)).astype(np.int64)
    batches = []
    for cut in workforce.cut(len(cells)):
        bounds = offsets[cut.start : cut.stop + 1]
        points = slice(int(bounds[0]), int(bounds[-1]))
        batches.append((local[points], normals[points], bounds - bounds[0]))
    return cells, np.concatenate(map_batches(workforce, accumulate_moments, batches))


def _merge_cells(cells: IntArray, moments: FloatArray) -> tuple[IntArray, FloatArray]:
    """Sum the moments of each eight children about the centre of their parent."""
    places = unpack_keys(cells)
    parent_keys = pack_places(places >> 1)
    parents = unique_keys(parent_keys)
    owners = find_keys(parents, parent_keys)
    which = (places & 1) @ np.array([1, 2, 4])
    merged = np.zeros((len(parents), moments.shape[1]))
    for child, octant in enumerate(OCTANTS):
        chosen = which == child
        merged[owners[chosen]] += shift_moments(moments[chosen], octant - 0.5)
    return parents, scale_moments(merged)


def _all_parents(vertices: IntArray) -> IntArray:
    """Return every parent of some vertices, sorted."""
    places = unpack_keys(vertices)
    parents = [unique_keys(corner_parents(places, octant)[0]) for octant in OCTANTS]
    return unique_keys(np.concatenate(parents))


def corner_moments(level: Level) -> FloatArray:
    """Sum the moments of the eight cells around each touched vertex, about it.

    Parameters
    ----------
    level : Level

    Returns
    -------
    ndarray of float64, shape (t, 44)
    """
    total = np.zeros((len(level.touched), level.moments.shape[1]))
    for octant in OCTANTS:
        rows = find_keys(level.touched, step_keys(level.cells, octant))
        total[rows] += shift_moments(level.moments, 0.5 - octant)
    return total


def fit_pyramid(
    pyramid: Pyramid,
    lam: float,
    mu: float,
    workforce: Workforce,
    advance: Advance | None = None,
) -> VertexQuadrics:
    """Fit every level, from the coarsest to the finest, each with the one above as prior.

    Parameters
    ----------
    pyramid : Pyramid
    lam, mu : float
        See `fit_vertices`.
    workforce : Workforce
    advance : callable, optional
        Told (vertices fitted, vertices in all) after each level.

    Returns
    -------
    VertexQuadrics
        Of the finest level.
    """
    total = sum(len(level.touched) for level in pyramid.levels)
    done = 0
    above: tuple[Level, VertexQuadrics] | None = None
    for level in reversed(pyramid.levels):
        quadrics = _inherit_level(level, above)
        rows = find_keys(level.vertices, level.touched)
        moments = corner_moments(level)
        prior = quadrics.coefficients[rows]
        batches = [(moments[cut], prior[cut], lam, mu) for cut in workforce.cut(len(rows))]
        fitted = map_batches(workforce, fit_vertices, batches)
        quadrics.coefficients[rows] = np.concatenate(fitted)
        quadrics.counts[rows] = moments[:, 0]
        above = (level, quadrics)
        done += len(rows)
        if advance is not None:
            advance(done, total)
    return quadrics


def _inherit_level(level: Level, above: tuple[Level, VertexQuadrics] | None) -> VertexQuadrics:
    """Return the means of the parents' quadrics and support; zeros at the coarsest level."""
    vertices = len(level.vertices)
    start = VertexQuadrics(np.zeros((vertices, BASIS)), np.zeros(vertices), np.zeros(vertices))
    if above is None:
        return start
    parent_level, parents = above
    places = unpack_keys(level.vertices)
    support = parents.counts + _ANCESTORS * parents.inherited
    for octant in OCTANTS:
        keys, steps = corner_parents(places, octant)
        rows = find_keys(parent_level.vertices, keys)
        start.coefficients[:] += 0.125 * inherit_quadrics(parents.coefficients[rows], steps)
        start.inherited[:] += 0.125 * support[rows]
    return start
