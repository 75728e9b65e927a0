from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hpcapp.geometry.mesh import Mesh
from hpcapp.io.meshes.obj import read_obj, write_obj
from hpccomponent.errors import InputError

Make = Callable[..., Path]
SQUARE = "v 0 0 0\nv 1 0 0 1.0\nv 1 1 0 0.5 0.5 0.5\nv 0 1 0\n"


@pytest.mark.parametrize(
    "face", ["1 2 3 4", "1/9 2/9 3/9 4/9", "1//1 2//1 3//1 4//1", "-4 -3 -2 -1"]
)
def test_corners_in_every_spelling(make_file: Make, face: str) -> None:
    text = f"# c\nmtllib a.mtl\n{SQUARE}vn 0 0 1\nusemtl b\n\nf {face}\n"
    mesh = read_obj(make_file("a.obj", text))
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        ("", "no faces"),
        ("f 1 2 five", ":5: not a face: 'f 1 2 five'"),
        ("f 1 2 " + "9" * 25, ":5: not a face"),
        ("f 1.5 2 3", ":5: not a face"),
        ("f 1 2", "face 0 has 2 corners"),
        ("f 1 2 5", "face 0 names vertex 4"),
        ("f 0 1 2", "face 0 names vertex -1"),
        ("v 1 2\nf 1 2 3", ":5: 2 columns where 3"),
        ("v\nf 1 2 3", ":5: 0 columns where 3"),
        ("v 1 2 x\nf 1 2 3", ":5: 'x' is not a number"),
    ],
)
def test_wrong_lines_are_named(make_file: Make, lines: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_obj(make_file("bad.obj", SQUARE + lines))


def test_colours_and_normals_of_vertices_are_written(tmp_path: Path, painted: Mesh) -> None:
    write_obj(tmp_path / "mesh.obj", painted)
    lines = [line.split() for line in (tmp_path / "mesh.obj").read_text().splitlines()]
    rows = np.array([line[1:] for line in lines if line[0] == "v"], float)
    np.testing.assert_array_equal(rows[:, :3], painted.vertices + painted.origin)
    np.testing.assert_array_equal(np.rint(255 * rows[:, 3:]), painted.colours)
    normals = np.array([line[1:] for line in lines if line[0] == "vn"], float)
    assert painted.normals is not None
    np.testing.assert_allclose(normals, painted.normals, atol=1e-5)
    assert lines[-1] == ["f", "1//1", "4//4", "3//3"]
    again = read_obj(tmp_path / "mesh.obj")
    np.testing.assert_array_equal(again.faces, painted.faces)
