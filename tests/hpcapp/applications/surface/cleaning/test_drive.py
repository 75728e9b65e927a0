"""A cloud is cleaned before it is fitted, and clean ones come through as they are."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from shared_data import shared

from hpcapp.api.reconstruction import reconstruct
from hpcapp.applications.surface.cleaning.drive import Cleaned, drop_strays, mend_normals
from hpcapp.applications.surface.cloud import arranged as arranged_cloud
from hpcapp.applications.surface.cloud.arranged import arrange_cloud
from hpcapp.applications.surface.cloud.arrangement import choose_arrangement, snap_points
from hpcapp.applications.surface.cloud.cloud_pass import MemoryPass
from hpcapp.applications.surface.cloud.measure import measure_scale
from hpcapp.applications.surface.reading.reach import drop_far
from hpcapp.geometry.points import PointCloud
from hpcapp.io import drop_unusable, read_points
from hpcapp.lab.simulate.implicit import diagonal_of
from hpcapp.lab.simulate.scanner import simulate_scan
from hpcapp.lab.simulate.settings import ScanSettings
from hpcapp.lab.simulate.shapes import SHAPES


def clean(points: PointCloud, threads: int = 1) -> tuple[PointCloud, Cleaned]:
    arranged = MemoryPass(arrange_cloud(points), threads)
    kept, cleaned, scale = drop_strays(arranged, measure_scale(arranged))
    kept, flipped = mend_normals(kept, scale.spacing)
    return kept.cloud.points, replace(cleaned, flipped=flipped)


@pytest.mark.parametrize("name", ["box", "frame"])
def test_outliers_are_dropped_and_the_surface_is_not(name: str) -> None:
    settings = ScanSettings(points=40_000, outliers=0.03, noise=0.001, normals="exact")
    cloud = simulate_scan(SHAPES[name], settings)
    kept, cleaned = clean(cloud)
    diagonal = diagonal_of(SHAPES[name])
    before, after = (np.abs(SHAPES[name].value(c.positions)) / diagonal for c in (cloud, kept))
    assert (after < 0.015).sum() >= (before < 0.015).sum() - 1
    assert (after > 0.06).sum() <= 0.02 * (before > 0.06).sum()
    assert len(cloud) - len(kept) == cleaned.outliers + cleaned.strays


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fingers", "plates", "shaft"])
@pytest.mark.parametrize("points", [5_000, 20_000])
def test_clean_scans_come_through_as_they_are(name: str, points: int) -> None:
    """Thin parts, thin plates and sharp steps, sparse, with exact normals."""
    cloud = simulate_scan(SHAPES[name], ScanSettings(points=points, normals="exact"))
    kept, cleaned = clean(cloud)
    assert cleaned.flipped == 0
    assert len(cloud) - len(kept) == cleaned.outliers + cleaned.strays <= 0.0005 * points


@pytest.mark.parametrize("name", ["torus", "plate", "bracket"])
def test_flipped_normals_are_turned_round(name: str) -> None:
    settings = ScanSettings(points=20_000, flipped=0.05, normals="exact")
    kept, cleaned = clean(simulate_scan(SHAPES[name], settings))
    assert kept.normals is not None
    facing = np.einsum("ij,ij->i", kept.normals, SHAPES[name].normal(kept.positions))
    assert cleaned.outliers == 0
    assert 0.97 * 1000 <= cleaned.flipped <= 1000
    assert (facing < 0.0).sum() == 1000 - cleaned.flipped


def test_threads_clean_as_one_does() -> None:
    settings = ScanSettings(points=8_000, outliers=0.03, noise=0.002, flipped=0.05, normals="exact")
    cloud = simulate_scan(SHAPES["torus"], settings)
    (one, found), (three, found_by_three) = clean(cloud), clean(cloud, 3)
    assert found == found_by_three
    assert found.flipped
    assert found.outliers + found.strays
    assert one.positions.tobytes() == three.positions.tobytes()
    assert one.normals is not None
    assert three.normals is not None
    assert one.normals.tobytes() == three.normals.tobytes()


def test_a_marker_for_no_echo_does_not_spoil_the_rest() -> None:
    cloud = simulate_scan(SHAPES["torus"], ScanSettings(points=5_000, normals="exact"))
    assert cloud.normals is not None
    positions = np.concatenate([cloud.positions, [[1e30, 0.0, 0.0], [-9e9, -9e9, -9e9]]])
    marked = PointCloud(positions, np.concatenate([cloud.normals, cloud.normals[:2]]))
    near = drop_far(marked)
    assert len(near) == len(cloud)
    kept, cleaned = clean(near)
    assert cleaned == Cleaned()
    np.testing.assert_array_equal(kept.positions, arrange_cloud(cloud).points.positions)


def test_colours_and_origin_stay_with_their_points() -> None:
    random = np.random.default_rng(0)
    settings = ScanSettings(points=3_000, outliers=0.03, normals="exact")
    cloud = simulate_scan(SHAPES["sphere"], settings)
    colours = random.integers(0, 255, (len(cloud), 3)).astype(np.uint8)
    origin = np.array([7.0, 8.0, 9.0])
    coloured = PointCloud(cloud.positions, cloud.normals, colours, origin=origin)
    kept, cleaned = clean(coloured)
    assert cleaned.outliers > 0
    assert kept.colours is not None
    np.testing.assert_array_equal(kept.origin, coloured.origin)
    arranged = arrange_cloud(coloured).points
    assert arranged.colours is not None
    row = {tuple(place): i for i, place in enumerate(arranged.positions.tolist())}
    rows = [row[tuple(place)] for place in kept.positions.tolist()]
    assert rows == sorted(rows)
    np.testing.assert_array_equal(kept.colours, arranged.colours[rows])


def test_points_are_rounded_sorted_by_block_and_keep_their_order_within() -> None:
    random = np.random.default_rng(0)
    positions = random.random((20_000, 3)) * (1.0, 0.1, 0.1)
    colours = random.integers(0, 255, (len(positions), 3)).astype(np.uint8)
    cloud = PointCloud(positions, positions + 1.0, colours, origin=np.array([7.0, 8.0, 9.0]))
    arranged = arrange_cloud(cloud).points
    arrangement = choose_arrangement(positions.min(axis=0), positions.max(axis=0))
    snapped = snap_points(arrangement, positions)
    row = {tuple(place): i for i, place in enumerate(snapped.tolist())}
    rows = np.array([row[tuple(place)] for place in arranged.positions.tolist()])
    places = arranged.positions - arrangement.origin
    blocks = np.floor(places / arrangement.edge).astype(int).tolist()
    assert blocks == sorted(blocks)
    assert sorted(rows.tolist()) == list(range(len(cloud)))
    same = [a == b for a, b in pairwise(blocks)]
    assert sum(same) > len(cloud) // 2
    assert (np.diff(rows)[same] > 0).all()
    assert arranged.normals is not None
    assert arranged.colours is not None
    np.testing.assert_array_equal(arranged.normals, (positions[rows] + 1.0).astype(np.float32))
    np.testing.assert_array_equal(arranged.colours, colours[rows])
    np.testing.assert_array_equal(arranged.origin, cloud.origin)


@pytest.mark.parametrize("name", ["torus", "bracket"])
def test_rounding_moves_a_mesh_by_nothing_to_speak_of(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scan = simulate_scan(SHAPES[name], ScanSettings(points=20_000, noise=0.001))
    assert scan.normals is not None
    rounded = reconstruct(scan.positions, scan.normals, grid=96)
    monkeypatch.setattr(arranged_cloud, "snap_points", lambda _arrangement, positions: positions)
    exact = reconstruct(scan.positions, scan.normals, grid=96)
    np.testing.assert_array_equal(rounded.faces, exact.faces)
    moved = np.abs(rounded.vertices - exact.vertices).max() / diagonal_of(SHAPES[name])
    assert 0.0 < moved < 3e-6


@pytest.mark.parametrize(
    ("name", "most"),
    [("bunny_35947", 0), ("bunny_raw_362272", 5), ("kinect_table", 0), ("kitten_5210", 0)],
)
def test_real_scans_keep_their_points(name: str, most: int) -> None:
    cloud, _ = drop_unusable(read_points(shared(f"{name}.ply")))
    assert clean(cloud)[1].outliers <= most
