"""A disk that is full is one line, whoever writes, and leaves nothing."""

from __future__ import annotations

import resource
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import hpcapp
from hpcapp.geometry.points import PointCloud

Run = Callable[..., tuple[int, str, str]]

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
    ["heights", "points.ply", "-o", "out.tif", "--contours", "out.geojson", "--interval", "0.01"],
    ["simulate", "--shape", "sphere", "--points", "500", "-o", "out.ply"],
    ["reconstruct", "points.ply", "-o", "out.ply", "--report", "out.html", "--grid", "16"],
]  # fmt: skip


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ground as points, and a closed mesh."""
    folder = tmp_path_factory.mktemp("inputs")
    rng = np.random.default_rng(3)
    places = np.column_stack([rng.random((1000, 2)) * 10.0, rng.normal(scale=0.01, size=1000)])
    hpcapp.write_points(folder / "points.ply", PointCloud(places))
    normals = rng.normal(size=(300, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    hpcapp.reconstruct(PointCloud(normals, normals), grid=16).save(folder / "mesh.ply")
    return folder


@pytest.mark.parametrize("words", WRITERS, ids=" ".join)
@pytest.mark.parametrize("most", [0, 400])
def test_a_full_disk_is_one_line(
    run: Run, inputs: Path, tmp_path: Path, words: list[str], most: int
) -> None:
    paths = [str(inputs / word) if word in ("points.ply", "mesh.ply") else word for word in words]
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, hard))  # bytes of any file
    try:
        code, _, said = run("-q", *paths)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert code == 2
    assert "cannot be written: " in said
    assert said.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
