"""A disk that is full is one line, whoever writes, and leaves nothing."""

from __future__ import annotations

import resource
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from spheres import make_sphere

import hpcapp
from hpcapp.geometry.points import PointCloud

Run = Callable[..., tuple[int, str, str]]

CONTOURS = ["heights", "points.ply", "-o", "out.tif", "--step", "5"]
CONTOURS += ["--contours", "out.geojson", "--interval"]
WRITERS = [
    *(["mend", "mesh.ply", "--pieces", "1", "-o", f"out.{suffix}"]
      for suffix in ("ply", "obj", "off", "stl", "glb", "vtp", "3mf")),
    *(["convert", "points.ply", "-o", f"out.{suffix}"]
      for suffix in ("ply", "xyz", "pts", "las", "laz", "e57", "npz")),
    ["view", "mesh.ply", "-o", "out.html", "--no-open"],
    ["view", "mesh.ply", "--png", "out.png", "--size", "64"],
    ["info", "points.ply", "--png", "out.png"],
    ["compare", "mesh.ply", "mesh.ply", "--samples", "100", "--html", "out.html"],
    ["heights", "points.ply", "-o", "out.tif"],
    [*CONTOURS, "0.01"],
    [*CONTOURS, "1000"],  # none: few bytes
    ["simulate", "--shape", "sphere", "--points", "500", "-o", "out.ply"],
    ["reconstruct", "points.ply", "-o", "out.ply", "--report", "out.html", "--grid", "16"],
]  # fmt: skip


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ground as points, and a closed mesh."""
    folder = tmp_path_factory.mktemp("inputs")
    rng = np.random.default_rng(3)
    places = np.column_stack([rng.random((1000, 2)) * 10.0, rng.normal(0.5, 0.01, size=1000)])
    hpcapp.write_points(folder / "points.ply", PointCloud(places))
    hpcapp.reconstruct(make_sphere(300), grid=16).save(folder / "mesh.ply")
    return folder


def run_full(run: Run, inputs: Path, words: list[str], most: int) -> str:
    """Run a command where no file may have more bytes, and return the one line that it says."""
    paths = [str(inputs / word) if word in ("points.ply", "mesh.ply") else word for word in words]
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, hard))
    try:
        code, _, said = run("-q", *paths)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert code == 2
    assert "cannot be written: " in said
    assert said.count("\n") == 1
    return said


@pytest.mark.parametrize("words", WRITERS, ids=" ".join)
@pytest.mark.parametrize("most", [0, 400])
def test_a_full_disk_is_one_line(
    run: Run, inputs: Path, tmp_path: Path, words: list[str], most: int
) -> None:
    run_full(run, inputs, words, most)
    assert list(tmp_path.iterdir()) == []


def test_contours_that_find_no_room_leave_no_heights(
    run: Run, inputs: Path, tmp_path: Path
) -> None:
    assert "out.geojson" in run_full(run, inputs, [*CONTOURS, "0.0001"], 4000)
    assert list(tmp_path.iterdir()) == []


def test_a_full_temporary_folder_is_named(run: Run, inputs: Path, tmp_path: Path) -> None:
    words = ["--faces", "100", "--texture", "256", "--grid", "16"]
    said = run_full(run, inputs, ["reconstruct", "mesh.ply", "-o", "out.glb", *words], 400)
    assert f" {tempfile.gettempdir()}: a temporary file" in said
    assert "TMPDIR" in said
    assert list(tmp_path.iterdir()) == []
