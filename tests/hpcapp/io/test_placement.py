"""Meshes far from zero: what is subtracted, where that is said, and that it comes back."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hpcapp.geometry.mesh import Mesh
from hpcapp.io import find_mesh_crs, read_mesh, write_mesh
from hpcapp.io.crs import UNKNOWN, Crs
from hpcapp.io.glb.reader import read_glb
from hpcapp.io.meshes.mesh_stream import as_stream
from hpcapp.io.meshes.obj import read_obj
from hpcapp.io.meshes.stl import read_stl
from hpcapp.io.placement import Placement, parse_origin
from hpccomponent.errors import InputError, UsageError

MAP = np.array([512025.0, 5403025.0, 300.25])
NEAR = {".glb": read_glb, ".obj": read_obj, ".stl": read_stl}
FRAME = Crs("EPSG:25832", "m")


@pytest.fixture
def mapped(tetrahedron: Mesh) -> Mesh:
    """A mesh with the coordinates of a map."""
    return replace(tetrahedron, origin=MAP)


def _places(mesh: Mesh) -> set[tuple[float, ...]]:
    return {tuple(vertex) for vertex in (mesh.vertices + mesh.origin).tolist()}


@pytest.mark.parametrize("suffix", [*NEAR, ".ply", ".off", ".vtp"])
@pytest.mark.parametrize("origin", ["auto", "keep", (512000.0, 5403000.0, 0.0)])
def test_a_mesh_comes_back_to_its_place(
    tmp_path: Path, mapped: Mesh, suffix: str, origin: str | tuple[float, float, float]
) -> None:
    path = tmp_path / f"mesh{suffix}"
    write_mesh(path, mapped, Placement(origin))
    near = 1.0 if suffix == ".stl" and origin == "keep" else 1e-4
    found, truth = np.array(sorted(_places(read_mesh(path)))), np.array(sorted(_places(mapped)))
    if len(found) == len(truth):  # single precision makes corners of an STL one
        np.testing.assert_allclose(found, truth, rtol=0, atol=near)
    else:
        assert (suffix, origin) == (".stl", "keep")


@pytest.mark.parametrize("suffix", NEAR)
def test_formats_of_single_precision_are_near_zero(
    tmp_path: Path, mapped: Mesh, suffix: str
) -> None:
    path = tmp_path / f"mesh{suffix}"
    write_mesh(path, replace(as_stream(mapped), crs=FRAME))
    alone = NEAR[suffix](path)
    assert not alone.origin.any()
    assert np.abs(alone.vertices).max() == 1.5
    said = json.loads((tmp_path / f"mesh{suffix}.origin.json").read_text())
    assert said == {"origin": MAP.tolist(), "unit": "m", "crs": "EPSG:25832"}
    assert find_mesh_crs(path) == FRAME
    assert b"512025 5403025 300.25" in path.read_bytes()  # who has the file alone can see it


def test_a_3mf_says_what_was_subtracted(tmp_path: Path, mapped: Mesh) -> None:
    from zipfile import ZipFile

    write_mesh(tmp_path / "mesh.3mf", mapped)
    model = ZipFile(tmp_path / "mesh.3mf").read("3D/3dmodel.model")
    assert b"origin 512025 5403025 300.25<" in model
    assert b"transform" not in model


def test_an_old_note_does_not_move_a_new_mesh(tmp_path: Path, mapped: Mesh) -> None:
    path = tmp_path / "mesh.obj"
    write_mesh(path, mapped)
    write_mesh(path, mapped, Placement("keep"))
    assert [file.name for file in tmp_path.iterdir()] == ["mesh.obj"]
    assert _places(read_mesh(path)) == _places(mapped)


def test_an_stl_keeps_its_unit_beside_it(
    tmp_path: Path, tetrahedron: Mesh, caplog: pytest.LogCaptureFixture
) -> None:
    write_mesh(tmp_path / "mesh.stl", replace(as_stream(tetrahedron), crs=FRAME))
    assert find_mesh_crs(tmp_path / "mesh.stl") == FRAME
    assert not caplog.messages


def test_what_single_precision_does_to_a_map_is_said(
    tmp_path: Path, mapped: Mesh, caplog: pytest.LogCaptureFixture
) -> None:
    write_mesh(tmp_path / "mesh.stl", mapped, Placement("keep"))
    (line,) = caplog.messages
    assert line.endswith("mesh.stl: single precision rounds its coordinates to 0.5")


@pytest.mark.parametrize("text", ["here", "1,2", "1,2,3,4", "1,2,nan", "1,2,inf", "1,2,1e300", ""])
def test_an_origin_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="is no place"):
        parse_origin(text)


@pytest.mark.parametrize(
    "note",
    ["", "[]", "{}", '{"origin": [1, 2]}', '{"origin": [1, 2, "3"]}', '{"origin": [1, 2, 1e999]}',
     '{"origin": [1, 2, 3], "crs": "\\ud800"}'],
)  # fmt: skip
def test_a_damaged_note_is_said(tmp_path: Path, tetrahedron: Mesh, note: str) -> None:
    path = tmp_path / "mesh.obj"
    write_mesh(path, tetrahedron)
    assert find_mesh_crs(path) == UNKNOWN
    (tmp_path / "mesh.obj.origin.json").write_text(note)
    with pytest.raises(InputError, match=r"mesh.obj.origin.json: does not say where mesh.obj is"):
        read_mesh(path)
