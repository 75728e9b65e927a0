"""A file of a size: as many triangles as fit, found in a bounded number of tries."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from level_sets import mesh_level_set

from hpcapp.applications.surface.attributes.choice import parse_attributes
from hpcapp.applications.surface.cli.run import run_job
from hpcapp.applications.surface.job.settings import JobSettings
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.io import read_mesh, write_mesh, write_points
from hpcapp.progress import Progress
from hpcapp.simplification.command import simplify
from hpcapp.simplification.size import fit_size, read_size
from hpccomponent.errors import UsageError


@pytest.fixture(scope="module")
def ball() -> Mesh:
    mesh = mesh_level_set(lambda x, y, z: np.hypot(np.hypot(x, y), z) - 1.0, 1.2, 48)
    return Mesh(mesh.vertices, mesh.faces, colours=np.full((len(mesh.vertices), 3), 9, np.uint8))


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".glb", ".vtp", ".3mf", ".off", ".stl"])
def test_a_file_is_full_and_not_more(ball: Mesh, tmp_path: Path, suffix: str) -> None:
    write_mesh(tmp_path / "ball.ply", ball)
    light = tmp_path / f"light{suffix}"
    words = [str(tmp_path / "ball.ply"), "-o", str(light), "--size", "60K"]
    done = CliRunner().invoke(simplify, words, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert 0.95 * 60 * 1024 < light.stat().st_size <= 60 * 1024


def test_a_mesh_that_fits_is_left(ball: Mesh, tmp_path: Path) -> None:
    write_mesh(tmp_path / "ball.ply", ball)
    words = [str(tmp_path / "ball.ply"), "-o", str(tmp_path / "same.ply"), "--size", "20MB"]
    CliRunner().invoke(simplify, words, catch_exceptions=False)
    assert len(read_mesh(tmp_path / "same.ply").faces) == len(ball.faces)


@pytest.mark.parametrize("bytes_per_face", [16.0, 19.5, 50.0, 400.0])
def test_few_files_are_tried(bytes_per_face: float) -> None:
    tried = []

    def weigh(faces: int) -> int:
        tried.append(faces)
        return int(900 + bytes_per_face * faces**1.02)

    fits = fit_size(2_000_000, 10_000_000, weigh)
    assert 0.95 * 2_000_000 < weigh(fits) <= 2_000_000
    assert len(tried) <= 6


def test_what_cannot_fit_is_said() -> None:
    with pytest.raises(UsageError, match="does not fit in 100 bytes"):
        fit_size(100, 1000, lambda faces: 5000 + faces)
    with pytest.raises(UsageError, match="size is '20 parsecs'"):
        read_size("20 parsecs", "light.ply")
    with pytest.raises(UsageError, match="is a folder"):
        read_size("20MB", "light.3dtiles")


def test_meshes_that_are_weighed_say_nothing(
    ball: Mesh, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Far from zero, and with colours that an STL has not: each said of what is written alone."""
    write_mesh(tmp_path / "ball.ply", replace(ball, origin=np.array([5e5, 5.4e6, 0.0])))
    words = [str(tmp_path / "ball.ply"), "-o", str(tmp_path / "light.stl"), "--size", "60K"]
    with caplog.at_level("INFO", "hpcapp"):
        CliRunner().invoke(simplify, words, catch_exceptions=False)
    assert caplog.text.count("relative to") == 1
    assert caplog.text.count("no colours") == 1


def add_columns(mesh: Mesh) -> Mesh:
    rows = np.arange(len(mesh.vertices), dtype=np.float64)
    return replace(mesh, attributes={"gps_time": rows, "scan_angle": rows, "intensity": rows})


@pytest.mark.parametrize(
    ("suffix", "size", "words", "stays"),
    [
        (".glb", "60K", [], []),
        (".glb", "60K", ["--attributes", "auto,gps_time"], ["gps_time"]),
        (".glb", "60K", ["--attributes", "colours,intensity"], ["intensity"]),
        (".glb", "20M", [], ["gps_time", "scan_angle", "intensity"]),
        (".ply", "60K", [], ["gps_time", "scan_angle", "intensity"]),
    ],
)
def test_triangles_go_after_what_no_viewer_reads(
    ball: Mesh,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    suffix: str,
    size: str,
    words: list[str],
    stays: list[str],
) -> None:
    write_mesh(tmp_path / "ball.ply", add_columns(ball))
    light = tmp_path / f"light{suffix}"
    typed = [str(tmp_path / "ball.ply"), "-o", str(light), "--size", size, *words]
    with caplog.at_level("INFO", "hpcapp"):
        CliRunner().invoke(simplify, typed, catch_exceptions=False)
    mesh = read_mesh(light)
    assert list(mesh.attributes) == stays
    assert mesh.colours is not None
    said = [line for line in caplog.messages if line.startswith("left out for the size: ")]
    assert len(said) == (suffix == ".glb" and size == "60K" and "colours,intensity" not in words)
    assert all("scan_angle" in line for line in said)


def test_a_job_leaves_them_out_too(ball: Mesh, tmp_path: Path) -> None:
    """And of the place that they took twice the triangles are made."""
    cloud = PointCloud(ball.vertices, ball.vertices, ball.colours, add_columns(ball).attributes)
    write_points(tmp_path / "ball.ply", cloud)
    faces = []
    for attributes in ("auto", "auto,gps_time,scan_angle,intensity"):
        job = JobSettings(
            tmp_path / "ball.ply",
            str(tmp_path / "ball.glb"),
            grid=48,
            size=60 << 10,
            attributes=parse_attributes(attributes),
        )
        faces.append(run_job(job, Progress())["faces"])
        assert (tmp_path / "ball.glb").stat().st_size <= 60 << 10
        assert bool(read_mesh(tmp_path / "ball.glb").attributes) == (attributes != "auto")
    assert faces[0] > 1.2 * faces[1]
