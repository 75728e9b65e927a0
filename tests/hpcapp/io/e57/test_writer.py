"""What is written as E57 is read back, by us and by pye57."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hpcapp.geometry.points import PointCloud
from hpcapp.io import read_points, write_points
from hpcapp.io.e57.points import open_e57
from hpccomponent.errors import OutputError

pye57 = pytest.importorskip("pye57", reason="pye57 is not installed")


def test_all_columns(tmp_path: Path, cloud: PointCloud) -> None:
    intensity = np.random.default_rng(2).random(50)
    intensity[7] = np.nan
    origin = np.array([5e5, 4e6, 100.0])
    whole = PointCloud(
        cloud.positions, cloud.normals, cloud.colours, {"intensity": intensity}, origin
    )
    crs = 'PROJCS["a",UNIT["metre",1]]'
    write_points(tmp_path / "a.e57", whole, crs)
    source = open_e57(tmp_path / "a.e57")
    assert (source.crs, source.count, source.has_normals) == (crs, 50, True)
    (again,) = source.chunks(100)
    assert again.positions.tobytes() == (cloud.positions + origin).tobytes()
    assert again.normals is not None
    assert cloud.normals is not None
    assert again.normals.tobytes() == cloud.normals.tobytes()
    assert again.colours is not None
    assert cloud.colours is not None
    assert again.colours.tobytes() == cloud.colours.tobytes()
    np.testing.assert_array_equal(again.attributes["intensity"], intensity)


def test_pye57_reads_it(tmp_path: Path, cloud: PointCloud) -> None:
    write_points(tmp_path / "a.e57", PointCloud(cloud.positions, None, cloud.colours))
    with pye57.E57(str(tmp_path / "a.e57")) as file:
        read = file.read_scan(0, colors=True, ignore_missing_fields=True)
        header = file.get_header(0)
        assert header.xMinimum == cloud.positions[:, 0].min()
        assert header.zMaximum == cloud.positions[:, 2].max()
    assert (read["cartesianY"] == cloud.positions[:, 1]).all()
    assert cloud.colours is not None
    assert (read["colorGreen"] == cloud.colours[:, 1]).all()


def test_colours_of_16_bit(tmp_path: Path) -> None:
    colours = np.array([[0, 300, 65535]], np.uint16)
    write_points(tmp_path / "a.e57", PointCloud(np.zeros((1, 3)), None, colours))
    (again,) = open_e57(tmp_path / "a.e57").chunks(10)
    assert again.colours is not None
    assert again.colours.tolist() == colours.tolist()


def test_many_points(tmp_path: Path) -> None:
    positions = np.random.default_rng(1).normal(size=(600_000, 3))
    write_points(tmp_path / "a.e57", PointCloud(positions))
    again = np.concatenate([part.positions for part in open_e57(tmp_path / "a.e57").chunks(77_777)])
    assert again.tobytes() == positions.tobytes()


def test_suffix_in_capitals(tmp_path: Path, cloud: PointCloud) -> None:
    write_points(tmp_path / "A.E57", cloud)
    assert read_points(tmp_path / "A.E57").positions.tobytes() == cloud.positions.tobytes()


def test_no_points(tmp_path: Path) -> None:
    write_points(tmp_path / "a.e57", PointCloud(np.zeros((0, 3))))
    with pye57.E57(str(tmp_path / "a.e57")) as file:
        assert file.get_header(0).point_count == 0


def test_no_folder(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="create the folder"):
        write_points(tmp_path / "none" / "a.e57", PointCloud(np.zeros((1, 3))))
