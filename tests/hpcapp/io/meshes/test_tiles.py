"""A folder of tiles appears whole, in a new place, or not at all."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hpcapp.geometry.mesh import Mesh
from hpcapp.io import check_writable, read_mesh, write_mesh
from hpcapp.io.meshes.mesh_stream import MeshStream
from hpcapp.io.meshes.tiles import write_tiles
from hpccomponent.errors import OutputError


@pytest.fixture
def triangle() -> Mesh:
    return Mesh(np.eye(3), np.array([[0, 1, 2]]))


def test_a_mesh_in_memory_is_one_tile(tmp_path: Path, triangle: Mesh) -> None:
    path = tmp_path / "mesh.tiles"
    check_writable(path)
    assert not list(tmp_path.iterdir())
    path.mkdir()  # an empty folder may be there
    write_mesh(path, triangle)
    assert [tile.name for tile in path.iterdir()] == ["tile-0000.ply"]
    assert np.array_equal(read_mesh(path / "tile-0000.ply").vertices, triangle.vertices)


def test_a_folder_that_holds_something_is_left_alone(tmp_path: Path) -> None:
    folder = tmp_path / "mesh.tiles"
    folder.mkdir()
    (folder / "keep.txt").write_text("mine")
    with pytest.raises(OutputError, match="is not empty"):
        check_writable(folder)
    with pytest.raises(OutputError, match="is not empty"):
        write_tiles(folder, iter(()))
    assert [path.name for path in folder.iterdir()] == ["keep.txt"]


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "mesh.tiles").write_text("a file")
    with pytest.raises(OutputError, match="is not a folder"):
        check_writable(tmp_path / "mesh.tiles")


def test_a_missing_folder_around_it_is_named(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="create the folder"):
        check_writable(tmp_path / "nowhere" / "mesh.tiles")


def test_nothing_is_left_of_tiles_that_fail(tmp_path: Path) -> None:
    def tiles() -> Iterator[tuple[int, MeshStream]]:
        raise RuntimeError
        yield

    with pytest.raises(RuntimeError):
        write_tiles(tmp_path / "mesh.tiles", tiles())
    assert not list(tmp_path.iterdir())
