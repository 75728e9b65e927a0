"""Whoever asks an arranged cloud for blocks gets the same points, wherever it lies."""

from __future__ import annotations

import errno
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hpccomponent.errors import JobError, OutputError
from hpccomponent.surface.arranged_cloud import MemoryCloud, arrange_cloud, cut_blocks
from hpccomponent.surface.disk_cloud import DiskCloud, DiskCloudWriter, open_disk_cloud
from hpccomponent.surface.points import PointCloud


def _scan(points: int = 3_000) -> PointCloud:
    random = np.random.default_rng(points)
    positions = random.normal(size=(points, 3)) * (1.0, 0.2, 0.5)
    return PointCloud(positions, random.normal(size=(points, 3)), None, np.array([7.0, 8.0, 9.0]))


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


@pytest.mark.parametrize("points", [1, 100, 2_999, 10_000])
def test_groups_are_the_whole_cloud_in_its_order(
    tmp_path: Path, memory: MemoryCloud, points: int
) -> None:
    for cloud in (memory, _write(_scan(), memory, tmp_path, 500)):
        groups = list(cloud.groups(points))
        assert np.concatenate([g[0] for g in groups]).tobytes() == memory.cloud.positions.tobytes()
        assert memory.cloud.normals is not None
        assert np.concatenate([g[1] for g in groups]).tobytes() == memory.cloud.normals.tobytes()
        most = max(points, int(memory.counts.max()))
        assert all(len(group[0]) <= most for group in groups)


@given(st.lists(st.integers(1, 9), min_size=1), st.integers(1, 30))
def test_runs_of_blocks_are_cut_where_they_are_full(counts: list[int], points: int) -> None:
    runs = cut_blocks(np.array(counts), points)
    assert [count for run in runs for count in counts[run]] == counts
    for run, after in pairwise(runs):
        assert sum(counts[run]) <= points or run.stop - run.start == 1
        assert sum(counts[run]) + counts[after.start] > points


def test_a_selection_keeps_the_blocks(memory: MemoryCloud) -> None:
    kept = np.random.default_rng(1).random(len(memory)) < 0.1
    some = memory.select(kept)
    assert len(some) == kept.sum()
    assert some.cloud.positions.tobytes() == memory.cloud.positions[kept].tobytes()
    again = arrange_cloud(PointCloud(memory.cloud.positions[kept], np.zeros((kept.sum(), 3))))
    if again.arrangement.edge == memory.arrangement.edge:
        assert some.counts.tolist() == again.counts.tolist()
    assert some.counts.min() > 0
    assert some.counts.sum() == len(some)
    assert some.take_blocks(memory.keys)[0].tobytes() == some.cloud.positions.tobytes()


def test_a_cloud_is_opened_again(tmp_path: Path, memory: MemoryCloud) -> None:
    written = _write(_scan(), memory, tmp_path, 1_000)
    opened = open_disk_cloud(tmp_path)
    assert opened.take_blocks(memory.keys)[0].tobytes() == memory.cloud.positions.tobytes()
    assert len(opened) == len(written)


def test_folders_that_were_tampered_with(tmp_path: Path, memory: MemoryCloud) -> None:
    with pytest.raises(JobError, match="holds no arranged points"):
        open_disk_cloud(tmp_path)
    disk = _write(_scan(), memory, tmp_path, 1_000)
    part = tmp_path / "points.1"
    part.write_bytes(part.read_bytes()[:-1])
    with pytest.raises(JobError, match=r"points\.1 has become shorter"):
        disk.take_blocks(memory.keys)
    part.unlink()
    with pytest.raises(JobError, match=r"points\.1: .* cannot be read"):
        disk.take_blocks(memory.keys)
    (tmp_path / "index.npz").write_bytes(b"PK nonsense")
    with pytest.raises(JobError, match="holds no arranged points"):
        open_disk_cloud(tmp_path)


def test_a_full_disk_is_one_clear_line(
    tmp_path: Path, memory: MemoryCloud, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(OutputError, match="No space left on device; name a temporary folder"):
        _write(_scan(), memory, tmp_path, 1_000)
