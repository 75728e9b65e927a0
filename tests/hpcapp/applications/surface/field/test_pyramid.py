from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from directions import random_directions

from hpcapp import kernels
from hpcapp.applications.surface.field.cell_points import CellMoments, PartMoments
from hpcapp.applications.surface.field.pyramid import (
    Pyramid,
    VertexQuadrics,
    build_pyramid,
    count_levels,
    fit_levels,
    raise_levels,
)
from hpcapp.applications.surface.field.weights import Weights, weigh_levels
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.lattice import find_keys, unpack_keys
from hpcapp.geometry.points import FloatArray, IntArray, PointCloud
from hpcapp.kernels.portable.quadrics.moments import accumulate_moments

CELL_SIZE = 0.05
CENTRE = np.array([10.0, 0.0, -3.0])


def build(cloud: PointCloud, cell_size: float, threads: int = 1) -> Pyramid:
    """Build all levels of a cloud."""
    low, high = bound_points(cloud.positions)
    height = count_levels((high - low).max(), cell_size)
    return build_pyramid(cloud, low, cell_size, height, threads)


def fit_alike(pyramid: Pyramid, threads: int = 1) -> VertexQuadrics:
    """Fit every level with the same weights; return the finest one's quadrics."""
    weights = [Weights(0.05, 0.0, 0.3, 0.3)] * len(pyramid.levels)
    return fit_levels(pyramid, weights, None, threads)[0][0]


@pytest.fixture(scope="module")
def cloud() -> PointCloud:
    directions = random_directions(4000, 0)
    return PointCloud(directions + CENTRE, directions)


def moments_around(cloud: PointCloud, pyramid: Pyramid, level: int, vertex: IntArray) -> FloatArray:
    """Sum, point by point, the moments of the eight cells around a vertex."""
    size = pyramid.cell_size * 2**level
    local = (cloud.positions - pyramid.origin) / size - vertex
    near = (np.floor(local) >= -1).all(axis=1) & (np.floor(local) <= 0).all(axis=1)
    assert cloud.normals is not None
    values: FloatArray = accumulate_moments(
        local[near], cloud.normals[near], np.array([0, near.sum()])
    )[0]
    return values


def test_levels_end_at_six_to_twelve_cells(cloud: PointCloud) -> None:
    pyramid = build(cloud, CELL_SIZE)
    assert len(pyramid.levels) == 3
    widest = np.ptp(unpack_keys(pyramid.levels[-1].cells), axis=0).max() + 1
    assert 6 <= widest <= 13


def test_every_level_counts_every_point(cloud: PointCloud) -> None:
    pyramid = build(cloud, CELL_SIZE)
    for level, vertices in zip(pyramid.levels, pyramid.vertices, strict=True):
        assert level.points.counts.sum() == len(cloud)
        assert np.isin(kernels.spread_keys(level.cells, 0, 1), vertices).all()


def test_moments_above_the_points_are_rounded_once_and_no_others(cloud: PointCloud) -> None:
    finest, first, *coarser = build(cloud, 0.02).levels
    exact = kernels.merge_cells(finest.cells, finest.points.sum(slice(0, len(finest.cells))))[1]
    assert isinstance(first.points, CellMoments)
    assert [piece.dtype for piece in first.points.pieces] == [np.float32]
    found = first.points.sum(slice(0, len(first.cells)))
    assert found.tobytes() == exact.astype(np.float32).astype(np.float64).tobytes()
    summed = kernels.merge_cells(first.cells, found)[1]
    assert coarser[0].points.sum(slice(0, len(summed))).tobytes() == summed.tobytes()


def test_levels_upon_parts_are_those_upon_the_whole(cloud: PointCloud) -> None:
    level = build(cloud, 0.02).levels[1]
    owners = np.random.default_rng(2).integers(0, 4, len(level.cells))  # nobody has the fourth's
    rows = [np.flatnonzero(owners == part) for part in range(4)]
    rows[0], rows[3] = np.sort(np.concatenate([rows[0], rows[3]])), rows[3][:0]
    every = slice(0, len(level.cells))
    moments = level.points.sum(every)
    parts = PartMoments([moments[at] for at in rows], rows)
    np.testing.assert_array_equal(parts.counts, level.points.counts)
    pieces = CellMoments([moments[:6], moments[6:6], moments[6:9], moments[9:]])
    np.testing.assert_array_equal(pieces.counts, level.points.counts)
    for run in (every, slice(5, 6), slice(7, 7), slice(5, 10), slice(0, 0)):
        for some in (level.points, pieces, parts):
            assert some.sum(run).tobytes() == moments[run].tobytes()
    whole, *others = (
        raise_levels(replace(level, points=some), 4) for some in (level.points, pieces, parts)
    )
    for other in others:
        for expected, found in zip(whole[1:], other[1:], strict=True):
            np.testing.assert_array_equal(found.cells, expected.cells)
            np.testing.assert_array_equal(found.squares, expected.squares)
            of_all = slice(0, len(found.cells))
            assert found.points.sum(of_all).tobytes() == expected.points.sum(of_all).tobytes()


def test_vertices_know_the_points_of_the_eight_cells_around_them(cloud: PointCloud) -> None:
    pyramid = build(cloud, CELL_SIZE)
    for number, level in enumerate(pyramid.levels):
        in_cells = level.points.sum(slice(0, len(level.cells)))
        touched = kernels.spread_keys(level.cells, 0, 1)
        moments = kernels.corner_moments(touched, level.cells, in_cells)
        for row in np.random.default_rng(number).integers(0, len(moments), 8):
            vertex = unpack_keys(touched[row])
            expected = moments_around(cloud, pyramid, number, vertex)
            rounding = 2**-21 * expected[0] if number else 1e-9  # of single precision
            np.testing.assert_allclose(moments[row], expected, rtol=1e-9, atol=rounding)


def test_finest_quadrics_are_signed_distances_near_the_surface(cloud: PointCloud) -> None:
    pyramid = build(cloud, CELL_SIZE)
    quadrics = fit_alike(pyramid)
    touched = kernels.spread_keys(pyramid.levels[0].cells, 0, 1)
    rows = find_keys(pyramid.vertices[0], touched)
    places = pyramid.origin + CELL_SIZE * unpack_keys(touched)
    distances = np.linalg.norm(places - CENTRE, axis=1) - 1.0
    near = np.abs(distances) < 0.3 * CELL_SIZE
    errors = CELL_SIZE * quadrics.coefficients[rows, 0] - distances
    assert np.sqrt((errors[near] ** 2).mean()) < 0.03 * CELL_SIZE


def test_vertices_without_points_inherit_from_those_that_have_some(cloud: PointCloud) -> None:
    pyramid = build(cloud, CELL_SIZE)
    quadrics = fit_alike(pyramid)
    lonely = quadrics.counts == 0
    assert lonely.any()
    assert (quadrics.inherited[lonely] > 0).mean() > 0.95
    places = pyramid.origin + CELL_SIZE * unpack_keys(pyramid.vertices[0][lonely])
    distances = np.linalg.norm(places - CENTRE, axis=1) - 1.0
    clear = np.abs(distances) > 0.5 * CELL_SIZE
    agree = np.sign(quadrics.coefficients[lonely, 0]) == np.sign(distances)
    assert agree[clear].mean() > 0.99


def test_bits_do_not_depend_on_the_threads(cloud: PointCloud) -> None:
    results = [fit_alike(build(cloud, CELL_SIZE, n), n).coefficients for n in (1, 3, 16)]
    assert np.array_equal(results[0], results[1])
    assert np.array_equal(results[0], results[2])


def test_vertices_learn_the_noise_around_them_from_further_up() -> None:
    """One half of a sphere is noisier than the other: each must be told of its own noise."""
    rng = np.random.default_rng(3)
    directions = random_directions(40_000, rng)
    sigma = np.where(directions[:, 2] > 0.0, 0.01, 0.002)
    radii = 1.0 + sigma * rng.normal(size=len(directions))
    pyramid = build(PointCloud(radii[:, None] * directions, directions), 0.04)
    weights = weigh_levels(0.04, len(pyramid.levels), 0.005)
    finest = fit_levels(pyramid, weights)[0][0]
    heights = (pyramid.origin + 0.04 * unpack_keys(pyramid.vertices[0]))[:, 2]
    told = 0.04**2 * finest.variances[:, 1]
    assert np.median(told[heights > 0.3]) == pytest.approx(0.01**2, rel=0.2)
    assert np.median(told[heights < -0.3]) == pytest.approx(0.002**2, rel=0.5)
