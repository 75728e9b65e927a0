from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hpcapp.geometry.mesh import Mesh
from hpcapp.io.meshes.stl import read_stl, write_stl
from hpccomponent.errors import InputError

Make = Callable[..., Path]
CORNERS = "  vertex 0 0 0\n  vertex 1 0 0\n  vertex 0 1 -0.0\n"
FACET = f"facet normal 0 0 1\n outer loop\n{CORNERS} endloop\nendfacet\n"


def test_ascii_is_read_and_corners_are_joined(make_file: Make) -> None:
    turned = FACET.replace("vertex 1 0 0", "vertex -1 -0 0")
    mesh = read_stl(make_file("a.stl", f"solid two\n{FACET}{turned}endsolid two\n"))
    assert mesh.vertices.shape == (4, 3)
    assert mesh.faces.shape == (2, 3)


def test_a_binary_file_that_starts_with_solid_is_binary(tmp_path: Path, tetrahedron: Mesh) -> None:
    path = tmp_path / "mesh.stl"
    write_stl(path, tetrahedron)
    path.write_bytes(b"solid" + path.read_bytes()[5:])
    assert read_stl(path).faces.shape == (4, 3)


def test_normals_point_out_and_faces_without_area_have_none(tmp_path: Path) -> None:
    vertices = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    write_stl(tmp_path / "a.stl", Mesh(vertices, np.array([[0, 1, 2], [0, 1, 1]])))
    head = np.frombuffer((tmp_path / "a.stl").read_bytes()[84:], "<f4", 3)
    assert head.tolist() == [0, 0, 1]
    assert np.frombuffer((tmp_path / "a.stl").read_bytes()[134:], "<f4", 3).tolist() == [0, 0, 0]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("solid empty\nendsolid\n", "no triangles"),
        (f"solid cut\n{FACET}  vertex 1 2 3\n", "4 corners are no whole number of triangles"),
        (f"solid cut\n{FACET}", "its last line is not 'endsolid'"),
        ("solid bad\nvertex 1 2 x\n", ":2: 'x' is not a number"),
        (b"\0" * 80 + b"\2\0\0\0" + b"\0" * 50, "truncated"),
        (b"\0" * 80 + b"\xff\xff\xff\xff", "truncated"),
        (b"\0" * 84, "no triangles"),
    ],
)
def test_damaged_files_are_refused(make_file: Make, content: str | bytes, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_stl(make_file("bad.stl", content))
