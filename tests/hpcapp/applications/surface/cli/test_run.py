from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hpcapp.applications.surface.cli.run import run_job
from hpcapp.applications.surface.hierarchical.settings import Hierarchical
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.applications.surface.methods.method import MethodSettings
from hpcapp.applications.surface.paper.settings import Paper
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.io import read_mesh, write_mesh, write_points
from hpcapp.progress import Progress
from hpccomponent.errors import HpcError, OutputError

SILENT = Progress()

PAGE = Path(__file__).parents[5] / "docs/reference/reconstruct.md"

WriteCloud = Callable[..., Path]


@pytest.mark.slow
@pytest.mark.parametrize("method", [Hierarchical(), Paper()], ids=["hierarchical", "paper"])
def test_every_backend_writes_the_same_bytes(
    method: MethodSettings, sphere_file: Path, tmp_path: Path
) -> None:
    meshes = {}
    for backend, workers in (
        ("serial", None),
        ("threads", 3),
        ("processes", 2),
        ("zmq", 1),
        ("zmq", 2),
    ):
        path = tmp_path / f"{backend}-{workers}.ply"
        settings = JobSettings(
            sphere_file, str(path), method=method, grid=32, backend=backend, workers=workers
        )
        report = run_job(settings, SILENT)
        assert report["workers"] == (workers or 1)
        assert (report["bytes_sent"] > 0) == (backend == "zmq")
        meshes[path.name] = path.read_bytes()
    assert len(set(meshes.values())) == 1


@pytest.mark.parametrize("method", [Hierarchical(), Paper()], ids=["hierarchical", "paper"])
@pytest.mark.parametrize("is_open", [False, True], ids=["closed", "open"])
def test_each_key_of_the_report_is_in_its_page(
    method: MethodSettings, is_open: bool, sphere: PointCloud, tmp_path: Path
) -> None:
    points = sphere.take(sphere.positions[:, 2] > 0.0) if is_open else sphere
    write_points(tmp_path / "points.ply", points)
    settings = JobSettings(tmp_path / "points.ply", str(tmp_path / "m.ply"), method=method, grid=32)
    report = run_job(settings, SILENT)
    assert {key for key in report if f"`{key}`" not in PAGE.read_text()} == set()


def test_three_ways_to_say_the_resolution(sphere_file: Path, tmp_path: Path) -> None:
    found = []
    for resolution in ({"grid": 32}, {"depth": 5}, {"voxel_size": 2.0 / 23.5}):
        settings = JobSettings(sphere_file, str(tmp_path / "m.ply"), **resolution)
        run_job(settings, SILENT)
        found.append((tmp_path / "m.ply").read_bytes())
    assert len(set(found)) == 1


def test_preprocessing_runs_when_asked(sphere_file: Path, tmp_path: Path) -> None:
    settings = JobSettings(
        sphere_file, str(tmp_path / "m.ply"), grid=16, outliers=True, denoise=True, resample=True
    )
    report = run_job(settings, SILENT)
    stages = list(report["stages"])
    assert stages[:4] == ["read", "arrange", "clean", "mend normals"]
    assert stages[4:7] == ["remove outliers", "denoise", "resample"]
    assert report["points"] < 1500


def test_a_georeferenced_scan_keeps_its_place(
    sphere: PointCloud, tmp_path: Path, sphere_file: Path
) -> None:
    place = np.array([5_400_000.0, 400_000.0, 100.0])
    assert sphere.normals is not None
    rows = np.hstack([sphere.positions + place, sphere.normals])
    np.savetxt(tmp_path / "far.xyz", rows, fmt="%.9f")
    run_job(JobSettings(tmp_path / "far.xyz", str(tmp_path / "far.ply"), grid=32), SILENT)
    mesh = read_mesh(tmp_path / "far.ply")
    radii = np.linalg.norm(mesh.vertices + mesh.origin - place, axis=1)
    assert np.abs(radii - 1.0).max() < 0.03


@pytest.mark.parametrize("error", [KeyboardInterrupt, OutputError("no room")])
def test_a_job_that_fails_leaves_the_old_mesh(
    error: type[BaseException] | BaseException,
    sphere_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def write_half(path: Path, mesh: Mesh, *_: object) -> None:
        def fail(*_: object) -> None:
            raise error

        monkeypatch.setattr(os, "replace", fail)
        write_mesh(path, mesh)

    monkeypatch.setattr("hpcapp.applications.surface.stitching.surface.write_mesh", write_half)
    old = tmp_path / "mesh.ply"
    old.write_bytes(b"the mesh of yesterday")
    with pytest.raises((KeyboardInterrupt, HpcError)):
        run_job(JobSettings(sphere_file, str(old), grid=16), SILENT)
    assert old.read_bytes() == b"the mesh of yesterday"
    assert {path.name for path in tmp_path.iterdir()} == {"sphere.ply", "mesh.ply"}


def test_two_objects_far_apart_are_two_components(sphere: PointCloud, tmp_path: Path) -> None:
    assert sphere.normals is not None
    rows = np.hstack([sphere.positions, sphere.normals])
    np.savetxt(tmp_path / "two.xyz", np.vstack([rows, rows + np.array([6.0, 0, 0, 0, 0, 0])]))
    report = run_job(JobSettings(tmp_path / "two.xyz", str(tmp_path / "m.ply"), grid=96), SILENT)
    assert (report["components"], report["watertight"]) == (2, True)
    assert report["warnings"] == []


def test_outliers_go_and_wrong_normals_turn_unless_told_not_to(
    sphere: PointCloud, write_cloud: WriteCloud, tmp_path: Path
) -> None:
    normals = np.concatenate([sphere.normals, np.tile([0.0, 0.0, 1.0], (5, 1))])
    normals[:10] *= -1.0
    far = np.array([[9.0, 0, 0], [-9, 3, 0], [0, 8, 8], [0, -9, 2], [3, 3, 9]])
    path = write_cloud(np.concatenate([sphere.positions, far]), normals)
    settings = JobSettings(path, str(tmp_path / "m.ply"), grid=32)
    report = run_job(settings, SILENT)
    assert (report["dropped"]["outliers"], report["turned_normals"]) == (5, 10)
    assert (report["points"], report["components"]) == (1500, 1)
    kept = run_job(replace(settings, method=Hierarchical(clean=False)), SILENT)
    assert (kept["dropped"]["outliers"], kept["turned_normals"]) == (0, 0)
    assert kept["points"] == 1505
