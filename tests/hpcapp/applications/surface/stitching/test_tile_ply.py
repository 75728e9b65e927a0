"""Parts that are kept, written by a worker into a folder of tiles."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hpcapp.applications.surface.extraction.part_places import PartPlaces
from hpcapp.applications.surface.extraction.parts import MeshPart
from hpcapp.applications.surface.stitching.tile_ply import write_kept_tile
from hpccomponent.errors import OutputError
from hpccomponent.store.places import open_store


def _part(vertices: Any, faces: Any, foreign: int) -> MeshPart:
    """Return a part of one brick."""
    return MeshPart(
        np.array([7]), np.zeros(1, np.bool_), np.array([len(vertices)], np.int32),
        np.array([len(faces)], np.int32), np.array(vertices, np.float64).reshape(-1, 3),
        np.array(faces, np.int32).reshape(-1, 3), np.full(foreign, 9),
        np.arange(foreign, dtype=np.int32), np.ones(len(vertices), np.bool_),
    )  # fmt: skip


@pytest.fixture
def call(tmp_path: Path) -> tuple[object, ...]:
    """What the task is called with: a face with a corner in another part, and unused vertices."""
    part = _part([[0, 0, 0], [5, 5, 5], [1, 0, 0]], [[0, 2, -1]], foreign=1)
    other = _part([[9, 9, 9], [0, 1, 0]], [], foreign=0)
    store = open_store(str(tmp_path / "kept"))
    for name, kept in (("part", part), ("other", other)):
        store.put(name, (kept, (), ()))
    (tmp_path / "hidden").mkdir()
    places = PartPlaces(np.array([0]), np.array([0]), np.empty(0, np.int32), np.array([4]))
    foreign = (("other",), np.array([0]), np.array([1]))
    origin, comments = np.array([0.0, 0.0, 2.0]), ("comment unit m",)
    ply = (str(tmp_path / "hidden/tile.ply"), "mesh.tiles", False, origin, comments)
    return (str(tmp_path / "kept"), "part"), places, foreign, ply


def test_a_tile_holds_what_its_faces_use(call: tuple[Any, ...], tmp_path: Path) -> None:
    for _ in range(2):  # again, as after the loss of a worker
        assert write_kept_tile(*call)
        head, _, body = (tmp_path / "hidden/tile.ply").read_bytes().partition(b"end_header\n")
        assert b"element vertex 3\n" in head
        assert b"element face 1\n" in head
        assert b"\ncomment unit m\n" in head
        vertices = np.frombuffer(body, "<f4", 9).reshape(3, 3)
        corners = np.frombuffer(body, "<i4", 3, 36 + 1)
        assert len(body) == 36 + 13
        np.testing.assert_array_equal(vertices[corners], [[0, 0, 2], [1, 0, 2], [0, 1, 2]])


def test_a_part_without_faces_has_no_tile(call: tuple[Any, ...], tmp_path: Path) -> None:
    kept, places, *rest = call
    elsewhere = replace(places, face_starts=np.array([-1]))
    assert write_kept_tile(kept, elsewhere, *rest)
    assert not list((tmp_path / "hidden").iterdir())


def test_what_is_not_seen_is_not_written(call: tuple[Any, ...], tmp_path: Path) -> None:
    kept, places, (_, *rest), ply = call
    assert not write_kept_tile(kept, places, (("unknown",), *rest), ply)
    assert not write_kept_tile((str(tmp_path / "elsewhere"), "part"), *call[1:])
    assert not list((tmp_path / "hidden").iterdir())
    (tmp_path / "hidden").rmdir()
    assert not write_kept_tile(*call)


def test_what_cannot_be_written_is_one_line(call: tuple[Any, ...], tmp_path: Path) -> None:
    (tmp_path / "hidden/tile.ply").mkdir()
    with pytest.raises(OutputError, match=r"^mesh\.tiles: cannot be written: Is a directory"):
        write_kept_tile(*call)
