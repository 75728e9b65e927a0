"""Regions share a cloud's blocks, and know enough of what is around them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from disk_clouds import DiskCloudWriter

from hpccomponent.surface.cloud.arranged import MemoryCloud, arrange_cloud
from hpccomponent.surface.cloud.disk import DiskCloud
from hpccomponent.surface.cloud.outliers import EDGE, ISLAND_LEVEL
from hpccomponent.surface.cloud.regions import DroppedCells, Region, pack_region, take_region
from hpccomponent.surface.cloud.spacing import estimate_spacing
from hpccomponent.surface.normals.consistency import MARGIN, find_turned
from hpccomponent.surface.types.lattice import pack_places
from hpccomponent.surface.types.points import FloatArray, PointCloud


def _cloud(seed: int) -> FloatArray:
    """A sphere that is dense on one side, with a patch beside it and points far away."""
    random = np.random.default_rng(seed)
    sphere = random.normal(size=(9_000, 3))
    sphere /= np.linalg.norm(sphere, axis=1)[:, None]
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


def _take(cloud: DiskCloud, blocks: np.ndarray, margin: float, is_sent: bool) -> Region:
    where = pack_region(cloud, blocks, margin) if is_sent else str(cloud.folder)
    return take_region((where, blocks, margin, None))


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
    expected = find_turned(*whole, arranged.low, spacing)
    turned = np.zeros(len(positions), np.bool_)
    rows = np.repeat(arranged.keys, arranged.counts)
    for blocks in _cut(cloud, 8):
        r = _take(cloud, blocks, MARGIN * spacing, is_sent)
        own = np.isin(rows, blocks)
        found = find_turned(r.positions, r.normals, arranged.low, spacing)
        turned[own] = found[r.own]
        packed = r.pack_own(found)
        assert not r.has_lost_own
        assert packed.keys.tolist() == blocks.tolist()
        assert packed.counts.tolist() == arranged.counts[np.isin(arranged.keys, blocks)].tolist()
        mended = np.where(turned[own, None], -whole[1][own], whole[1][own])
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


def test_points_in_dropped_cells_are_not_there(tmp_path: Path) -> None:
    arranged = arrange_cloud(PointCloud(_cloud(4), _cloud(4)))
    cloud = _write(arranged, tmp_path)
    low, spacing = cloud.low, estimate_spacing(arranged.points.positions)
    places = np.floor((arranged.points.positions - low) / (EDGE * spacing)).astype(np.int64)
    strays = np.unique(pack_places(places))[::7]
    islands = np.unique(pack_places(places >> ISLAND_LEVEL))[::40]
    kept = ~np.isin(pack_places(places), strays)
    kept &= ~np.isin(pack_places(places >> ISLAND_LEVEL), islands)
    region = take_region(
        (str(tmp_path), cloud.keys, 0.0, DroppedCells(low, spacing, strays, islands))
    )
    assert region.positions.tobytes() == arranged.points.positions[kept].tobytes()
    packed = region.pack_own(np.zeros(int(kept.sum()), np.bool_))
    held = np.repeat(cloud.keys, cloud.counts)[kept]
    assert np.repeat(packed.keys, packed.counts).tolist() == held.tolist()
    assert 0 < kept.sum() < len(kept)
    assert region.has_lost_own
