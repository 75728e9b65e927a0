from __future__ import annotations

import numpy as np
import pytest
from directions import random_directions

from hpcapp.applications.surface.field.far_field import solve_far_field, spread_samples
from hpcapp.geometry.points import FloatArray
from hpcapp.kernels.portable.field.coarse_grid import sample_grid
from hpcapp.kernels.types.field import FarField

RADIUS = 3.0
BOX = (np.full(3, -3.2), np.full(3, 3.2))


def distances_at(far: FarField, points: FloatArray) -> FloatArray:
    return sample_grid(far.values.astype(np.float64), (points - far.origin) / far.step)


@pytest.fixture(scope="module")
def normals() -> FloatArray:
    return random_directions(4000, 0)


@pytest.fixture(scope="module")
def far(normals: FloatArray) -> FarField:
    return solve_far_field(RADIUS * normals, normals, BOX, 0.1, 128, np.zeros(3))


def test_the_box_is_covered_and_values_are_shared_as_float32(far: FarField) -> None:
    assert far.values.dtype == np.float32
    assert (far.origin < BOX[0]).all()
    assert (far.origin + far.step * (len(far.values) - 1) > BOX[1]).all()


def test_the_sign_is_right_everywhere_but_beside_the_surface(far: FarField) -> None:
    points = np.random.default_rng(1).uniform(-3.2, 3.2, (20_000, 3))
    distances = np.linalg.norm(points, axis=1) - RADIUS
    clear = np.abs(distances) > 2 * far.step
    assert (np.sign(distances_at(far, points)) == np.sign(distances))[clear].all()


def test_beside_the_surface_it_is_a_distance_within_a_third_of_a_step(
    far: FarField, normals: FloatArray
) -> None:
    for height in (-0.5, 0.0, 0.5):
        points = (RADIUS + height * far.step) * normals
        assert np.abs(distances_at(far, points) / far.step - height).mean() < 0.33


def test_nothing_is_larger_than_a_step_and_a_half(far: FarField) -> None:
    assert np.abs(far.values).max() <= np.float32(1.5 * far.step)


def test_a_hole_is_closed_smoothly(normals: FloatArray) -> None:
    kept = normals[normals[:, 2] < 0.8]
    far = solve_far_field(RADIUS * kept, kept, BOX, 0.1, 128, np.zeros(3))
    axis = np.outer(np.linspace(0.5, 3.2, 200), [0.0, 0.0, 1.0])
    signs = distances_at(far, axis) > 0
    assert not signs[0]
    assert signs[-1]
    assert np.diff(signs).sum() == 1, "the ray through the hole leaves the object once"


def test_sampling_reproduces_linear_functions() -> None:
    x, y, z = np.indices((128, 128, 128), dtype=np.float64)
    places = np.random.default_rng(2).uniform(1, 126, (50, 3))
    np.testing.assert_allclose(sample_grid(x - 2 * y + 3 * z, places), places @ [1, -2, 3])


def thin_out(directions: FloatArray, share: float) -> FloatArray:
    """Leave few samples where x is above a third of the radius."""
    kept = np.random.default_rng(5).random(len(directions)) < share
    found: FloatArray = directions[(directions[:, 0] < 1.0 / 3.0) | kept]
    return found


@pytest.mark.parametrize("share", [1.0, 0.2, 0.03])
def test_few_samples_count_as_much_as_many_by_area(share: float) -> None:
    # All cells of a sphere are occupied where x is small; elsewhere a share of them.
    kept = thin_out(random_directions(12_000, 0), share)
    far = solve_far_field(RADIUS * kept, kept, BOX, 0.1, 128, np.zeros(3))
    points = np.random.default_rng(1).uniform(-3.2, 3.2, (20_000, 3))
    distances = np.linalg.norm(points, axis=1) - RADIUS
    # Between samples that are so far apart nothing tells where the surface is.
    apart = 0.1 / np.sqrt(share)
    clear = np.abs(distances) > 2.0 * far.step + 0.3 * apart
    assert (np.sign(distances_at(far, points)) == np.sign(distances))[clear].mean() > 0.999


def test_samples_of_whole_cells_count_about_one_cell_each() -> None:
    points, size = RADIUS * random_directions(300_000, 0), 0.1
    _, cell, counts = np.unique(
        np.floor(points / size).astype(np.int64), axis=0, return_inverse=True, return_counts=True
    )
    means = [np.bincount(cell.reshape(-1), axis) / counts for axis in points.T]
    centroids = np.stack(means, axis=1)
    normals = centroids / np.linalg.norm(centroids, axis=1, keepdims=True)
    places, spread = spread_samples(centroids, normals, size)
    assert len(places) < 2 * len(centroids)
    assert 0.9 < np.linalg.norm(spread, axis=1).sum() / len(centroids) < 1.2


def test_what_samples_count_is_the_area_of_the_surface() -> None:
    size = 0.1
    area = 4.0 * np.pi * RADIUS**2
    for count in (400, 2_000, 10_000):
        directions = random_directions(count, 0)
        _, normals = spread_samples(RADIUS * directions, directions, size)
        counted = np.linalg.norm(normals, axis=1).sum() * size**2
        assert 0.75 < counted / area < 1.35, count


def test_discs_lie_in_the_tangent_plane_around_their_sample() -> None:
    plane = np.random.default_rng(3).uniform(-1.0, 1.0, (300, 3)) * [1.0, 1.0, 0.0]
    up = np.tile([0.0, 0.0, 1.0], (len(plane), 1))
    places, normals = spread_samples(plane, up, 0.02)
    assert len(places) > 5 * len(plane)
    assert np.abs(places[:, 2]).max() < 1e-12
    np.testing.assert_allclose(normals[:, :2], 0.0, atol=1e-12)
    weights = normals[:, 2]
    np.testing.assert_allclose(weights @ places / weights.sum(), 0.0, atol=0.1)


def test_an_outlier_stands_for_less_than_what_few_rays_have_reached() -> None:
    size = 0.05
    outliers, of_outliers = 1.4 * RADIUS * random_directions(100, 7), random_directions(100, 8)

    def count(directions: FloatArray) -> float:
        centroids = np.concatenate([RADIUS * directions, outliers])
        normals = np.concatenate([directions, of_outliers])
        places, spread = spread_samples(centroids, normals, size)
        beyond = np.linalg.norm(places, axis=1) > 1.25 * RADIUS
        return float(np.linalg.norm(spread[beyond], axis=1).sum() / len(outliers))

    # Beside a surface whose cells are all there, and on one with a sample in 50 cells.
    assert count(random_directions(40_000, 0)) < 30.0
    bare = random_directions(900, 0)
    _, spread = spread_samples(RADIUS * bare, bare, size)
    assert np.linalg.norm(spread, axis=1).mean() > 0.0
    assert np.linalg.norm(spread, axis=1).sum() / len(bare) > 40.0


@pytest.mark.parametrize("count", [1, 2, 15, 16])
def test_a_handful_of_samples_is_enough(count: int) -> None:
    directions = random_directions(count, 0)
    places, normals = spread_samples(RADIUS * directions, directions, 0.1)
    assert np.isfinite(places).all()
    assert np.isfinite(normals).all()
    assert len(places) >= count


def test_normals_that_cancel_are_no_direction() -> None:
    directions = random_directions(200, 0)
    normals = directions.copy()
    normals[::2] = 0.0
    places, spread = spread_samples(RADIUS * directions, normals, 0.05)
    assert np.isfinite(places).all()
    assert np.isfinite(spread).all()
