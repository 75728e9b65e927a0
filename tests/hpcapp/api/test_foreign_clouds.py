"""Clouds of Open3D and trimesh as input: by what they are called there."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import hpcapp


@pytest.fixture(scope="module")
def scan() -> hpcapp.PointCloud:
    return hpcapp.simulate("torus", points=3000)


def test_a_cloud_of_open3d_is_taken_with_normals_and_colours(scan: hpcapp.PointCloud) -> None:
    shades = np.tile([1.0, 0.5, 0.0], (len(scan), 1))
    foreign = SimpleNamespace(points=scan.positions, normals=scan.normals, colors=shades)
    mesh = hpcapp.reconstruct(foreign, grid=32)
    own = hpcapp.reconstruct(scan, grid=32)
    np.testing.assert_array_equal(mesh.vertices, own.vertices)
    assert mesh.colours is not None
    assert mesh.colours[0].tolist() == [255, 128, 0]


def test_a_cloud_of_trimesh_is_taken_without_normals(scan: hpcapp.PointCloud) -> None:
    shades = np.full((len(scan), 4), 9, np.uint8)
    foreign = SimpleNamespace(vertices=scan.positions, colors=shades)
    mesh = hpcapp.reconstruct(foreign, grid=32)
    assert mesh.colours is not None
    assert (mesh.colours == 9).all()


def test_empty_columns_of_open3d_are_none(scan: hpcapp.PointCloud) -> None:
    foreign = SimpleNamespace(points=scan.positions, normals=[], colors=[])
    assert hpcapp.reconstruct(foreign, grid=32).colours is None


@pytest.mark.parametrize(
    ("given", "line"),
    [
        (SimpleNamespace(vertices=np.zeros((3, 3)), faces=[[0, 1, 2]]), "mesh.sample(100_000)"),
        (SimpleNamespace(vertices=np.zeros((3, 3)), triangles=[[0, 1, 2]]), "sample_points_unif"),
        (SimpleNamespace(to_legacy=None), "points.to_legacy()"),
    ],
)
def test_what_is_no_cloud_is_refused_with_the_line_to_write(given: Any, line: str) -> None:
    with pytest.raises(hpcapp.UsageError) as refused:
        hpcapp.reconstruct(given)
    assert line in str(refused.value)


def test_a_cloud_says_what_it_is() -> None:
    cloud = hpcapp.PointCloud(np.zeros((2000, 3)), np.ones((2000, 3)), None, {"gps": np.ones(2000)})
    assert repr(cloud) == "PointCloud(2,000 points, normals, gps)"
