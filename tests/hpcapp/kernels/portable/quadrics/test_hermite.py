from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from directions import random_directions

from hpcapp.geometry.points import FloatArray
from hpcapp.kernels.portable.quadrics.hermite import (
    evaluate_misfits,
    evaluate_residuals,
    evaluate_slopes,
    fit_vertices,
    residual_variances,
    weigh_priors,
)
from hpcapp.kernels.portable.quadrics.inheritance import inherit_quadrics
from hpcapp.kernels.portable.quadrics.moments import accumulate_moments

Patch = tuple[FloatArray, ...]

MU = 0.3


def basis(points: FloatArray) -> FloatArray:
    x, y, z = points.T
    return np.stack([np.ones_like(x), x, y, z, x * x, y * y, z * z, x * y, y * z, z * x], axis=1)


def sphere_patch(
    rng: np.random.Generator, count: int, radius: float = 4.0, noise: float = 0.0
) -> Patch:
    """Points near the origin on a sphere of some cells' radius that passes beside it."""
    centre = rng.normal(size=3)
    centre *= (radius + rng.uniform(-0.5, 0.5)) / np.linalg.norm(centre)
    normals = random_directions(200 * count, rng)
    points = centre + radius * normals
    near = np.flatnonzero((np.abs(points) < 1).all(axis=1))[:count]
    offsets = noise * rng.normal(size=(len(near), 1)) * normals[near]
    return points[near] + offsets, normals[near], centre


def stack_moments(patches: Sequence[tuple[FloatArray, ...]]) -> FloatArray:
    rows = [accumulate_moments(p, n, np.array([0, len(p)])) for p, n, *_ in patches]
    return np.concatenate(rows)


@pytest.fixture
def patches() -> list[Patch]:
    rng = np.random.default_rng(3)
    return [sphere_patch(rng, int(count), noise=0.02) for count in rng.integers(3, 60, 50)]


def test_points_of_a_plane_give_its_signed_distance_beside_it() -> None:
    rng = np.random.default_rng(0)
    normal = np.array([2.0, -1.0, 2.0]) / 3.0
    points = rng.uniform(-1, 1, (200, 3))
    points -= np.outer(points @ normal - 0.2, normal)
    moments = stack_moments([(points, np.tile(normal, (200, 1)))])
    fitted = fit_vertices(moments, np.zeros((1, 10)), 0.1, MU)
    heights = rng.uniform(-0.1, 0.1, 200)
    values = basis(points + heights[:, None] * normal) @ fitted[0]
    assert np.abs(values - heights).max() < 0.02


def test_a_sphere_is_found_within_a_hundredth_of_a_cell() -> None:
    rng = np.random.default_rng(1)
    cases = [sphere_patch(rng, 40) for _ in range(10)]
    fitted = fit_vertices(stack_moments(cases), np.zeros((10, 10)), 0.01, 0.0)
    for coefficients, (points, _, centre) in zip(fitted, cases, strict=True):
        assert np.abs(basis(points) @ coefficients).max() < 0.01
        outwards = -centre / np.linalg.norm(centre)
        assert coefficients[1:4] @ outwards > 0.9


def test_coefficients_minimise_what_they_are_said_to(
    patches: list[Patch],
) -> None:
    """The same least squares, stacked row by row and solved by another route."""
    lam = 0.07
    prior = np.random.default_rng(5).normal(size=(len(patches), 10))
    fitted = fit_vertices(stack_moments(patches), prior, lam, MU)
    for coefficients, prior_row, (points, normals, _) in zip(fitted, prior, patches, strict=True):
        slopes = [(basis(points + d) - basis(points - d)) / 2e-3 for d in 1e-3 * np.eye(3)]
        nodes, weights = gauss_cube()
        rows = [basis(points), *(np.sqrt(lam) * s for s in slopes),
                np.sqrt(MU * weights)[:, None] * basis(nodes)]  # fmt: skip
        right = [np.zeros(len(points)), *(np.sqrt(lam) * n for n in normals.T),
                 np.sqrt(MU * weights) * (basis(nodes) @ prior_row)]  # fmt: skip
        expected = np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0]
        np.testing.assert_allclose(coefficients, expected, atol=2e-5)


def gauss_cube() -> tuple[FloatArray, FloatArray]:
    """Nodes and weights that integrate products of quadrics over [-1, 1]^3 exactly, mean 1."""
    x, w = np.polynomial.legendre.leggauss(3)
    nodes = np.array(np.meshgrid(x, x, x, indexing="ij")).reshape(3, -1).T
    weights = np.array(np.meshgrid(w, w, w, indexing="ij")).prod(axis=0).reshape(-1) / 8
    return nodes, weights


@pytest.mark.parametrize("cut", [1, 7, 49])
def test_a_row_does_not_depend_on_its_batch(patches: list[Patch], cut: int) -> None:
    moments = np.tile(stack_moments(patches), (50, 1))  # more than a chunk of the kernel
    prior = np.random.default_rng(2).normal(size=(len(moments), 10))
    whole = fit_vertices(moments, prior, 0.1, MU)
    parts = [fit_vertices(moments[s], prior[s], 0.1, MU) for s in (slice(cut), slice(cut, None))]
    assert np.array_equal(np.concatenate(parts), whole)


def test_without_normals_to_hold_it_one_point_leaves_the_prior_nearly_alone() -> None:
    prior = np.array([[0.1, 0.0, 0.0, 1.0, 0, 0, 0, 0, 0, 0]])
    point = np.array([[0.0, 0.0, -0.1]])  # where the prior is zero already
    moments = stack_moments([(point, np.array([[0.0, 0.0, 1.0]]))])
    np.testing.assert_allclose(fit_vertices(moments, prior, 0.01, MU), prior, atol=1e-6)


def test_a_child_inherits_the_same_function_in_its_own_cells() -> None:
    rng = np.random.default_rng(4)
    parents = rng.normal(size=(20, 10))
    steps = rng.integers(-1, 2, (20, 3))
    children = inherit_quadrics(parents, steps)
    u = rng.uniform(-1, 1, (20, 3))
    np.testing.assert_allclose(
        (basis(u) * children).sum(axis=1), 2 * (basis((u + steps) / 2) * parents).sum(axis=1)
    )


def test_residuals_are_the_sums_of_squares(
    patches: list[Patch],
) -> None:
    coefficients = np.random.default_rng(6).normal(size=(len(patches), 10))
    expected = [
        ((basis(p) @ c) ** 2).sum() for (p, *_), c in zip(patches, coefficients, strict=True)
    ]
    found = evaluate_residuals(stack_moments(patches), coefficients)
    np.testing.assert_allclose(found, np.array(expected))


def test_slopes_are_the_sums_of_squares(
    patches: list[Patch],
) -> None:
    coefficients = np.random.default_rng(7).normal(size=(len(patches), 10))
    expected = []
    for (points, *_), c in zip(patches, coefficients, strict=True):
        slopes = [(basis(points + d) - basis(points - d)) @ c / 2e-3 for d in 1e-3 * np.eye(3)]
        expected.append((np.array(slopes) ** 2).sum())
    found = evaluate_slopes(stack_moments(patches), coefficients)
    np.testing.assert_allclose(found, np.array(expected))


PLANE = np.array([[0.0, 0, 0, 1, 0, 0, 0, 0, 0, 0]])


def scan_plane(points: int, sigma: float, offset: float, seed: int) -> Patch:
    """Points of a plane that the prior PLANE misses by `offset`."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-1, 1, (points, 3)) * [1, 1, 0]
    places[:, 2] = offset + sigma * rng.normal(size=points)
    return places, np.tile([0.0, 0.0, 1.0], (points, 1))


def weigh_plane(patches: Sequence[Patch], noise: float, least: float = 1e-3) -> FloatArray:
    prior = np.repeat(PLANE, len(patches), axis=0)
    told = np.full(len(patches), noise)
    return weigh_priors(stack_moments(patches), prior, told, 0.3, least, 1000.0)


@pytest.mark.parametrize("offset", [0.1, 0.3])
@pytest.mark.parametrize("told", [0.5, 1.0, 4.0])
def test_a_prior_weighs_as_many_points_as_its_error_is_worth(offset: float, told: float) -> None:
    """A plane that misses the points by `offset`: the fit sees the noise, whatever was told."""
    sigma = 0.05
    mu = weigh_plane([scan_plane(4000, sigma, offset, 9)], told * sigma**2)
    assert mu == pytest.approx(3.0 * (sigma / offset) ** 2, rel=0.15)


@pytest.mark.parametrize("points", [12, 20])
def test_few_points_are_judged_by_the_noise_that_was_told(points: int) -> None:
    sigma, offset = 0.05, 0.3
    mu = weigh_plane([scan_plane(points, sigma, offset, seed) for seed in range(200)], sigma**2)
    assert np.median(mu) == pytest.approx((sigma / offset) ** 2, rel=0.15)


def test_a_prior_that_explains_the_points_is_kept_and_without_noise_none_is() -> None:
    right = [scan_plane(100, 0.05, 0.0, seed) for seed in range(400)]
    kept = weigh_plane(right, 0.05**2, 0.3)
    assert np.mean(kept == 1000.0) > 0.6
    assert np.mean(kept < 20.0) < 0.1
    exact = [scan_plane(points, 0.0, 0.1, 1) for points in (12, 100)]
    np.testing.assert_array_equal(weigh_plane(exact, 0.0, 0.3), 0.3)


@pytest.mark.parametrize("bend", [0.05, 0.1])
def test_detail_far_below_the_noise_of_a_point_is_seen_by_many(bend: float) -> None:
    """A saddle that the prior, a plane, misses by less than the noise."""
    sigma, weights = 0.1, []
    for height in (0.0, bend):
        patches = []
        for seed in range(100):
            places, normals = scan_plane(400, sigma, 0.0, seed)
            places[:, 2] += height * 3.0 * (places[:, 0] ** 2 - places[:, 1] ** 2)
            patches.append((places, normals))
        weights.append(np.median(weigh_plane(patches, sigma**2, 0.3)))
    assert weights[0] > 100.0
    assert weights[1] < 60.0


@pytest.mark.parametrize(("opposed", "expected"), [(0.0, 0.0), (0.5, 1.0)])
def test_misfits_tell_sheets_that_oppose_each_other(opposed: float, expected: float) -> None:
    """The best that one gradient can do with two opposite normals is to be none."""
    places, normals = scan_plane(1000, 0.01, 0.0, 3)
    normals[: int(opposed * len(normals))] *= -1.0
    moments = stack_moments([(places, normals)])
    fitted = fit_vertices(moments, np.zeros((1, 10)), 0.3, 0.3)
    assert evaluate_misfits(moments, fitted) == pytest.approx(expected, abs=0.03)


def test_what_a_fit_leaves_over_is_the_noise() -> None:
    rng = np.random.default_rng(11)
    sigma, counts, plane = 0.03, (23, 24, 4000), np.zeros((3, 10))
    normals = np.tile([0.0, 0.0, 1.0], (4000, 1))
    points = rng.uniform(-1, 1, (4000, 3)) * [1, 1, 0]
    points[:, 2] = sigma * rng.normal(size=4000)
    moments = stack_moments([(points[:n], normals[:n]) for n in counts])
    fitted = fit_vertices(moments, plane, 0.01, 0.0)
    few, enough, many = residual_variances(moments, fitted)
    assert np.isnan(few)
    assert enough > 0.0
    assert many == pytest.approx(sigma**2, rel=0.1)
    steeper = residual_variances(moments, 3.0 * fitted)  # the same surface
    np.testing.assert_allclose(steeper[1:], [enough, many])
