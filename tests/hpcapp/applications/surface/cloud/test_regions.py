"""Regions share a cloud's blocks, and know enough of what is around them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from directions import random_directions
from disk_clouds import DiskCloudWriter, read_part

from hpcapp.applications.surface.cloud.arranged import MemoryCloud, arrange_cloud
from hpcapp.applications.surface.cloud.arrangement import PackedPoints
from hpcapp.applications.surface.cloud.folder.disk import DiskCloud
from hpcapp.applications.surface.cloud.regions import (
    CloudRegion,
    MemoryRegion,
    ReplacedRows,
    StoredBlocks,
    pack_region,
)
from hpcapp.applications.surface.cloud.spacing import estimate_spacing
from hpcapp.applications.surface.normals.consistency import MARGIN, find_flipped
from hpcapp.geometry.points import FloatArray, PointCloud


def _cloud(seed: int) -> FloatArray:
    """A sphere that is dense on one side, with a patch beside it and points far away."""
    random = np.random.default_rng(seed)
    sphere = random_directions(9_000, random)
    sphere = sphere[random.random(len(sphere)) < 10.0 ** (-0.8 * (1 - sphere[:, 2]))]
    patch = random.uniform(-0.3, 0.3, (40, 3)) * (1.0, 1.0, 0.01) - (0.0, 0.0, 1.3)
    return np.concatenate([sphere, patch, random.uniform(-2, 2, (80, 3))])


def _write(arranged: MemoryCloud, folder: Path) -> DiskCloud:
    writer = DiskCloudWriter(folder, arranged.arrangement, arranged.origin)
    assert arranged.points.normals is not None
    writer.add(arranged.points.positions, arranged.points.normals)
    return writer.finish()


def _cut(cloud: DiskCloud, pieces: int) -> list[np.ndarray]:
    """Return blocks, some of which touch those of others."""
    return [some for some in np.array_split(cloud.keys, pieces) if len(some)]


def _take(cloud: DiskCloud, blocks: np.ndarray, margin: float, is_sent: bool) -> CloudRegion:
    where = pack_region(cloud, blocks, margin) if is_sent else str(cloud.folder)
    return StoredBlocks(where, blocks, margin).take()


@pytest.mark.parametrize("is_sent", [True, False])
def test_turned_normals_of_regions_are_those_of_the_whole(tmp_path: Path, is_sent: bool) -> None:
    random = np.random.default_rng(0)
    positions = _cloud(3)
    normals = positions / np.linalg.norm(positions, axis=1)[:, None]
    normals[random.random(len(normals)) < 0.1] *= -1.0
    arranged = arrange_cloud(PointCloud(positions, normals))
    cloud = _write(arranged, tmp_path)
    spacing = estimate_spacing(positions)
    assert arranged.points.normals is not None
    whole = (arranged.points.positions, arranged.points.normals)
    expected = find_flipped(*whole, arranged.low, spacing)
    turned = np.zeros(len(positions), np.bool_)
    rows = np.repeat(arranged.keys, arranged.counts)
    for blocks in _cut(cloud, 8):
        r = _take(cloud, blocks, MARGIN * spacing, is_sent)
        own = np.isin(rows, blocks)
        found = find_flipped(r.positions, r.normals, arranged.low, spacing)
        turned[own] = found[r.own]
        packed = r.flip(found[r.own])
        changed = np.unique(rows[own & turned])
        if not len(changed):
            assert packed is None
            continue
        assert isinstance(packed, PackedPoints)
        assert packed.keys.tolist() == changed.tolist()
        assert packed.counts.tolist() == arranged.counts[np.isin(arranged.keys, changed)].tolist()
        lies = np.isin(rows, changed)
        mended = np.where(turned[lies, None], -whole[1][lies], whole[1][lies])
        assert packed.normals.astype(np.float64).tobytes() == mended.tobytes()
    assert turned.tolist() == expected.tolist()
    assert turned.sum() > 100


def test_regions_know_their_margins(tmp_path: Path) -> None:
    arranged = arrange_cloud(PointCloud(_cloud(4), _cloud(4)))
    cloud = _write(arranged, tmp_path)
    positions = arranged.points.positions
    rows = np.repeat(cloud.keys, cloud.counts)
    for blocks in _cut(cloud, 9):
        for margin in (0.0, 0.3 * cloud.arrangement.edge, 5.0 * cloud.arrangement.edge):
            region = _take(cloud, blocks, margin, is_sent=False)
            own = region.positions[region.own]
            assert own.tobytes() == positions[np.isin(rows, blocks)].tobytes()
            taken = {tuple(place) for place in region.positions.tolist()}
            away = np.abs(positions[:, None] - own).max(axis=2).min(axis=1)
            due = {tuple(place) for place in positions[away <= margin].tolist()}
            assert due <= taken
            assert len(taken) < len(cloud)


@pytest.mark.parametrize("is_written", [True, False])
def test_only_blocks_that_lose_points_are_replaced(tmp_path: Path, is_written: bool) -> None:
    arranged = arrange_cloud(PointCloud(_cloud(4), _cloud(4)))
    cloud = _write(arranged, tmp_path)
    rows = np.repeat(cloud.keys, cloud.counts)
    dropped = np.isin(rows, cloud.keys[::5]) & (np.arange(len(cloud)) % 3 > 0)
    dropped |= rows == cloud.keys[2]  # all of a block
    target = (str(tmp_path), 7) if is_written else None
    region = StoredBlocks(str(tmp_path), cloud.keys, 0.0, target).take()
    changed = np.unique(rows[dropped])
    replaced = region.drop(dropped)
    assert replaced is not None
    keys, counts = replaced if isinstance(replaced, tuple) else (replaced.keys, replaced.counts)  # type: ignore[union-attr]
    assert keys.tolist() == changed.tolist()
    left = np.isin(rows, changed) & ~dropped
    assert counts.tolist() == [int((rows[left] == key).sum()) for key in changed]
    assert counts[list(keys).index(cloud.keys[2])] == 0
    if is_written:
        records = read_part(tmp_path / "points.7", int(counts.sum()))
        expected = cloud.take_packed(cloud.keys).to_records()[left]
        assert records.tobytes() == expected.tobytes()
    assert region.drop(np.zeros(len(cloud), np.bool_)) is None


def test_in_memory_the_points_themselves_are_replaced() -> None:
    positions = _cloud(4)
    every = np.ones(len(positions), np.bool_)
    region = MemoryRegion(positions, positions, every, slice(None)).take()
    assert region.flip(~every) is None
    assert region.drop(~every) is None
    wrong = np.arange(len(positions)) % 3 == 0
    flipped, less = region.flip(wrong), region.drop(wrong)
    assert isinstance(flipped, ReplacedRows)
    assert isinstance(less, ReplacedRows)
    assert flipped.normals is not None
    assert less.kept is not None
    assert (flipped.normals == np.where(wrong[:, None], -positions, positions)).all()
    assert (less.kept == ~wrong).all()
