"""Meshes as clouds: each place once, normals from the faces or the file's own."""

from pathlib import Path

import numpy as np
import pytest

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray
from hpcapp.io import read_whole
from hpcapp.io.meshes.stl import write_stl
from hpcapp.io.points.mesh_points import open_obj, open_off, open_stl
from hpccomponent.errors import InputError

OCTAHEDRON = np.array(
    [[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], np.float64
)
FACES = np.array([[i, (i + 1) % 4, 4] for i in range(4)] + [[(i + 1) % 4, i, 5] for i in range(4)])


def as_obj(vertices: FloatArray, *, faces: bool = True, more: str = "") -> str:
    lines = ["v {} {} {}".format(*row) for row in vertices]
    if faces:
        lines += ["f {} {} {}".format(*(row + 1)) for row in FACES]
    return "\n".join(lines) + f"\n{more}"


def test_normals_point_out_of_a_closed_mesh(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(as_obj(OCTAHEDRON))
    cloud = read_whole(open_obj(tmp_path / "a.obj"))
    assert cloud.normals is not None
    np.testing.assert_allclose(cloud.normals, OCTAHEDRON, atol=1e-12)


def test_a_vertex_without_a_face_is_left_out_and_counted(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text(as_obj(np.vstack([OCTAHEDRON, [[7.0, 7.0, 7.0]]])))
    source = open_obj(tmp_path / "a.obj")
    assert len(read_whole(source)) == 6
    assert source.findings.dropped == {"vertices without a face": 1}


def test_an_obj_without_faces_has_its_own_normals(tmp_path: Path) -> None:
    normals = "\n".join("vn {} {} {}".format(*row) for row in OCTAHEDRON)
    (tmp_path / "a.obj").write_text(as_obj(2 * OCTAHEDRON, faces=False, more=normals))
    cloud = read_whole(open_obj(tmp_path / "a.obj"))
    np.testing.assert_array_equal(cloud.normals, OCTAHEDRON)


def test_colours_follow_the_coordinates(tmp_path: Path) -> None:
    (tmp_path / "a.obj").write_text("v 0 0 0 0.5 0 1\nv 1 0 0 0 1 0\n")
    cloud = read_whole(open_obj(tmp_path / "a.obj"))
    np.testing.assert_array_equal(cloud.colours, [[0.5, 0, 1], [0, 1, 0]])


@pytest.mark.parametrize("text", ["", "# nothing\n", "v 1 2\n", "v 1 2 x\n", "v 1 2 3\nv 1 2\n"])
def test_a_bad_obj_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.obj").write_text(text)
    with pytest.raises(InputError, match=r"a\.obj"):
        open_obj(tmp_path / "a.obj")


def test_each_place_of_an_stl_is_one_point(tmp_path: Path) -> None:
    write_stl(tmp_path / "a.stl", Mesh(OCTAHEDRON, FACES.astype(np.int64)))
    cloud = read_whole(open_stl(tmp_path / "a.stl"))
    assert len(cloud) == 6
    assert cloud.normals is not None
    np.testing.assert_allclose(cloud.normals, cloud.positions, atol=1e-12)


def test_an_off_is_read_as_its_vertices(tmp_path: Path) -> None:
    rows = ["{} {} {}".format(*row) for row in OCTAHEDRON]
    rows += ["3 {} {} {}".format(*row) for row in FACES]
    (tmp_path / "a.off").write_text("OFF\n6 8 0\n" + "\n".join(rows))
    np.testing.assert_array_equal(read_whole(open_off(tmp_path / "a.off")).positions, OCTAHEDRON)
