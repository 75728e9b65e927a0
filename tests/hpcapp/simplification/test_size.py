"""A file of a size: as many triangles as fit, found in a bounded number of tries."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from level_sets import mesh_level_set

from hpcapp.geometry.mesh import Mesh
from hpcapp.io import read_mesh, write_mesh
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
