"""Several sources as one PLY."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hpcapp.geometry.points import PointCloud
from hpcapp.io import open_points, read_points, write_points
from hpcapp.io.ply.joined import write_joined
from hpcapp.io.points.mesh_points import slice_cloud
from hpcapp.io.points.point_source import PointSource, Scan
from hpccomponent.errors import InputError

FAR = np.array([4321098.123456789, -987654.3210987654, 5.5])


def make_source(path: Path, cloud: PointCloud) -> PointSource:
    return slice_cloud(path, "made", cloud)


def test_coordinates_keep_all_their_digits(tmp_path: Path) -> None:
    positions = FAR + np.random.default_rng(0).random((300, 3))
    count = write_joined(tmp_path / "a.ply", [make_source(tmp_path, PointCloud(positions))] * 2)
    read = read_points(tmp_path / "a.ply")
    assert count == 600
    np.testing.assert_array_equal(read.positions + read.origin, np.vstack([positions] * 2))


def test_columns_come_back_as_they_were(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    cloud = PointCloud(
        rng.random((20, 3)),
        None,
        rng.integers(0, 256, (20, 3)).astype(np.uint8),
        {"intensity": rng.integers(-9, 999, 20).astype(np.int16), "time": rng.random(20)},
    )
    write_joined(tmp_path / "a.ply", [make_source(tmp_path, cloud)])
    read = read_points(tmp_path / "a.ply")
    np.testing.assert_array_equal(read.colours, cloud.colours)
    for name, column in cloud.attributes.items():
        np.testing.assert_array_equal(read.attributes[name], column)


def test_sources_of_different_units_are_not_joined(tmp_path: Path) -> None:
    source = make_source(tmp_path, PointCloud(np.zeros((3, 3))))
    with pytest.raises(InputError, match="another unit"):
        write_joined(tmp_path / "a.ply", [replace(source, unit="m"), replace(source, unit="ft")])
    assert not (tmp_path / "a.ply").exists()


def test_unit_frame_and_scanners_come_back(tmp_path: Path) -> None:
    source = replace(
        make_source(tmp_path, PointCloud(np.random.default_rng(0).random((9, 3)))),
        unit="US ft", crs="EPSG:2992", scans=(Scan(scanner=np.array([1.5, -2.0, 1e6 + 1e-9])),),
    )  # fmt: skip
    write_joined(tmp_path / "a.ply", [source])
    read = open_points(tmp_path / "a.ply")
    assert (read.unit, read.crs) == ("US ft", "EPSG:2992")
    assert read.scans[0].scanner is not None
    np.testing.assert_array_equal(read.scans[0].scanner, [1.5, -2.0, 1e6 + 1e-9])


def test_a_written_file_can_be_read_again_whatever_its_count(tmp_path: Path) -> None:
    for count in (1, 9, 10, 12345):
        source = make_source(tmp_path, PointCloud(np.random.default_rng(0).random((count, 3))))
        write_joined(tmp_path / "a.ply", [source])
        assert open_points(tmp_path / "a.ply").count == count
    write_points(tmp_path / "b.ply", read_points(tmp_path / "a.ply"))
