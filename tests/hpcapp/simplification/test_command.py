"""The command ``simplify``: what it says, and what it refuses."""

from __future__ import annotations

import logging
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from verbs import run_verb

from hpcapp.geometry.mesh import Mesh
from hpcapp.io import find_mesh_crs, read_mesh, write_mesh
from hpcapp.io.crs import UNKNOWN, Crs
from hpcapp.io.meshes.mesh_stream import as_stream
from hpcapp.simplification.command import simplify
from hpccomponent.errors import InputError, UsageError

run = partial(run_verb, simplify)


@pytest.fixture
def plane(tmp_path: Path) -> Path:
    """A flat square of 200 triangles."""
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(11.0), np.arange(11.0)))
    corners = np.array([[11 * i + j for j in range(10)] for i in range(10)]).ravel()
    faces = np.concatenate([
        np.stack([corners, corners + 1, corners + 12], axis=1),
        np.stack([corners, corners + 12, corners + 11], axis=1),
    ])  # fmt: skip
    write_mesh(tmp_path / "plane.ply", Mesh(np.stack([x, y, 0.0 * x], axis=1), faces))
    return tmp_path / "plane.ply"


@pytest.mark.parametrize("tolerance", ["1", "9e15"])
def test_a_tolerance_may_be_as_large_as_it_likes(
    plane: Path, tmp_path: Path, tolerance: str
) -> None:
    run(plane, "-o", tmp_path / "light.ply", "--tolerance", tolerance)
    assert 0 < len(read_mesh(tmp_path / "light.ply").faces) < 200


def test_faces_that_cannot_go_are_told(
    plane: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    mesh = read_mesh(plane)
    apart = Mesh(mesh.vertices[mesh.faces.ravel()], np.arange(600).reshape(-1, 3), mesh.origin)
    write_mesh(tmp_path / "apart.ply", apart)
    caplog.set_level(logging.INFO, "hpcapp")
    run(tmp_path / "apart.ply", "-o", tmp_path / "light.ply", "--faces", "50")
    assert "warning: 200 faces are left" in caplog.text


def test_what_coordinates_mean_is_kept(plane: Path, tmp_path: Path) -> None:
    crs, survey, light = Crs("EPSG:2229", "US ft", "m"), tmp_path / "a.ply", tmp_path / "light.ply"
    write_mesh(survey, replace(as_stream(read_mesh(plane)), crs=crs))
    run(survey, "-o", light, "--faces", "50")
    lines = b"comment unit US ft\ncomment height_unit m\ncomment crs EPSG:2229\n"
    assert lines in light.read_bytes()
    assert find_mesh_crs(light) == crs
    run(plane, "-o", light, "--faces", "50")
    assert find_mesh_crs(light) == UNKNOWN
    write_mesh(tmp_path / "a.obj", read_mesh(plane))
    assert find_mesh_crs(tmp_path / "a.obj") == UNKNOWN


def test_bad_input_leaves_nothing(plane: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="nothing to simplify to"):
        run(plane, "-o", tmp_path / "light.ply")
    with pytest.raises(InputError, match="nowhere"):
        run("nowhere.ply", "-o", tmp_path / "light.ply", "--faces", "50")
    assert not (tmp_path / "light.ply").exists()


def test_a_part_of_a_mesh_is_left_as_fine_as_it_is(plane: Path, tmp_path: Path) -> None:
    part, light = tmp_path / "part.ply", tmp_path / "light.ply"
    run(plane, "-o", part, "--polygon", "POLYGON ((0.5 0.5, 9.5 0.5, 0.5 9.5, 0.5 0.5))")
    mesh = read_mesh(part)
    assert mesh.vertices[:, :2].min() == pytest.approx(0.5)
    assert mesh.vertices[:, :2].sum(axis=1).max() == pytest.approx(10.0)
    run(plane, "-o", light, "--box", "0,0,-1,5,5,1", "--faces", "10")
    assert len(read_mesh(light).faces) <= 11
    assert read_mesh(light).vertices.max() == 5.0


def test_a_ball_of_a_mesh_in_two_units_is_one_of_feet(tmp_path: Path) -> None:
    path, part = tmp_path / "wall.ply", tmp_path / "part.ply"
    wall = Mesh(np.array([[-9.0, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9]]),
                np.array([[0, 1, 2], [0, 2, 3]]))  # fmt: skip
    write_mesh(path, replace(as_stream(wall), crs=Crs("EPSG:2229", "ft", "m")))
    run(path, "-o", part, "--around", "0,0,0,3")
    reach = np.linalg.norm(read_mesh(part).vertices * (1.0, 1.0, 1 / 0.3048), axis=1)
    assert reach.max() == pytest.approx(3.0, abs=1e-4)
    assert find_mesh_crs(part).height_unit == "m"


def test_a_part_that_holds_nothing_is_one_line(plane: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no surface in the ball") as found:
        run(plane, "-o", tmp_path / "none.ply", "--around", "50,0,0,3")
    assert "lies from 0 0 0 to 10 10 0" in found.value.advice
