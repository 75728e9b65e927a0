"""Whoever asks an arranged cloud for blocks gets the same points, wherever it lies."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest
from disk_clouds import DiskCloudWriter

from hpcapp.applications.surface.cloud.arranged import MemoryCloud, Points, arrange_cloud
from hpcapp.applications.surface.cloud.arrangement import interleave, pack_points
from hpcapp.applications.surface.cloud.folder.disk import (
    DiskCloud,
    open_disk_cloud,
    open_place,
    write_index,
)
from hpcapp.applications.surface.cloud.folder.parts import FilePart, write_part
from hpcapp.geometry.points import PointCloud
from hpccomponent.errors import JobError, OutputError


def _scan(points: int = 3_000) -> PointCloud:
    random = np.random.default_rng(points)
    positions = random.normal(size=(points, 3)) * (1.0, 0.2, 0.5)
    return PointCloud(positions, random.normal(size=(points, 3)), origin=np.array([7.0, 8.0, 9.0]))


@pytest.fixture
def memory() -> MemoryCloud:
    return arrange_cloud(_scan())


def _write(scan: PointCloud, arranged: MemoryCloud, folder: Path, rows: int) -> DiskCloud:
    """Write a scan in parts of so many points, in its order."""
    writer = DiskCloudWriter(folder, arranged.arrangement, scan.origin)
    assert scan.normals is not None
    for start in range(0, len(scan), rows):
        writer.add(scan.positions[start : start + rows], scan.normals[start : start + rows])
    return writer.finish()


def _rows(points: Points) -> set[bytes]:
    return {row.tobytes() for row in np.concatenate(points, axis=1)}


@pytest.mark.parametrize("rows", [1, 70, 1_000, 3_000])
def test_disk_and_memory_hold_the_same_bytes(
    tmp_path: Path, memory: MemoryCloud, rows: int
) -> None:
    disk = _write(_scan(), memory, tmp_path, rows)
    assert len(disk) == len(memory) == 3_000
    for name in ("origin", "keys", "counts", "low", "high"):
        assert getattr(disk, name).tobytes() == getattr(memory, name).tobytes()
    random = np.random.default_rng(0)
    for share in (0.0, 0.01, 0.5, 1.0):
        wanted = memory.keys[random.random(len(memory.keys)) < share]
        wanted = np.unique(np.concatenate([wanted, wanted + 1]))  # some of which are empty
        for one, other in zip(disk.take_blocks(wanted), memory.take_blocks(wanted), strict=True):
            assert one.tobytes() == other.tobytes()
            assert one.shape[1:] == (3,)


def test_of_a_box_only_what_lies_in_it_comes_from_a_disk(
    tmp_path: Path, memory: MemoryCloud
) -> None:
    disk = _write(_scan(), memory, tmp_path, 700)
    low, high, some = np.array([-0.5, -0.1, -1.0]), np.array([1.0, 0.1, 0.2]), memory.keys[::2]
    positions, normals = memory.take_blocks(some)
    inside = ((positions > low) & (positions < high)).all(axis=1)
    assert 100 < inside.sum() < 0.5 * len(positions)
    found = disk.take_within(some, low, high)
    assert _rows(found) == _rows((positions[inside], normals[inside]))
    assert _rows(memory.take_within(some, low, high)) >= _rows(found)


@pytest.mark.parametrize("size", [0.01, 0.3, 50.0])
def test_disk_and_memory_answer_alike(tmp_path: Path, memory: MemoryCloud, size: float) -> None:
    disk = _write(_scan(), memory, tmp_path, 700)
    origin, some = np.array([0.1, -0.2, 0.3]), memory.keys[::2]
    for one, other in zip(
        disk.count_cells(some, origin, size), memory.count_cells(some, origin, size), strict=True
    ):
        assert one.tolist() == other.tolist()
    assert open_place(memory.place) is memory
    refusal = JobError("too many points", "take fewer")
    with pytest.raises(JobError, match="too many"):
        disk.take_all(len(disk) - 1, refusal)
    for cloud in (disk, memory):
        every = cloud.take_all(len(disk) if cloud is disk else 0, refusal)
        assert every.positions.tobytes() == memory.points.positions.tobytes()


def test_points_may_be_held_as_they_are(memory: MemoryCloud) -> None:
    scan = _scan()
    cloud = MemoryCloud.as_they_are(scan)
    assert cloud.take_blocks(cloud.keys)[0].tobytes() == scan.positions.tobytes()
    assert (cloud.low == scan.positions.min(axis=0)).all()
    kept = cloud.select(np.arange(len(scan)) % 2 == 0)
    assert kept.points.positions.tobytes() == scan.positions[::2].tobytes()


def test_a_selection_keeps_the_blocks(memory: MemoryCloud) -> None:
    kept = np.random.default_rng(1).random(len(memory)) < 0.1
    some = memory.select(kept)
    assert len(some) == kept.sum()
    assert (some.low == some.points.positions.min(axis=0)).all()
    assert (some.high == some.points.positions.max(axis=0)).all()
    assert some.points.positions.tobytes() == memory.points.positions[kept].tobytes()
    again = arrange_cloud(PointCloud(memory.points.positions[kept], np.zeros((kept.sum(), 3))))
    if again.arrangement.edge == memory.arrangement.edge:
        assert some.counts.tolist() == again.counts.tolist()
    assert some.counts.min() > 0
    assert some.counts.sum() == len(some)
    assert some.take_blocks(memory.keys)[0].tobytes() == some.points.positions.tobytes()


@pytest.mark.parametrize("step", [1, 7, 3_000])
def test_an_index_may_leave_out_blocks_of_parts_elsewhere(
    tmp_path: Path, memory: MemoryCloud, step: int
) -> None:
    """Those left out are in another part, as if they had been written again."""
    (tmp_path / "old").mkdir()
    (tmp_path / "new").mkdir()
    old = _write(_scan(), memory, tmp_path / "old", 700)
    moved = memory.keys[::3]
    written = write_part(tmp_path / "new", 0, [old.take_packed(moved)])
    parts = [part.without(moved, "../old") for part in old.parts]
    parts.append(FilePart.whole(0, *written))
    box = old.low, old.high
    new = write_index(tmp_path / "new", old.arrangement, old.origin, box, parts)
    assert new.uses(tmp_path / "old")
    assert not old.uses(tmp_path / "new")
    assert new.counts.tolist() == memory.counts.tolist()
    for keys in (memory.keys, memory.keys[1:40], moved):
        for one, other in zip(new.take_blocks(keys), memory.take_blocks(keys), strict=True):
            assert one.tobytes() == other.tobytes()
    sample = new.sample(-(-len(new) // step))
    assert sample.normals is not None
    some = sample.positions, sample.normals
    assert len(some[0]) == sum(-(-int(part.counts.sum()) // step) for part in parts)
    assert _rows(some) <= _rows(memory.take_blocks(memory.keys))
    assert len(_rows(some)) == len(some[0])


@pytest.mark.parametrize("at_once", [1, 7, 1_000, 1 << 16])
def test_a_part_is_the_same_in_pieces(tmp_path: Path, memory: MemoryCloud, at_once: int) -> None:
    """Blocks hold the points of one piece after those of another."""
    scan = _scan()
    assert scan.normals is not None
    arrangement = memory.arrangement
    packed = [
        pack_points(arrangement, scan.positions[rows], scan.normals[rows])
        for rows in (slice(0, 1), slice(1, 1_200), slice(1_200, None))
    ]
    keys, counts = write_part(tmp_path, 0, packed)
    whole = pack_points(arrangement, scan.positions, scan.normals)
    assert keys.tolist() == whole.keys.tolist()
    assert counts.tolist() == whole.counts.tolist()
    assert np.concatenate([*interleave(packed, at_once)]).tobytes() == whole.to_records().tobytes()
    write_part(tmp_path, 2, [whole])
    # The last record is a checksum, of the name, too.
    parts = [(tmp_path / f"points.{i}").read_bytes()[:-24] for i in (0, 2)]
    assert parts[0] == parts[1]
    assert [len(column) for column in write_part(tmp_path, 1, [])] == [0, 0]
    assert not (tmp_path / "points.1").exists()


def test_a_cloud_is_opened_again(tmp_path: Path, memory: MemoryCloud) -> None:
    written = _write(_scan(), memory, tmp_path, 1_000)
    opened = open_disk_cloud(tmp_path)
    assert opened.take_blocks(memory.keys)[0].tobytes() == memory.points.positions.tobytes()
    assert len(opened) == len(written)


def test_blocks_are_read_in_as_many_calls_as_it_takes(
    tmp_path: Path, memory: MemoryCloud, monkeypatch: pytest.MonkeyPatch
) -> None:
    disk = _write(_scan(), memory, tmp_path, 1_000)
    read = os.preadv

    def read_less(file: int, buffers: list[memoryview], start: int) -> int:
        (buffer,) = buffers
        return read(file, [buffer[: -(-len(buffer) // 2)]], start)

    monkeypatch.setattr(os, "preadv", read_less)
    assert disk.take_blocks(memory.keys)[0].tobytes() == memory.points.positions.tobytes()


def test_folders_that_were_tampered_with(tmp_path: Path, memory: MemoryCloud) -> None:
    with pytest.raises(JobError, match="holds no arranged points"):
        open_disk_cloud(tmp_path)
    disk = _write(_scan(), memory, tmp_path, 1_000)
    part = tmp_path / "points.1"
    part.write_bytes(part.read_bytes()[:-30])
    for read in (lambda: disk.take_blocks(memory.keys), lambda: disk.sample(300)):
        with pytest.raises(JobError, match=r"points\.1: .* cannot be read: it is not whole"):
            read()
    part.unlink()
    with pytest.raises(JobError, match=r"points\.1: .* cannot be read"):
        disk.take_blocks(memory.keys)
    (tmp_path / "index").write_bytes(b"PK nonsense")
    with pytest.raises(JobError, match="holds no arranged points"):
        open_disk_cloud(tmp_path)


def test_a_full_disk_is_one_clear_line(
    tmp_path: Path, memory: MemoryCloud, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "replace", refuse)
    with pytest.raises(OutputError, match="No space left on device; name a temporary folder"):
        _write(_scan(), memory, tmp_path, 1_000)
