"""GLB and VTP are read as they were written, by us and by others, and damage is said."""

from __future__ import annotations

import base64
import json
import zlib
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.io import holds_faces, read_mesh, write_mesh, write_points
from hpccomponent.errors import InputError


@pytest.mark.parametrize("suffix", [".glb", ".vtp", ".ply"])
def test_a_mesh_with_everything_comes_back(tmp_path: Path, painted: Mesh, suffix: str) -> None:
    path = tmp_path / f"m{suffix}"
    write_mesh(path, painted)
    back = read_mesh(path)
    np.testing.assert_array_equal(back.faces, painted.faces)
    moved = back.vertices + back.origin - painted.vertices - painted.origin
    assert np.abs(moved).max() < 1e-6
    np.testing.assert_array_equal(back.colours, painted.colours)
    assert len(back.attributes) == len(painted.attributes)
    intensity = back.attributes["intensity"].astype(float)
    np.testing.assert_array_equal(intensity, painted.attributes["intensity"])


def test_colours_of_an_obj_come_back(tmp_path: Path, painted: Mesh) -> None:
    write_mesh(tmp_path / "m.obj", painted)
    np.testing.assert_array_equal(read_mesh(tmp_path / "m.obj").colours, painted.colours)


def make_glb(nodes: list[dict[str, object]], indices: bytes, kind: int, count: int) -> bytes:
    """Return a GLB of one triangle with interleaved places, put where `nodes` say."""
    places = np.zeros((3, 6), "<f4")
    places[:, :3] = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    body = places.tobytes() + indices + b"\0" * (-len(indices) % 4)
    told = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"},
            {"bufferView": 1, "componentType": kind, "count": count, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 72, "byteStride": 24},
            {"buffer": 0, "byteOffset": 72, "byteLength": len(indices)},
        ],
        "buffers": [{"byteLength": len(body)}],
    }
    text = json.dumps(told).encode()
    text += b" " * (-len(text) % 4)
    head = np.array([2, 28 + len(text) + len(body), len(text)], "<u4").tobytes()
    return (
        b"glTF" + head + b"JSON" + text + np.array([len(body)], "<u4").tobytes() + b"BIN\0" + body
    )


def test_nodes_put_triangles_where_their_matrices_say(tmp_path: Path) -> None:
    half = 0.5**0.5
    nodes: list[dict[str, object]] = [
        {"children": [1, 2], "translation": [10, 0, 0]},
        {"mesh": 0, "rotation": [0, 0, half, half], "scale": [2, 2, 2]},  # a quarter turn about z
        {"mesh": 0, "scale": [-1, 1, 1]},
    ]
    indices = np.array([0, 1, 2], "<u2").tobytes()
    (tmp_path / "m.glb").write_bytes(make_glb(nodes, indices, 5123, 3))
    mesh = read_mesh(tmp_path / "m.glb")
    corners = (mesh.vertices + mesh.origin)[mesh.faces]
    assert corners[0] == pytest.approx(np.array([[10, 0, 0], [10, 2, 0], [8, 0, 0]]), abs=1e-6)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0).all()  # a mirrored triangle is turned round


@pytest.mark.parametrize(
    ("nodes", "indices", "said"),
    [
        ([{"mesh": 0}], [0, 1, 7], "vertex 7 of 3"),
        ([{"children": [0]}], [0, 1, 2], "in itself"),
        ([{"children": [1]}, {"children": [1]}], [0, 1, 2], "in two others, or in itself"),
        (
            [{"children": [n + 1, n + 1]} for n in range(60)] + [{"mesh": 0}],
            [0, 1, 2],
            "two others",
        ),
        (
            [{"children": [n + 1, n - 60]} for n in range(60)] + [{"mesh": 0}],
            [0, 1, 2],
            "no node -1",
        ),
        ([{"children": [n + 1]} for n in range(90)] + [{"mesh": 0}], [0, 1, 2], "too deep"),
        ([{"mesh": 0, "scale": [1e400, 1, 1]}], [0, 1, 2], "GLB|not finite"),
        ([{"mesh": 10**30}], [0, 1, 2], "IndexError"),
        ([{"mesh": 3}], [0, 1, 2], "IndexError"),
        ([{}], [0, 1, 2], "no triangles"),
    ],
)
def test_a_damaged_glb_is_said(
    tmp_path: Path, nodes: list[dict[str, object]], indices: list[int], said: str
) -> None:
    content = make_glb(nodes, np.array(indices, "u1").tobytes(), 5121, 3)
    (tmp_path / "m.glb").write_bytes(content)
    with pytest.raises(InputError, match=said):
        read_mesh(tmp_path / "m.glb")


@pytest.mark.parametrize("key", ["asset", "nodes", "extras"])
@pytest.mark.parametrize("half", ["[", '{"a":'])
def test_a_glb_that_nests_without_end_is_one_line(tmp_path: Path, key: str, half: str) -> None:
    text = f'{{"{key}": {half * 200_000}'.encode()
    text += b" " * (-len(text) % 4)
    head = np.array([2, 20 + len(text), len(text)], "<u4").tobytes()
    (tmp_path / "m.glb").write_bytes(b"glTF" + head + b"JSON" + text)
    with pytest.raises(
        InputError, match=r"m\.glb: is no whole GLB: .* (nested too deeply|Expected `)"
    ) as caught:
        read_mesh(tmp_path / "m.glb")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "value"),
    [("count", 10**30), ("count", -1), ("count", 2**40), ("byteOffset", 10**30), ("count", "3")],
)
def test_numbers_of_a_glb_that_cannot_be_are_said(tmp_path: Path, name: str, value: object) -> None:
    content = make_glb([{"mesh": 0}], np.array([0, 1, 2], "u1").tobytes(), 5121, 3)
    length = int.from_bytes(content[12:16], "little")
    told, body = json.loads(content[20 : 20 + length]), content[20 + length :]
    told["accessors"][0][name] = value
    text = json.dumps(told).encode()
    text += b" " * (-len(text) % 4)
    head = np.array([2, 20 + len(text) + len(body), len(text)], "<u4").tobytes()
    (tmp_path / "m.glb").write_bytes(b"glTF" + head + b"JSON" + text + body)
    with pytest.raises(InputError, match=r"m\.glb: is no whole GLB"):
        read_mesh(tmp_path / "m.glb")


def test_nodes_without_a_scene_are_drawn_once(tmp_path: Path) -> None:
    nodes: list[dict[str, object]] = [{"children": [1], "translation": [1, 0, 0]}, {"mesh": 0}]
    content = make_glb(nodes, np.array([0, 1, 2], "u1").tobytes(), 5121, 3)
    (tmp_path / "m.glb").write_bytes(content.replace(b'"scenes"', b'"screes"'))
    assert len(read_mesh(tmp_path / "m.glb").faces) == 1


@pytest.mark.parametrize("suffix", [".glb", ".vtp"])
def test_a_file_that_is_cut_anywhere_is_said(tmp_path: Path, painted: Mesh, suffix: str) -> None:
    path = tmp_path / f"m{suffix}"
    write_mesh(path, painted)
    whole = path.read_bytes()
    for length in range(0, len(whole) - 64, 37):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=path.name):
            read_mesh(path)


def make_vtp(form: str, compressed: bool = False) -> bytes:
    """Return a tetrahedron with a quad in a form that VTK writes."""
    arrays: list[tuple[str, str, NDArray[np.generic]]] = [
        ("Float64", "Points", np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], "<f8")),
        ("Int64", "connectivity", np.array([0, 1, 2, 3], "<i8")),
        ("Int64", "offsets", np.array([4], "<i8")),
    ]
    appended = b""
    elements = []
    for kind, name, values in arrays:
        raw = values.tobytes()
        if compressed:
            packed = zlib.compress(raw)
            head = np.array([1, len(raw), 0, len(packed)], "<u4").tobytes()
            data = base64.b64encode(head) + base64.b64encode(packed)
        else:
            data = base64.b64encode(np.array([len(raw)], "<u4").tobytes() + raw)
        where = ""
        text = b""
        if form == "ascii":
            text = " ".join(map(str, values.ravel().tolist())).encode()
        elif form == "binary":
            text = data
        else:
            where = f' offset="{len(appended)}"'
            appended += data
        open_tag = f'<DataArray type="{kind}" Name="{name}" format="{form}"{where}>'
        elements.append(open_tag.encode() + text + b"</DataArray>")
    zipped = b' compressor="vtkZLibDataCompressor"' if compressed else b""
    tail = b""
    if appended:
        tail = b'<AppendedData encoding="base64">_' + appended + b"</AppendedData>"
    return (
        b'<?xml version="1.0"?><VTKFile type="PolyData" byte_order="LittleEndian"' + zipped + b">"
        b'<PolyData><Piece NumberOfPoints="4" NumberOfPolys="1"><Points>'
        + elements[0] + b"</Points><Polys>" + b"".join(elements[1:])
        + b"</Polys></Piece></PolyData>" + tail + b"</VTKFile>"
    )  # fmt: skip


@pytest.mark.parametrize("form", ["ascii", "binary", "appended"])
@pytest.mark.parametrize("compressed", [False, True])
def test_every_form_of_vtk_is_read(tmp_path: Path, form: str, compressed: bool) -> None:
    (tmp_path / "m.vtp").write_bytes(make_vtp(form, compressed))
    mesh = read_mesh(tmp_path / "m.vtp")
    assert mesh.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
@pytest.mark.parametrize("ahead", [0, 1 << 21])
def test_a_vtp_expands_nothing(tmp_path: Path, encoding: str, ahead: int) -> None:
    declared = f'<!--{" " * ahead}--><!DOCTYPE a [<!ENTITY b "c">]>'
    bomb = f'<?xml version="1.0"?>{declared}{make_vtp("ascii")[21:].decode()}'
    (tmp_path / "m.vtp").write_bytes(bomb.encode(encoding))
    with pytest.raises(InputError, match="document type"):
        read_mesh(tmp_path / "m.vtp")


def test_faces_are_told_from_points(tmp_path: Path, painted: Mesh) -> None:
    for suffix in (".ply", ".obj"):
        write_mesh(tmp_path / f"m{suffix}", painted)
        assert holds_faces(tmp_path / f"m{suffix}")
    write_points(tmp_path / "c.ply", PointCloud(painted.vertices))
    (tmp_path / "c.obj").write_text("v 0 0 0\nv 1 1 1\n")
    assert not holds_faces(tmp_path / "c.ply")
    assert not holds_faces(tmp_path / "c.obj")
    with pytest.raises(InputError, match="cannot be read"):
        holds_faces(tmp_path / "none.ply")
