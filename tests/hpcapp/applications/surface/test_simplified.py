"""Jobs with --faces and --tolerance: one mesh, wherever the points and the parts are."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from directions import random_directions
from little_memory import leave_little_memory

from hpcapp.api.reconstruction import reconstruct
from hpcapp.applications.surface.cli.run import run_job
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.geometry.points import PointCloud
from hpcapp.io import read_mesh, write_points
from hpcapp.progress import Progress
from hpcapp.simplification.command import simplify
from hpccomponent.errors import UsageError


def make_ball(points: int = 8000) -> PointCloud:
    normals = random_directions(points, 3)
    colours = np.where(normals[:, :1] > 0, 255, 0).astype(np.uint8) * np.ones(3, np.uint8)
    return PointCloud(normals.copy(), normals, colours, origin=np.array([4e5, 5e6, 0.0]))


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    path = tmp_path / "scan.ply"
    write_points(path, make_ball())
    return path


def test_points_on_disk_and_tiles_give_the_same_light_mesh(
    scan: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    outputs = [scan.with_name(name) for name in ("memory.ply", "disk.ply")]
    report = run_job(JobSettings(scan, str(outputs[0]), grid=48, faces=1500), Progress())
    assert (report["tiles"], report["watertight"]) == (1, True)
    assert 1000 < report["faces"] <= 1500
    assert "simplify" in report["stages"]
    leave_little_memory(monkeypatch, 2000)
    settings = JobSettings(scan, str(outputs[1]), grid=48, faces=1500, backend="threads", workers=2)
    assert run_job(settings, Progress())["tiles"] > 1
    assert outputs[0].read_bytes() == outputs[1].read_bytes()
    light = read_mesh(outputs[0])
    assert light.colours is not None
    far = np.abs(light.vertices[:, 0] + light.origin[0] - 4e5) > 0.2
    is_red = light.vertices[:, 0] + light.origin[0] > 4e5
    assert ((light.colours[:, 0] > 127) == is_red)[far].all()
    radii = np.linalg.norm(light.vertices + light.origin - (4e5, 5e6, 0), axis=1)
    assert np.abs(radii - 1.0).max() < 0.02


def test_from_python_too() -> None:
    cloud = make_ball(4000)
    light = reconstruct(cloud, grid=48, tolerance=0.02, executor="serial")
    assert len(light.faces) < len(reconstruct(cloud, grid=48, executor="serial").faces) / 2
    with pytest.raises(UsageError, match="faces is 2"):
        reconstruct(cloud, faces=2)


def test_what_cannot_be_reached_is_said(scan: Path) -> None:
    settings = JobSettings(scan, str(scan.with_name("few.ply")), grid=32, faces=4)
    report = run_job(settings, Progress())
    assert report["watertight"]
    if report["faces"] > 4:
        assert any("faces are left" in warning for warning in report["warnings"])


def test_a_mesh_that_is_there(scan: Path) -> None:
    mesh, light = scan.with_name("mesh.ply"), scan.with_name("light.3dtiles")
    run_job(JobSettings(scan, str(mesh), grid=48), Progress())
    run = CliRunner().invoke(simplify, [str(mesh), "-o", str(light), "--faces", "1000"])
    assert run.exception is None
    tileset = json.loads((light / "tileset.json").read_text())
    origin = read_mesh(mesh).origin
    np.testing.assert_array_equal(tileset["root"]["transform"][12:15], origin)
    run = CliRunner().invoke(simplify, [str(mesh), "-o", str(mesh.with_name("x.ply"))])
    assert isinstance(run.exception, UsageError)
