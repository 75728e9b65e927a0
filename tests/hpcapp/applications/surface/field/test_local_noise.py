from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from shared_data import shared

from hpcapp.applications.surface.cloud.measure import find_scale, measure_points
from hpcapp.applications.surface.field.local_noise import LocalNoise
from hpcapp.applications.surface.resolution.estimates import choose_scale
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import open_points, read_whole

SPACING = 0.03


def scatter(normals: FloatArray, places: FloatArray, noise: FloatArray | float) -> PointCloud:
    """Move points along their normals by chance."""
    random = np.random.default_rng(2)
    off = noise * random.normal(size=len(places))
    return PointCloud(places + off[:, None] * normals, normals)


def ball(noise_of: Callable[[FloatArray], FloatArray | float]) -> PointCloud:
    """Points on a ball of radius 1, `SPACING` apart, with a noise for each."""
    normals = np.random.default_rng(1).normal(size=(round(4 * np.pi / SPACING**2), 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return scatter(normals, normals, noise_of(normals))


def even_ball(noise: float) -> PointCloud:
    """The same with one noise."""
    return ball(lambda _: noise)


def plate(thickness: float, noise: float) -> PointCloud:
    """Points on both sides of a plate."""
    random = np.random.default_rng(3)
    side = np.where(random.uniform(size=20_000) < 0.5, -0.5, 0.5)
    edge = np.sqrt(10_000) * SPACING
    flat = random.uniform(0.0, edge, size=(20_000, 2))
    places = np.column_stack([flat, thickness * side])
    return scatter(np.sign(side)[:, None] * [0.0, 0.0, 1.0], places, noise)


def cube() -> PointCloud:
    """Points on a cube of edge 1, without noise."""
    random = np.random.default_rng(4)
    places = random.uniform(size=(15_000, 3))
    rows, axis = np.arange(len(places)), random.integers(3, size=len(places))
    places[rows, axis] = random.integers(2, size=len(places))
    normals = np.zeros_like(places)
    normals[rows, axis] = 2.0 * places[rows, axis] - 1.0
    return PointCloud(places, normals)


def find_noise(cloud: PointCloud) -> LocalNoise:
    return choose_scale(measure_points(cloud).measured, 0.0, 1.0, 1.0).noise


@pytest.mark.parametrize("bad", [0.3, 0.6])
@pytest.mark.parametrize("good", [0.1, 0.15])
def test_the_good_side_and_the_bad_one_are_told_apart(good: float, bad: float) -> None:
    cloud = ball(lambda at: SPACING * np.where(at[:, 2] > 0.0, bad, good))
    noise, heights = find_noise(cloud).places.at(cloud.positions), cloud.positions[:, 2]
    found = [float(np.median(noise[some])) / SPACING for some in (heights < -0.3, heights > 0.3)]
    assert found == pytest.approx([good, bad], rel=0.25)


def test_a_spot_is_told_where_it_spans_two_dozen_spacings() -> None:
    cloud = ball(lambda at: SPACING * np.where(at[:, 2] > 0.9, 0.8, 0.1))
    noise, heights = find_noise(cloud).places.at(cloud.positions), cloud.positions[:, 2]
    assert float(np.median(noise[heights > 0.95])) > 0.4 * SPACING
    assert float(np.median(noise[heights < 0.8])) == pytest.approx(0.1 * SPACING, rel=0.25)


@pytest.mark.parametrize("thickness", [2.0, 3.0, 4.0])
def test_two_sides_of_a_plate_are_no_noise(thickness: float) -> None:
    """Their quadrics pass between the sheets, and disagree with the normals of both."""
    cloud = plate(thickness * SPACING, 0.1 * SPACING)
    noise = np.sqrt(find_noise(cloud).variances_at(cloud.positions))
    assert np.quantile(noise, 0.95) < 0.2 * SPACING


def test_edges_are_no_noise() -> None:
    cloud = cube()
    spacing = np.sqrt(6.0 / len(cloud))
    noise = np.sqrt(find_noise(cloud).variances_at(cloud.positions))
    assert noise.max() < 0.1 * spacing


def test_teeth_of_a_gear_are_no_noise() -> None:
    gear = read_whole(open_points(shared("tuning/scans/gear__low.ply")))
    places = find_noise(gear).places
    assert np.quantile(places.at(gear.positions), 0.95) < 0.2 * find_scale(gear.positions).spacing


def test_what_cannot_be_told_from_relief_goes_by_the_whole_cloud() -> None:
    assert find_noise(even_ball(0.0)).range[1] < 0.02 * SPACING
    for share, least, most in ((0.15, 0.0, 0.05), (0.3, 0.15, 0.29)):
        found = find_noise(even_ball(share * SPACING))
        told = LocalNoise(0.0, found.untold, found.places).variances_at(np.eye(3))
        assert least * SPACING <= np.sqrt(told.min()) <= np.sqrt(told.max()) <= most * SPACING


def test_hands_on_the_wheel() -> None:
    noise = find_noise(even_ball(0.5 * SPACING))
    twice = noise.scaled(2.0).variances_at(np.eye(3))
    assert twice == pytest.approx(4.0 * noise.variances_at(np.eye(3)))


def test_a_few_points_have_no_noise_that_could_be_found() -> None:
    few = even_ball(0.1).take(np.arange(12))
    assert find_noise(few).variances_at(few.positions).tolist() == [0.0] * 12
