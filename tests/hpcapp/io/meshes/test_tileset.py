from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from level_sets import mesh_level_set
from numpy.typing import NDArray

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray
from hpcapp.io.meshes.tileset import write_tileset
from hpccomponent.errors import OutputError


@pytest.fixture(scope="module")
def ball() -> Mesh:
    mesh = mesh_level_set(lambda x, y, z: np.hypot(np.hypot(x, y), 0.7 * z) - 0.8, 1.2, 40)
    colours = np.full((len(mesh.vertices), 3), 90, np.uint8)
    return replace(mesh, origin=np.array([4e5, 5e6, 20.0]), colours=colours)


def read_tile(path: Path) -> tuple[dict[str, Any], FloatArray, NDArray[np.integer]]:
    """Return the JSON, and places (in the tileset's frame) and faces, of a GLB."""
    raw = path.read_bytes()
    size = int.from_bytes(raw[12:16], "little")
    told, body = json.loads(raw[20 : 20 + size]), raw[28 + size :]
    arrays = []
    (primitive,) = told["meshes"][0]["primitives"]
    for number, dtype in (
        (primitive["attributes"]["POSITION"], "<f4"),
        (primitive["indices"], "<u4"),
    ):
        view = told["bufferViews"][told["accessors"][number]["bufferView"]]
        part = body[view["byteOffset"] :][: view["byteLength"]]
        arrays.append(np.frombuffer(part, dtype).reshape(-1, 3))
    matrix = np.array(told["nodes"][0]["matrix"], float).reshape(4, 4).T
    in_gltf = arrays[0] @ matrix[:3, :3].T
    x, y, z = in_gltf.T
    return told, np.stack([x, -z, y], axis=1), arrays[1]  # 3D Tiles turn y up into z up


def walk(tile: dict[str, Any]) -> Iterator[dict[str, Any]]:
    yield tile
    for child in tile.get("children", ()):
        yield from walk(child)


def test_a_tree_of_tiles_is_the_mesh_at_its_leaves(tmp_path: Path, ball: Mesh) -> None:
    folder = tmp_path / "mesh.3dtiles"
    write_tileset(folder, ball, tile_faces=1500)
    tileset = json.loads((folder / "tileset.json").read_text())
    root = tileset["root"]
    assert tileset["asset"]["version"] == "1.1"
    assert tileset["geometricError"] >= root["geometricError"] > 0
    assert root["refine"] == "REPLACE"
    np.testing.assert_array_equal(np.reshape(root["transform"], (4, 4))[3, :3], ball.origin)
    tiles = list(walk(root))
    assert {tile["content"]["uri"] for tile in tiles} | {"tileset.json"} == {
        file.name for file in folder.iterdir()
    }
    triangles = []
    for tile in tiles:
        told, places, faces = read_tile(folder / tile["content"]["uri"])
        assert "COLOR_0" in told["meshes"][0]["primitives"][0]["attributes"]
        assert len(faces) < 2 * 1500
        box = np.array(tile["boundingVolume"]["box"])
        half = box[3:].reshape(3, 3).diagonal()
        assert (np.abs(places - box[:3]) <= half + 1e-6).all()
        assert all(
            tile["geometricError"] > child["geometricError"] for child in tile.get("children", ())
        )
        if "children" not in tile:
            assert tile["geometricError"] == 0
            triangles.append(places[faces])
    found = np.concatenate(triangles).reshape(-1, 9)
    wanted = ball.vertices.astype(np.float32)[ball.faces].reshape(-1, 9)
    np.testing.assert_array_equal(np.unique(found, axis=0), np.unique(wanted, axis=0))


def test_levels_fit_side_by_side(tmp_path: Path, ball: Mesh) -> None:
    """A coarse half and the leaves of the other half close the surface together."""
    folder = tmp_path / "mesh.3dtiles"
    write_tileset(folder, ball, tile_faces=1500)
    coarse, fine = json.loads((folder / "tileset.json").read_text())["root"]["children"]
    chosen = [coarse, *(tile for tile in walk(fine) if "children" not in tile)]
    corners = []
    for tile in chosen:
        _, places, faces = read_tile(folder / tile["content"]["uri"])
        corners.append(places[faces].reshape(-1, 3))
    _, rows = np.unique(np.concatenate(corners), axis=0, return_inverse=True)
    faces = rows.reshape(-1, 3)
    sides = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, counts = np.unique(sides, axis=0, return_counts=True)
    assert (counts == 2).all()


def test_a_small_mesh_is_one_tile(tmp_path: Path, tetrahedron: Mesh) -> None:
    write_tileset(tmp_path / "mesh.3dtiles", tetrahedron)
    root = json.loads((tmp_path / "mesh.3dtiles" / "tileset.json").read_text())["root"]
    assert "children" not in root
    assert "transform" not in root
    with pytest.raises(OutputError, match="is not empty"):
        write_tileset(tmp_path / "mesh.3dtiles", tetrahedron)
