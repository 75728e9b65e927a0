from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from hpcapp.applications.surface.pyramid import build_pyramid, fit_levels
from hpcapp.applications.surface.weights import Weights, weigh_levels
from hpcapp.batches import Workforce
from hpccomponent.surface import kernels
from hpccomponent.surface.lattice import find_keys, unpack_keys
from hpccomponent.surface.moments import accumulate_moments
from hpccomponent.surface.points import PointCloud

CELL_SIZE = 0.05
CENTRE = np.array([10.0, 0.0, -3.0])


def fit_alike(pyramid, workforce, advance=None):
    """Fit every level with the same weights; return the finest one's quadrics."""
    weights = [Weights(0.05, 0.0, 0.3, 0.3)] * len(pyramid.levels)
    return fit_levels(pyramid, weights, workforce, advance)[0]


@pytest.fixture(scope="module")
def cloud():
    directions = np.random.default_rng(0).normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return PointCloud(directions + CENTRE, directions)


@pytest.fixture
def workforce():
    with ThreadPoolExecutor(1) as executor:
        yield Workforce(executor)


def moments_around(cloud, pyramid, level, vertex):
    """Sum, point by point, the moments of the eight cells around a vertex."""
    size = pyramid.cell_size * 2**level
    local = (cloud.positions - pyramid.origin) / size - vertex
    near = (np.floor(local) >= -1).all(axis=1) & (np.floor(local) <= 0).all(axis=1)
    return accumulate_moments(local[near], cloud.normals[near], np.array([0, near.sum()]))[0]


def test_levels_end_at_six_to_twelve_cells(cloud, workforce):
    pyramid = build_pyramid(cloud, CELL_SIZE, workforce)
    assert len(pyramid.levels) == 3
    widest = np.ptp(unpack_keys(pyramid.levels[-1].cells), axis=0).max() + 1
    assert 6 <= widest <= 13


def test_every_level_counts_every_point(cloud, workforce):
    for level in build_pyramid(cloud, CELL_SIZE, workforce).levels:
        assert level.points.counts.sum() == len(cloud)
        assert np.isin(level.touched, level.vertices).all()


def test_vertices_know_the_points_of_the_eight_cells_around_them(cloud, workforce):
    pyramid = build_pyramid(cloud, CELL_SIZE, workforce)
    for number, level in enumerate(pyramid.levels):
        in_cells = level.points.sum(slice(0, len(level.cells)))
        moments = kernels.corner_moments(level.touched, level.cells, in_cells)
        for row in np.random.default_rng(number).integers(0, len(moments), 8):
            vertex = unpack_keys(level.touched[row])
            expected = moments_around(cloud, pyramid, number, vertex)
            np.testing.assert_allclose(moments[row], expected, rtol=1e-9, atol=1e-9)


def test_finest_quadrics_are_signed_distances_near_the_surface(cloud, workforce):
    pyramid = build_pyramid(cloud, CELL_SIZE, workforce)
    told = []
    quadrics = fit_alike(pyramid, workforce, lambda *parts: told.append(parts))
    finest = pyramid.levels[0]
    rows = find_keys(finest.vertices, finest.touched)
    places = pyramid.origin + CELL_SIZE * unpack_keys(finest.touched)
    distances = np.linalg.norm(places - CENTRE, axis=1) - 1.0
    near = np.abs(distances) < 0.3 * CELL_SIZE
    errors = CELL_SIZE * quadrics.coefficients[rows, 0] - distances
    assert np.sqrt((errors[near] ** 2).mean()) < 0.03 * CELL_SIZE
    assert told[-1][0] == told[-1][1] == sum(len(level.touched) for level in pyramid.levels)


def test_vertices_without_points_inherit_from_those_that_have_some(cloud, workforce):
    pyramid = build_pyramid(cloud, CELL_SIZE, workforce)
    quadrics = fit_alike(pyramid, workforce)
    lonely = quadrics.counts == 0
    assert lonely.any()
    assert (quadrics.inherited[lonely] > 0).mean() > 0.95
    places = pyramid.origin + CELL_SIZE * unpack_keys(pyramid.levels[0].vertices[lonely])
    distances = np.linalg.norm(places - CENTRE, axis=1) - 1.0
    clear = np.abs(distances) > 0.5 * CELL_SIZE
    agree = np.sign(quadrics.coefficients[lonely, 0]) == np.sign(distances)
    assert agree[clear].mean() > 0.99


def test_bits_do_not_depend_on_the_batches(cloud):
    results = []
    for batches in (1, 3, 16):
        with ThreadPoolExecutor(2) as executor:
            workforce = Workforce(executor, 1, batches)
            pyramid = build_pyramid(cloud, CELL_SIZE, workforce)
            results.append(fit_alike(pyramid, workforce).coefficients)
    assert np.array_equal(results[0], results[1])
    assert np.array_equal(results[0], results[2])


def test_vertices_learn_the_noise_around_them_from_further_up(workforce):
    """One half of a sphere is noisier than the other: each must be told of its own noise."""
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(40_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    sigma = np.where(directions[:, 2] > 0.0, 0.01, 0.002)
    radii = 1.0 + sigma * rng.normal(size=len(directions))
    pyramid = build_pyramid(PointCloud(radii[:, None] * directions, directions), 0.04, workforce)
    weights = weigh_levels(0.04, len(pyramid.levels), 0.005)
    finest = fit_levels(pyramid, weights, workforce)[0]
    heights = (pyramid.origin + 0.04 * unpack_keys(pyramid.levels[0].vertices))[:, 2]
    told = 0.04**2 * finest.variances[:, 1]
    assert np.median(told[heights > 0.3]) == pytest.approx(0.01**2, rel=0.2)
    assert np.median(told[heights < -0.3]) == pytest.approx(0.002**2, rel=0.5)
