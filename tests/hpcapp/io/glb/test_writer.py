from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hpcapp.geometry.axis_names import AXES
from hpcapp.geometry.mesh import Mesh
from hpcapp.io import find_mesh_up, read_mesh, write_mesh
from hpcapp.io.glb.writer import write_glb
from hpcapp.io.meshes.mesh_stream import as_stream
from hpcapp.io.meshes.texture import Texture
from hpcapp.io.placement import Placement
from hpccomponent.errors import OutputError

TYPES = {5123: "<u2", 5125: "<u4", 5126: "<f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def read_glb(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the JSON, and the arrays by their semantics, as the specification reads them."""
    raw = path.read_bytes()
    magic, version, total, size, kind = np.frombuffer(raw, "<u4", 5).tolist()
    assert (magic, version, total, kind) == (0x46546C67, 2, len(raw), 0x4E4F534A)
    assert size % 4 == 0
    told = json.loads(raw[20 : 20 + size])
    length, kind = np.frombuffer(raw, "<u4", 2, 20 + size).tolist()
    assert kind == 0x004E4942
    body = raw[28 + size :]
    assert len(body) == length == told["buffers"][0]["byteLength"]
    assert length % 4 == 0
    (primitive,) = told["meshes"][0]["primitives"]
    found = {}
    for semantic, number in {**primitive["attributes"], "faces": primitive["indices"]}.items():
        accessor = told["accessors"][number]
        view = told["bufferViews"][accessor["bufferView"]]
        dtype, width = np.dtype(TYPES[accessor["componentType"]]), WIDTHS[accessor["type"]]
        stride = view.get("byteStride", dtype.itemsize * width)
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        assert start % 4 == stride % 4 == 0
        assert accessor["count"] * stride <= view["byteLength"]
        rows = (accessor["count"], width), (stride, dtype.itemsize)
        found[semantic] = np.ndarray(rows[0], dtype, body, start, rows[1])
    return told, found


def test_a_mesh_with_everything_comes_back(tmp_path: Path, painted: Mesh) -> None:
    write_glb(tmp_path / "mesh.glb", painted)
    told, found = read_glb(tmp_path / "mesh.glb")
    node = told["nodes"][told["scenes"][told["scene"]]["nodes"][0]]
    matrix = np.reshape(node["matrix"], (4, 4)).T
    np.testing.assert_array_equal(matrix @ [1, 2, 3, 1], [4e5 + 1, 3, -(5.4e6 + 2), 1])
    np.testing.assert_array_equal(found["POSITION"], painted.vertices)
    np.testing.assert_array_equal(found["faces"].reshape(-1, 3), painted.faces)
    assert painted.normals is not None
    assert painted.colours is not None
    np.testing.assert_array_equal(found["NORMAL"], painted.normals.astype(np.float32))
    light = found["COLOR_0"] / 65535  # by IEC 61966-2-1
    assert light[1, 0] == 1.0
    assert light[2, 0] == pytest.approx(((127 / 255 + 0.055) / 1.055) ** 2.4, abs=1e-5)
    assert light[0, 1] == pytest.approx(1 / 255 / 12.92, abs=1e-5)
    assert (light[:, 3] == 1.0).all()
    np.testing.assert_array_equal(read_mesh(tmp_path / "mesh.glb").colours, painted.colours)
    (material,) = told["materials"]
    assert material["pbrMetallicRoughness"]["metallicFactor"] == 0.0  # what is left out is metal
    position, colour = (
        told["accessors"][told["meshes"][0]["primitives"][0]["attributes"][name]]
        for name in ("POSITION", "COLOR_0")
    )
    assert (position["min"], position["max"]) == ([0, 0, 0], [1, 1, 1.5])
    assert colour["normalized"]
    assert found["_INTENSITY"].ravel().tolist() == [1, 65535, 300, 4]
    assert found["_IS__GOOD_"].ravel().tolist() == [1, 0, 1, 1]
    assert found["_GPS_TIME"].ravel().tolist() == [3.5e8, 3.5e8, 0, -1]
    assert found["_HALF"].ravel().tolist() == [0.5, 1, -2, 8]


def test_a_plain_mesh_is_places_and_faces(tmp_path: Path, tetrahedron: Mesh) -> None:
    write_glb(tmp_path / "mesh.glb", tetrahedron)
    told, found = read_glb(tmp_path / "mesh.glb")
    assert set(found) == {"POSITION", "faces"}
    assert told["meshes"][0]["extras"] == {"attributes": {}}


def test_names_that_become_one_are_told_apart(tmp_path: Path, tetrahedron: Mesh) -> None:
    columns = {name: np.full(4, i) for i, name in enumerate(("a b", "A_B", "a-b"))}
    write_glb(tmp_path / "mesh.glb", replace(tetrahedron, attributes=columns))
    told, found = read_glb(tmp_path / "mesh.glb")
    names = told["meshes"][0]["extras"]["attributes"]
    assert names == {"a b": "_A_B", "A_B": "_A_B_2", "a-b": "_A_B_3"}
    assert [found[names[name]][0, 0] for name in columns] == [0, 1, 2]


def test_a_vertex_without_a_normal_gets_one_with_a_length(tmp_path: Path, painted: Mesh) -> None:
    write_glb(tmp_path / "mesh.glb", replace(painted, normals=np.zeros((4, 3))))
    assert (read_glb(tmp_path / "mesh.glb")[1]["NORMAL"] == [0, 0, 1]).all()


def test_columns_may_be_many(tmp_path: Path, painted: Mesh) -> None:
    columns = {f"a{i}": np.arange(4) * i for i in range(80)}
    write_glb(tmp_path / "mesh.glb", replace(painted, attributes=columns))
    found = read_glb(tmp_path / "mesh.glb")[1]
    assert found["_A79"].ravel().tolist() == [0, 79, 158, 237]
    np.testing.assert_array_equal(found["faces"].reshape(-1, 3), painted.faces)


def test_what_is_too_large_for_the_format_is_refused(tmp_path: Path, painted: Mesh) -> None:
    large = replace(as_stream(painted), vertex_count=10**8, face_count=2 * 10**8)
    with pytest.raises(OutputError, match="too many for a GLB"):
        write_glb(tmp_path / "mesh.glb", large)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("up", AXES)
def test_what_is_up_is_the_y_of_gltf(tmp_path: Path, painted: Mesh, up: str) -> None:
    path = tmp_path / "mesh.glb"
    write_mesh(path, painted, Placement("keep", up))
    matrix = np.reshape(read_glb(path)[0]["nodes"][0]["matrix"], (4, 4)).T
    upward = np.zeros(3)
    upward["xyz".index(up[-1])] = -1.0 if up[0] == "-" else 1.0
    np.testing.assert_array_equal(matrix[:3, :3] @ upward, [0, 1, 0])
    assert np.linalg.det(matrix[:3, :3]) == 1.0
    back = read_mesh(path)  # in the coordinates that it had
    np.testing.assert_array_equal(back.vertices, painted.vertices)
    np.testing.assert_array_equal(back.faces, painted.faces)
    np.testing.assert_array_equal(back.origin, painted.origin)


def test_times_of_gps_keep_their_differences(tmp_path: Path, tetrahedron: Mesh) -> None:
    times = 3.2e8 + np.array([0.125, 0.25, np.nan, 900.5])
    columns: dict[str, NDArray[Any]] = {
        "gps_time": times,
        "number": np.array([7, 7, 7, 7], np.int32),
    }
    write_mesh(tmp_path / "mesh.glb", replace(tetrahedron, attributes=columns))
    told, found = read_glb(tmp_path / "mesh.glb")
    offset = told["meshes"][0]["extras"]["offsets"]
    assert list(offset) == ["gps_time"]  # 7 fits single precision as it is
    assert np.diff(found["_GPS_TIME"].ravel()[:2]) == 0.125
    back = read_mesh(tmp_path / "mesh.glb").attributes["gps_time"]
    np.testing.assert_array_equal(back[[0, 1, 3]], times[[0, 1, 3]])
    assert back[2] == offset["gps_time"]  # NaN, which glTF forbids, is zero


def test_a_file_of_another_program_is_y_up(tmp_path: Path, tetrahedron: Mesh) -> None:
    path = tmp_path / "mesh.glb"
    write_mesh(path, tetrahedron, Placement(up="-x"))
    assert find_mesh_up(path) == "-x"
    foreign = path.read_bytes().replace(b'{"up":"-x"}', b'{"up":"-w"}')
    path.write_bytes(foreign)
    assert find_mesh_up(path) == "y"
    turned = read_mesh(path)  # as it stands there
    write_mesh(path, turned, Placement(up="y"))
    np.testing.assert_array_equal(read_glb(path)[1]["POSITION"], turned.vertices)


def test_what_an_editor_lists_has_a_name(tmp_path: Path) -> None:
    """Else importers number them; the file's name would make its bytes depend on it."""
    triangle = Mesh(np.eye(3), np.arange(3)[None])
    picture = np.full((4, 4, 3), 128, np.uint8)
    places, tangents = np.zeros((3, 2)), np.tile([1.0, 0.0, 0.0, 1.0], (3, 1))
    texture = Texture(places, tangents, picture, picture, np.arange(3))
    write_glb(tmp_path / "a.glb", replace(as_stream(triangle), texture=texture))
    told = read_glb(tmp_path / "a.glb")[0]
    names = {kind: [one["name"] for one in told[kind]] for kind in ("nodes", "meshes", "materials")}
    assert names == {"nodes": ["mesh"], "meshes": ["mesh"], "materials": ["mesh"]}
    for kind in ("images", "textures"):
        assert [one["name"] for one in told[kind]] == ["colours", "normals"]
