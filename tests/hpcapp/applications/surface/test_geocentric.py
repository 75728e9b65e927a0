"""A terrain from the centre of the earth faces away from it, as the same on a map faces up."""

from __future__ import annotations

import json
import logging
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from on_earth import find_place, put_on_earth

import hpcapp as package
from hpcapp.cli import hpcapp
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import read_mesh, write_points


def make_terrain(size: float) -> PointCloud:
    """Hills with a house."""
    rng = np.random.default_rng(5)
    x, y = rng.random((2, 6_000)) * size
    z = 0.03 * size * np.sin(x * 9.0 / size) * np.cos(y * 8.0 / size) + rng.normal(0.0, 0.02, 6_000)
    is_house = (np.abs(x - 0.5 * size) < 0.1 * size) & (np.abs(y - 0.4 * size) < 0.08 * size)
    return PointCloud(np.column_stack([x, y, np.where(is_house, 0.1 * size, z)]))


def face(mesh: Mesh) -> FloatArray:
    """Return where the faces of a mesh look, on average."""
    corners = mesh.vertices[mesh.faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    mean: FloatArray = areas.sum(axis=0) / np.linalg.norm(areas, axis=1).sum()
    return mean


@pytest.mark.parametrize(
    ("latitude", "suffix", "size", "side", "sign"),
    [
        (48.0, ".laz", 60.0, (), 1.0),
        (-35.0, ".laz", 60.0, ("--viewpoint", "below"), -1.0),
        (-35.0, ".xyz", 60.0, (), 1.0),
        (-35.0, ".xyz", 24.0, (), 1.0),  # no flight is as small
    ],
)
def test_a_terrain_is_seen_from_above(
    tmp_path: Path, latitude: float, suffix: str, size: float, side: tuple[str, ...], sign: float
) -> None:
    points, output = tmp_path / f"terrain{suffix}", tmp_path / "mesh.ply"
    crs = "EPSG:4978" if suffix == ".laz" else None
    write_points(points, put_on_earth(make_terrain(size), latitude), crs)
    run = CliRunner().invoke(hpcapp, ["info", str(points), "--json"])
    assert "away from the centre of the earth" in json.loads(run.stdout)["up"]
    command = ["reconstruct", str(points), "-o", str(output), "--backend", "serial", *side]
    run = CliRunner().invoke(hpcapp, command)
    assert run.exit_code == 0
    sure = re.search(r"; ([\d.]+) % of the points surely oriented", run.stderr)
    assert sure is not None
    assert float(sure[1]) > 99.0
    assert sign * find_place(latitude, 9.0, 0.0)[1][2] @ face(read_mesh(output)) > 0.7


def test_places_are_in_the_coordinates_of_the_file(caplog: pytest.LogCaptureFixture) -> None:
    wall = np.random.default_rng(2).random((4_000, 3)) * (20.0, 0.0, 6.0)
    wall[:, 1] = 0.3 * np.sin(wall[:, 0]) + 0.2 * np.cos(wall[:, 2])
    points = put_on_earth(PointCloud(wall), -35.0)
    place, axes = find_place(-35.0, 9.0, 300.0)
    with caplog.at_level(logging.WARNING, "hpcapp"):
        package.reconstruct(points, executor="serial")
    # Both sides, as the warning offers them.
    offered = [np.fromstring(one, sep=",") for one in re.findall(r"'([-\d.,]+)'", caplog.text)]
    norths = [float(axes[1] @ (one - place)) for one in offered]
    assert sorted(np.sign(norths)) == [-1.0, 1.0]
    assert max(map(abs, norths)) < 100.0
    for one, north in zip(offered, norths, strict=True):
        mesh = package.reconstruct(points, viewpoints=one, executor="serial")
        made = Mesh(np.array(mesh.vertices), np.array(mesh.faces))
        assert np.sign(axes[1] @ face(made)) == np.sign(north)
