"""A format that knows vertices by their places alone keeps closed what is closed."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from closed_meshes import closed_meshes, is_closed, make_closed
from hypothesis import given, settings
from hypothesis import strategies as st

from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.mesh import Mesh
from hpcapp.io import read_mesh, write_mesh
from hpcapp.io.placement import Placement
from hpccomponent.errors import OutputError

FAR = np.array([3000.0, -5000.0, 0.0])


@given(closed_meshes, st.booleans())
@settings(deadline=None, max_examples=40)
def test_vertices_on_one_another_stay_apart(mesh: Mesh, is_far: bool) -> None:
    placed = Mesh(mesh.vertices, mesh.faces, FAR * is_far)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "mesh.stl"
        write_mesh(path, placed, Placement("keep"))
        again = read_mesh(path)
    assert is_closed(again)
    places = (again.vertices + again.origin)[again.faces]
    step = np.spacing(np.float32(5010.0 if is_far else 5.0))
    assert np.abs(places - (mesh.vertices + placed.origin)[mesh.faces]).max() <= 1.5 * step


def test_borders_that_meet_are_joined_by_who_reads(tmp_path: Path) -> None:
    mesh = make_closed(1)
    cube = Mesh(mesh.vertices[:8], mesh.faces[(mesh.faces < 8).all(axis=1)])
    apart = Mesh(cube.vertices[cube.faces].reshape(-1, 3), np.arange(36).reshape(-1, 3))
    write_mesh(tmp_path / "mesh.stl", apart)
    again = read_mesh(tmp_path / "mesh.stl")
    assert check_mesh(again).watertight
    np.testing.assert_array_equal(again.vertices[again.faces], cube.vertices[cube.faces])


def test_what_single_precision_cannot_tell_apart_is_said(tmp_path: Path) -> None:
    mesh = make_closed(1)
    far = Mesh(1e-3 * mesh.vertices, mesh.faces, 1e6 * FAR)
    with pytest.raises(OutputError, match=r"fall on one another.*origin='auto'"):
        write_mesh(tmp_path / "mesh.stl", far, Placement("keep"))
    assert not (tmp_path / "mesh.stl").exists()


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".off", ".ply", ".vtp"])
def test_other_formats_name_their_vertices(tmp_path: Path, suffix: str) -> None:
    for seed in range(5):
        mesh = make_closed(seed, thin=True)
        write_mesh(tmp_path / f"mesh{suffix}", mesh)
        again = read_mesh(tmp_path / f"mesh{suffix}")
        assert is_closed(again)
        assert len(again.faces) == len(mesh.faces)
