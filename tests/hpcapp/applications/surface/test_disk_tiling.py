"""The tiles of a cloud on disk are those of the cloud in memory, byte by byte."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hpcapp.applications.surface import disk_tiling
from hpcapp.applications.surface.disk_tiling import DiskTiling
from hpcapp.applications.surface.tiles import Tiling
from hpccomponent.surface.arranged_cloud import arrange_cloud
from hpccomponent.surface.arrangement import choose_arrangement
from hpccomponent.surface.disk_cloud import DiskCloudWriter
from hpccomponent.surface.points import PointCloud
from hpccomponent.surface.region import Plan


def _scan() -> PointCloud:
    random = np.random.default_rng(2)
    normals = random.normal(size=(8_000, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return PointCloud(normals * (1.0, 0.4, 0.7) + 3.3, normals)


@pytest.mark.parametrize("cell_size", [0.011, 0.03125, 0.2])
@pytest.mark.parametrize("coarse", [0, 1])
@pytest.mark.parametrize("count", [1, 7])
def test_tiles_of_any_size_are_alike(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cell_size: float, coarse: int, count: int
) -> None:
    monkeypatch.setattr(disk_tiling, "_POINTS_AT_ONCE", 900)
    scan = _scan()
    arranged = arrange_cloud(scan)
    writer = DiskCloudWriter(tmp_path, arranged.arrangement, scan.origin)
    assert scan.normals is not None
    for some in np.array_split(np.arange(len(scan)), 5):
        writer.add(scan.positions[some], scan.normals[some])
    low, high = arranged.low, arranged.high
    finer = choose_arrangement(low, low + 0.4 * (high - low))  # as of a cloud that was cleaned
    for blocks in (arranged.arrangement, finer):
        plan = Plan(
            low,
            cell_size,
            6,
            coarse,
            0.0,
            low,
            cell_size / 4,
            (9, 9, 9),
            blocks.origin,
            blocks.edge,
            1,
        )
        disk = DiskTiling(writer.finish(), plan, count)
        memory = Tiling(arranged.cloud, plan, count)
        assert disk.cells.tolist() == memory.cells.tolist()
        assert len(disk) == len(memory)
        for index in range(min(len(memory), 2)):
            one, other = disk.tile(index), memory.tile(index)
            assert one.cells.tolist() == other.cells.tolist()
            for part in ("core", "before", "after"):
                mine, its = getattr(one, part), getattr(other, part)
                for column in ("keys", "counts", "offsets", "normals"):
                    assert getattr(mine, column).tobytes() == getattr(its, column).tobytes()
