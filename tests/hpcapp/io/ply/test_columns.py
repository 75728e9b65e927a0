from __future__ import annotations

from pathlib import Path

import numpy as np

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.io import read_mesh, write_mesh
from hpcapp.io.ply.columns import VertexProperties


def test_a_mesh_with_everything_has_it_in_its_rows(tmp_path: Path, painted: Mesh) -> None:
    write_mesh(tmp_path / "mesh.ply", painted)
    head, _, body = (tmp_path / "mesh.ply").read_bytes().partition(b"end_header\n")
    lines = head.decode("ascii").splitlines()
    assert [line.removeprefix("property ") for line in lines if "property" in line] == [
        "double x", "double y", "double z", "float nx", "float ny", "float nz",
        "uchar red", "uchar green", "uchar blue", "ushort intensity", "double gps_time",
        "uchar is_<good>", "double number", "float half", "list uchar int vertex_indices",
    ]  # fmt: skip
    dtype = np.dtype(
        [("place", "<f8", 3), ("normal", "<f4", 3), ("colour", "u1", 3), ("intensity", "<u2"),
         ("time", "<f8"), ("good", "u1"), ("number", "<f8"), ("half", "<f4")]
    )  # fmt: skip
    rows = np.frombuffer(body, dtype, 4)
    assert painted.normals is not None
    np.testing.assert_array_equal(rows["place"], painted.vertices + painted.origin)
    np.testing.assert_array_equal(rows["normal"], painted.normals.astype(np.float32))
    np.testing.assert_array_equal(rows["colour"], painted.colours)
    np.testing.assert_array_equal(rows["time"], painted.attributes["gps time"])
    np.testing.assert_array_equal(rows["number"], painted.attributes["number"])
    assert len(body) == 4 * dtype.itemsize + 4 * 13


def test_names_are_told_apart_from_one_another_and_from_the_coordinates() -> None:
    columns = {name: np.zeros(0, np.int8) for name in ("x", "a b", "a_b", "red", "größe", "")}
    properties = VertexProperties.of(PointCloud(np.zeros((0, 3)), None, None, columns))
    assert properties.names == ("x_2", "a_b", "a_b_2", "red_2", "gr__e", "_")
    assert properties.lines[0] == "property char x_2"


def test_a_mesh_is_read_with_what_its_vertices_carry(tmp_path: Path, painted: Mesh) -> None:
    write_mesh(tmp_path / "mesh.ply", painted)
    again = read_mesh(tmp_path / "mesh.ply")
    np.testing.assert_array_equal(again.faces, painted.faces)
    np.testing.assert_array_equal(again.colours, painted.colours)
    assert again.normals is not None
    assert painted.normals is not None
    np.testing.assert_allclose(again.normals, painted.normals, atol=1e-7)
    found = {name: column.dtype.str for name, column in again.attributes.items()}
    assert found == {
        "intensity": "<u2", "gps_time": "<f8", "is_<good>": "|u1", "number": "<f8", "half": "<f4",
    }  # fmt: skip
    write_mesh(tmp_path / "again.ply", again)
    assert (tmp_path / "again.ply").read_bytes() == (tmp_path / "mesh.ply").read_bytes()
