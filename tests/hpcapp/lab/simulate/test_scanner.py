"""Simulated scans: each fault is where it was asked for, and nowhere else."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial import KDTree

from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.lab.simulate.implicit import Solid, diagonal_of
from hpcapp.lab.simulate.scanner import sample_surface, simulate_scan
from hpcapp.lab.simulate.settings import ScanSettings
from hpcapp.lab.simulate.shapes import SHAPES
from hpccomponent.errors import UsageError

TORUS = SHAPES["torus"]
SPHERE = SHAPES["sphere"]


def scan(shape: Solid = TORUS, **settings: Any) -> PointCloud:
    return simulate_scan(shape, ScanSettings(**{"points": 4000} | settings))


def heights(shape: Solid, cloud: PointCloud) -> FloatArray:
    """The implicit function at the points, as a fraction of the diagonal."""
    return shape.value(cloud.positions) / diagonal_of(shape)


def agreement(shape: Solid, cloud: PointCloud) -> FloatArray:
    """The cosine between each point's normal and the shape's."""
    assert cloud.normals is not None
    values: FloatArray = np.einsum("ij,ij->i", cloud.normals, shape.normal(cloud.positions))
    return values


@pytest.mark.parametrize("name", SHAPES)
def test_a_clean_scan_lies_on_the_surface_with_as_many_points_as_asked(name: str) -> None:
    shape = SHAPES[name]
    cloud = scan(shape, points=1500, views=7, normals="exact")
    assert len(cloud) == 1500
    assert np.abs(heights(shape, cloud)).max() < 1e-12
    assert agreement(shape, cloud).min() > 1.0 - 1e-9


def test_one_seed_gives_one_scan_and_another_another() -> None:
    wild: dict[str, Any] = {
        "noise": 0.002, "dropout": 0.2, "pose_error": 0.001, "outliers": 0.02,
        "density_ratio": 5.0, "missing": 2, "flipped": 0.05,
    }  # fmt: skip
    first, again, other = scan(**wild), scan(**wild), scan(**wild, seed=1)
    assert np.array_equal(first.positions, again.positions)
    assert first.normals is not None
    assert again.normals is not None
    assert np.array_equal(first.normals, again.normals)
    assert not np.array_equal(first.positions, other.positions)


def test_noise_has_the_spread_asked_for_along_the_ray() -> None:
    spread = heights(SPHERE, scan(SPHERE, noise=0.002, grazing=20.0)).std()
    # Rays within 20 degrees of the normal carry nearly all of their noise across the surface.
    assert spread == pytest.approx(0.002, rel=0.08)


def test_drift_is_smooth_over_its_length_and_unlike_from_view_to_view() -> None:
    cloud = scan(SPHERE, points=20_000, views=0, drift=0.003, correlation=0.03)
    error = heights(SPHERE, cloud)
    assert error.std() == pytest.approx(0.003, rel=0.1)
    length = 0.03 * diagonal_of(SPHERE)

    def correlation(distance: float) -> float:
        pairs = KDTree(cloud.positions).query_pairs(1.05 * distance, output_type="ndarray")
        gap = np.linalg.norm(cloud.positions[pairs[:, 0]] - cloud.positions[pairs[:, 1]], axis=1)
        pairs = pairs[gap > 0.95 * distance]
        return float((error[pairs[:, 0]] * error[pairs[:, 1]]).mean() / error.var())

    assert correlation(0.3 * length) == pytest.approx(np.exp(-0.045), abs=0.03)
    assert correlation(length) == pytest.approx(np.exp(-0.5), abs=0.1)
    assert correlation(3.0 * length) == pytest.approx(0.0, abs=0.1)
    several = scan(SPHERE, points=20_000, views=6, drift=0.003, correlation=0.03, grazing=60.0)
    error = heights(SPHERE, several)
    nearest = KDTree(several.positions).query(several.positions, k=2)[1][:, 1]
    assert np.abs(error - error[nearest]).max() > 0.005  # the neighbour is of another view


def test_points_do_not_depend_on_the_number_of_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    several = scan(points=40_000, noise=0.001, drift=0.001)
    monkeypatch.setattr("hpcapp.lab.simulate.rays.available_cores", lambda: 1)
    single = scan(points=40_000, noise=0.001, drift=0.001)
    assert np.array_equal(several.positions, single.positions)
    assert np.array_equal(several.normals, single.normals)  # type: ignore[arg-type]


def test_no_point_is_seen_at_more_than_the_grazing_angle() -> None:
    cloud = scan(SPHERE, views=1, grazing=60.0, normals="exact")
    # One view from a diagonal away: the cap it sees at 60 degrees and less has a known width.
    apex = cloud.positions.mean(axis=0)
    angle = np.degrees(np.arccos(cloud.positions @ apex / np.linalg.norm(apex)))
    incidence = np.radians(60.0)
    seen = 60.0 - np.degrees(np.arcsin(np.sin(incidence) / diagonal_of(SPHERE)))
    assert angle.max() == pytest.approx(seen, abs=2.0)


def test_fitted_normals_look_at_the_scanner() -> None:
    assert (agreement(TORUS, scan(noise=0.001)) > 0.8).mean() > 0.99


def test_pose_errors_displace_views_as_wholes() -> None:
    away = np.abs(heights(TORUS, scan(pose_error=0.003, views=10)))
    assert 0.001 < away.mean() < 0.006
    assert away.max() < 0.03


def test_dropout_leaves_holes_in_a_view() -> None:
    whole, torn = scan(SPHERE, views=1), scan(SPHERE, views=1, dropout=0.5)
    assert len(torn) == len(whole)
    gap = KDTree(torn.positions).query(whole.positions)[0]
    spacing = KDTree(whole.positions).query(whole.positions, k=2)[0][:, 1]
    empty = (gap > 4 * spacing.mean()).mean()
    assert 0.2 < empty < 0.6


def test_outliers_are_as_many_as_asked_near_and_far() -> None:
    away = np.abs(heights(TORUS, scan(outliers=0.04, normals="exact")))
    wrong = away > 1e-9
    assert wrong.sum() == pytest.approx(0.04 * 4000, abs=8)
    assert away.max() > 0.1
    assert ((away > 1e-3) & (away <= 0.1)).sum() > 40


def test_density_falls_by_the_ratio_asked_for() -> None:
    cloud = scan(SPHERE, points=20_000, density_ratio=20.0, views=0)
    direction = cloud.positions.mean(axis=0)
    # Archimedes again: slabs of one height hold one area, so counts are densities.
    along = cloud.positions @ direction / np.linalg.norm(direction)
    counts = np.histogram(along, bins=10, range=(-1, 1))[0]
    reach = np.abs(direction).sum() / np.linalg.norm(direction)
    expected = 20.0 ** (0.9 / reach)
    assert counts[-1] / counts[0] == pytest.approx(expected, rel=0.25)


def test_missing_regions_are_empty_balls() -> None:
    whole = sample_surface(SPHERE, 3000, seed=2).positions
    gap = KDTree(scan(SPHERE, points=20_000, missing=6).positions).query(whole)[0]
    radius = 0.05 * diagonal_of(SPHERE)
    assert 0.7 * radius < gap.max() < 2.0 * radius
    assert 0.002 < (gap > 0.5 * radius).mean() < 0.06


def test_flipped_normals_are_as_many_as_asked() -> None:
    turned = agreement(TORUS, scan(flipped=0.05, normals="exact")) < 0
    assert turned.sum() == 200


def test_no_view_means_the_whole_surface() -> None:
    gap = KDTree(scan(SHAPES["plates"], points=8000, views=0).positions)
    hidden = np.array([[0.5, 0.0, 0.0122], [0.5, 0.0, -0.0122]])  # inside the narrow slot
    assert (gap.query(hidden)[0] < 0.1).all()
    assert (KDTree(scan(SHAPES["plates"]).positions).query(hidden)[0] > 0.02).all()


def test_samples_are_exact_and_as_many_as_asked() -> None:
    cloud = sample_surface(SHAPES["fingers"], 777, seed=3)
    assert len(cloud) == 777
    assert np.abs(heights(SHAPES["fingers"], cloud)).max() < 1e-12
    assert len(sample_surface(TORUS, 0)) == 0


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("points", 0), ("noise", -0.1), ("dropout", 1.0), ("grazing", 95.0),
        ("density_ratio", 0.5), ("flipped", 2.0), ("noise", float("nan")), ("normals", "none"),
        ("drift", 0.5), ("correlation", 0.0),
    ],
)  # fmt: skip
def test_settings_out_of_range_are_refused_by_name(setting: str, value: Any) -> None:
    with pytest.raises(UsageError, match=setting):
        ScanSettings(**{setting: value})


def test_faults_of_a_scanner_need_one() -> None:
    with pytest.raises(UsageError, match="need a scanner"):
        ScanSettings(views=0, pose_error=0.01)


def test_a_scanner_that_sees_nothing_says_so() -> None:
    with pytest.raises(UsageError, match="came back"):
        scan(SPHERE, points=5000, grazing=1.0)
