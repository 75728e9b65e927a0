"""A cloud on disk gives its attributes as the one in memory does, to the last bit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from directions import random_directions
from disk_clouds import DiskCloudWriter

from hpcapp.applications.surface.attributes.blocks import ColumnBlocks
from hpcapp.applications.surface.attributes.carry import AttributeField
from hpcapp.applications.surface.attributes.search import evaluate_blocks
from hpcapp.applications.surface.cloud.arranged import arrange_cloud
from hpcapp.applications.surface.cloud.arrangement import choose_arrangement
from hpcapp.applications.surface.cloud.folder.disk import DiskCloud
from hpcapp.geometry.points import FloatArray, PointCloud
from hpccomponent.errors import JobError

LABELS = frozenset({"kind"})
SPACING = 0.03


def scan(points: int = 6000) -> PointCloud:
    """Half a sphere with a hole, and points far away from it."""
    rng = np.random.default_rng(1)
    units = random_directions(points, rng)
    units = units[(units[:, 2] > 0) & (np.abs(units[:, :2] - 0.3).max(axis=1) > 0.2)]
    units[:30] = rng.uniform(2, 3, (30, 3))
    return PointCloud(
        units,
        units,
        rng.integers(0, 255, (len(units), 3), dtype=np.uint8),
        {"kind": rng.integers(0, 5, len(units), dtype=np.uint8), "wave": np.sin(units[:, 0])},
    )


def vertices(count: int = 900) -> FloatArray:
    return random_directions(count, 8)


def put(folder: Path, cloud: PointCloud, kept: PointCloud) -> tuple[DiskCloud, ColumnBlocks]:
    """Put some points of a cloud into a folder in parts, and the columns of all beside them."""
    blocks = choose_arrangement(kept.positions.min(axis=0), kept.positions.max(axis=0))
    (folder / "points").mkdir()
    (folder / "columns").mkdir()
    writer = DiskCloudWriter(folder / "points", blocks, np.zeros(3))
    for rows in np.array_split(np.arange(len(kept)), 3):
        part = kept.take(rows)
        assert part.normals is not None
        writer.add(part.positions, part.normals)
    disk = writer.finish()
    columns = ColumnBlocks(folder / "columns", disk, cloud.view(slice(0)))
    for rows in np.array_split(np.arange(len(cloud)), 4):
        columns.add(cloud.take(rows))
    return disk, columns


def equal(one: PointCloud, other: PointCloud) -> bool:
    assert one.colours is not None
    assert other.colours is not None
    return one.colours.tobytes() == other.colours.tobytes() and all(
        column.tobytes() == other.attributes[name].tobytes()
        for name, column in one.attributes.items()
    )


@pytest.mark.parametrize("at_once", [50, 700, 10_000])
def test_groups_of_any_size_give_the_bits_of_the_whole(tmp_path: Path, at_once: int) -> None:
    cloud = scan()
    disk, columns = put(tmp_path, cloud, cloud)
    whole = AttributeField(arrange_cloud(cloud).points, LABELS).evaluate(vertices())
    found = evaluate_blocks(disk, columns.take_blocks, LABELS, SPACING, vertices(), points=at_once)
    assert equal(found.points, whole.points)
    assert found.nearest.tobytes() == whole.nearest.tobytes()
    np.testing.assert_array_equal(found.points.positions, vertices())


def test_points_that_were_dropped_give_nothing(tmp_path: Path) -> None:
    cloud = scan()
    kept = cloud.take(np.arange(len(cloud)) % 3 > 0)
    disk, columns = put(tmp_path, cloud, kept)
    whole = AttributeField(arrange_cloud(kept).points, LABELS).evaluate(vertices())
    found = evaluate_blocks(disk, columns.take_blocks, LABELS, SPACING, vertices(), points=900)
    assert equal(found.points, whole.points)


def test_of_points_at_one_place_the_first_ones_stay(tmp_path: Path) -> None:
    once = scan(2000)
    order = np.random.default_rng(0).permutation(np.repeat(np.arange(len(once)), 3))
    thrice = once.take(order)
    thrice.attributes["wave"][:] = np.arange(len(thrice))  # which copy it is
    first = np.sort(np.unique(order, return_index=True)[1])
    kept = thrice.take(first)
    disk, columns = put(tmp_path, thrice, kept)
    whole = AttributeField(arrange_cloud(kept).points, LABELS).evaluate(vertices())
    found = evaluate_blocks(disk, columns.take_blocks, LABELS, SPACING, vertices())
    assert equal(found.points, whole.points)


def test_few_points_and_no_places_are_no_trouble(tmp_path: Path) -> None:
    cloud = scan().take(np.arange(5))
    disk, columns = put(tmp_path, cloud, cloud)
    whole = AttributeField(arrange_cloud(cloud).points, LABELS).evaluate(vertices(20))
    found = evaluate_blocks(disk, columns.take_blocks, LABELS, SPACING, vertices(20))
    assert equal(found.points, whole.points)
    assert not len(
        evaluate_blocks(disk, columns.take_blocks, LABELS, SPACING, np.empty((0, 3))).points
    )


def test_an_input_that_has_changed_is_noticed(tmp_path: Path) -> None:
    cloud = scan()
    disk, columns = put(tmp_path, cloud.take(np.arange(len(cloud)) % 3 > 0), cloud)
    with pytest.raises(JobError, match="the input has changed meanwhile"):
        columns.take_blocks(disk.keys)


@pytest.mark.parametrize("damage", ["gone", "short"])
def test_a_file_that_is_not_whole_is_named(tmp_path: Path, damage: str) -> None:
    cloud = scan()
    disk, columns = put(tmp_path, cloud, cloud)
    path = tmp_path / "columns" / "columns.1"
    whole = path.read_bytes()
    path.unlink()
    if damage == "short":
        path.write_bytes(whole[: len(whole) // 2 // 36 * 36])
    with pytest.raises(JobError, match=r"columns\.1"):
        columns.take_blocks(disk.keys)
