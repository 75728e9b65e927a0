from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from hpcapp.applications.surface.paper.preprocess import (
    denoise,
    measure_spacing,
    remove_outliers,
    resample,
)
from hpcapp.geometry.points import FloatArray, PointCloud
from hpccomponent.errors import InputError, UsageError


def sphere(n: int = 3000, noise: float = 0.0, seed: int = 0) -> PointCloud:
    """Points spread evenly over the unit sphere, moved along their normals by noise."""
    i = np.arange(n) + 0.5
    z, angle = 1.0 - 2.0 * i / n, np.pi * (1.0 + np.sqrt(5.0)) * i
    flat = np.sqrt(1.0 - z * z)
    normals = np.stack([flat * np.cos(angle), flat * np.sin(angle), z], axis=1)
    heights = 1.0 + noise * np.random.default_rng(seed).normal(size=(n, 1))
    colours = np.random.default_rng(seed).integers(0, 255, (n, 3), dtype=np.uint8)
    return PointCloud(normals * heights, normals, colours, origin=np.array([5.0, 6.0, 7.0]))


def errors(cloud: PointCloud) -> FloatArray:
    values: FloatArray = np.abs(np.linalg.norm(cloud.positions, axis=1) - 1.0)
    return values


def test_outliers_go_and_the_surface_stays() -> None:
    clean = sphere()
    far = np.random.default_rng(1).normal(size=(20, 3))
    far *= np.linspace(2.0, 4.0, 20)[:, None] / np.linalg.norm(far, axis=1, keepdims=True)
    cloud = PointCloud(np.vstack([far, clean.positions]))
    kept = remove_outliers(cloud)
    assert np.linalg.norm(kept.positions, axis=1).max() < 1.1
    assert len(kept) > 0.99 * len(clean)


def test_an_even_cloud_has_few_outliers_and_keeps_its_order() -> None:
    cloud = sphere()
    kept = remove_outliers(cloud)
    _, rows = cKDTree(cloud.positions).query(kept.positions)
    assert len(kept) > 0.98 * len(cloud)
    assert (np.diff(rows) > 0).all()
    assert kept.colours is not None
    assert cloud.colours is not None
    assert np.array_equal(kept.colours, cloud.colours[rows])


def test_too_few_points_have_no_outliers() -> None:
    cloud = sphere(16)
    assert remove_outliers(cloud) is cloud


def test_denoising_moves_points_towards_the_surface() -> None:
    noisy = sphere(noise=0.01)
    smooth = denoise(noisy)
    assert np.sqrt(np.mean(errors(smooth) ** 2)) < 0.6 * np.sqrt(np.mean(errors(noisy) ** 2))
    assert smooth.colours is not None
    assert noisy.colours is not None
    assert np.array_equal(smooth.colours, noisy.colours)
    assert smooth.origin.tolist() == noisy.origin.tolist()


def test_denoising_leaves_a_clean_surface_alone() -> None:
    cloud = sphere()
    smooth = denoise(cloud)
    # Of the curvature a plane's mean would take spacing^2 / 2 or so: 1e-3.
    assert errors(smooth).max() < 1e-4
    assert smooth.normals is not None
    assert cloud.normals is not None
    assert np.linalg.norm(smooth.normals, axis=1) == pytest.approx(1.0)
    assert (smooth.normals * cloud.normals).sum(axis=1).min() > 0.999


def test_denoising_turns_with_the_cloud() -> None:
    cloud = sphere(500, noise=0.02)
    turn = Rotation.from_rotvec([0.3, 0.5, -0.9]).as_matrix()
    turned = PointCloud(cloud.positions @ turn.T + 4.0, cloud.normals @ turn.T)
    assert np.allclose(denoise(turned).positions, denoise(cloud).positions @ turn.T + 4.0)


def test_denoising_keeps_the_two_sides_of_a_thin_sheet_apart() -> None:
    x, y = np.random.default_rng(2).uniform(-1.0, 1.0, (2, 2000))
    up = np.where(np.arange(2000) % 2, 1.0, -1.0)
    zero = np.zeros(2000)
    sheet = PointCloud(np.stack([x, y, 0.01 * up], 1), np.stack([zero, zero, up], 1))
    assert np.allclose(denoise(sheet).positions, sheet.positions)


@pytest.mark.parametrize("n", [1, 5, 7, 40])
def test_denoising_survives_coincident_points_and_small_clouds(n: int) -> None:
    place = PointCloud(np.full((n, 3), 2.0), np.tile([0.0, 0.0, 1.0], (n, 1)))
    assert np.array_equal(denoise(place).positions, place.positions)
    line = PointCloud(np.outer(np.arange(n), [1.0, 0.0, 0.0]), place.normals)
    assert np.allclose(denoise(line).positions, line.positions, atol=1e-6)


def test_resampling_evens_out_the_density() -> None:
    cloud = sphere()
    dense = cloud.positions[:, 2] > 0.0
    copies = cloud.positions[dense] + np.random.default_rng(3).normal(
        scale=1e-3, size=(9, dense.sum(), 3)
    )
    crowded = PointCloud(np.vstack([cloud.positions, copies.reshape(-1, 3)]))
    even = resample(crowded, 0.1)
    upper = np.sum(even.positions[:, 2] > 0.0)
    assert 0.8 < upper / (len(even) - upper) < 1.25


def test_resampling_takes_measured_points_one_for_each_voxel() -> None:
    cloud = sphere()
    even = resample(cloud, 0.2)
    distances, rows = cKDTree(cloud.positions).query(even.positions)
    assert not distances.any()
    assert (np.diff(rows) > 0).all()
    assert even.normals is not None
    assert cloud.normals is not None
    assert np.array_equal(even.normals, cloud.normals[rows])
    low = cloud.positions.min(axis=0)
    voxels = np.floor((cloud.positions - low) / 0.2)
    kept = np.floor((even.positions - low) / 0.2)
    assert len(np.unique(kept, axis=0)) == len(even) == len(np.unique(voxels, axis=0))


def test_the_default_spacing_keeps_an_even_cloud_nearly_whole() -> None:
    cloud = sphere()
    assert len(resample(cloud)) > 0.9 * len(cloud)
    assert measure_spacing(cloud.positions) == pytest.approx(np.sqrt(4.0 * np.pi / 3000), rel=0.2)


def test_resampling_of_coincident_points() -> None:
    place = PointCloud(np.zeros((5, 3)))
    assert resample(place) is place
    assert len(resample(place, 1.0)) == 1
    assert len(resample(PointCloud(np.zeros((1, 3))))) == 1


@pytest.mark.parametrize("step", [remove_outliers, denoise, resample])
def test_the_same_cloud_gives_the_same_bits(step: Callable[[PointCloud], PointCloud]) -> None:
    there, here = step(sphere(noise=0.01)), step(sphere(noise=0.01))
    assert there.positions.tobytes() == here.positions.tobytes()


def test_what_cannot_be_done_is_named() -> None:
    cloud = sphere(100)
    with pytest.raises(InputError, match="no normals"):
        denoise(PointCloud(cloud.positions))
    with pytest.raises(UsageError, match="5 neighbours"):
        denoise(cloud, 5)
    with pytest.raises(UsageError, match="spacing"):
        resample(cloud, 0.0)
    with pytest.raises(UsageError, match="larger"):
        resample(cloud, 1e-9)
