"""Parts that are kept, written by a worker into one PLY."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hpcapp.applications.surface.extraction.part_places import PartPlaces
from hpcapp.applications.surface.extraction.parts import MeshPart
from hpcapp.applications.surface.stitching.shared_ply import write_kept
from hpcapp.geometry.ply_rows import FACE_SIZE, SharedPly
from hpccomponent.errors import JobError, OutputError
from hpccomponent.store.places import open_store

HEADER = 100
VERTICES, FACES = 6, 4


@pytest.fixture
def part() -> MeshPart:
    """Two bricks of three vertices and two faces each."""
    three, two = np.array([3, 3], np.int32), np.array([2, 2], np.int32)
    faces = np.arange(12, dtype=np.int32).reshape(4, 3) % 6
    none = np.empty(0, np.int32)
    return MeshPart(
        np.array([5, 9]), np.zeros(2, np.bool_), three, two,
        np.arange(18.0).reshape(6, 3), faces, np.empty(0, np.int64), none, np.ones(6, np.bool_),
    )  # fmt: skip


@pytest.fixture
def call(part: MeshPart, tmp_path: Path) -> tuple[object, ...]:
    """What the task is called with; the bricks lie apart in the file."""
    face_start = HEADER + 3 * VERTICES * 24
    (tmp_path / "hidden").write_bytes(bytes(face_start + 3 * FACES * FACE_SIZE))
    shared = SharedPly(
        str(tmp_path / "hidden"), str(tmp_path / "mesh.ply"), HEADER, face_start, True, np.ones(3)
    )
    places = PartPlaces(
        np.array([2, 9]), np.array([1, 7]), np.empty(0, np.int32), np.empty(0, np.int64)
    )
    open_store(str(tmp_path / "kept")).put("job/part", (part, (), ()))
    return (str(tmp_path / "kept"), "job/part"), places, shared


def test_a_part_goes_to_its_places(call: tuple[Any, ...], tmp_path: Path, part: MeshPart) -> None:
    assert write_kept(*call)
    written = (tmp_path / "hidden").read_bytes()
    vertices = np.frombuffer(written, "<f8", 3 * 3 * VERTICES, HEADER).reshape(-1, 3)
    np.testing.assert_array_equal(vertices[2:5], part.vertices[:3] + 1.0)
    np.testing.assert_array_equal(vertices[9:12], part.vertices[3:] + 1.0)
    assert not vertices[:2].any()
    assert not vertices[5:9].any()
    first = HEADER + 3 * VERTICES * 24 + FACE_SIZE
    assert written[first] == 3
    np.testing.assert_array_equal(np.frombuffer(written, "<i4", 3, first + 1), [2, 3, 4])


def test_a_worker_that_dies_does_no_harm(
    call: tuple[Any, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blank = (tmp_path / "hidden").read_bytes()
    assert write_kept(*call)
    written = (tmp_path / "hidden").read_bytes()
    (tmp_path / "hidden").write_bytes(blank)
    write = os.pwrite
    left = iter([50, 1, 20])

    def write_some(file: int, run: memoryview, at: int) -> int:
        try:
            return write(file, run[: next(left)], at)
        except StopIteration:
            raise KeyboardInterrupt from None

    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", write_some)
        with pytest.raises(KeyboardInterrupt):
            write_kept(*call)
    assert (tmp_path / "hidden").read_bytes() not in (blank, written)
    assert write_kept(*call)
    assert (tmp_path / "hidden").read_bytes() == written


def test_where_the_file_is_not_seen_nothing_is_made(call: tuple[Any, ...], tmp_path: Path) -> None:
    (tmp_path / "hidden").unlink()
    assert not write_kept(*call)
    assert {path.name for path in tmp_path.iterdir()} == {"kept"}


def test_where_the_part_is_not_seen_nothing_is_written(
    call: tuple[Any, ...], tmp_path: Path
) -> None:
    before = (tmp_path / "hidden").read_bytes()
    (_, name), *values = call
    assert not write_kept((str(tmp_path / "elsewhere"), name), *values)
    assert (tmp_path / "hidden").read_bytes() == before


def test_a_part_that_is_damaged_is_not_written(call: tuple[Any, ...], tmp_path: Path) -> None:
    path = tmp_path / "kept/job/part"
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    with pytest.raises(JobError, match="checksum"):
        write_kept(*call)


def test_a_full_disk_is_one_line(
    call: tuple[Any, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def write(*_: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "pwrite", write)
    with pytest.raises(OutputError) as caught:
        write_kept(*call)
    assert caught.value.problem == (
        f"{tmp_path / 'mesh.ply'}: cannot be written: No space left on device"
    )
