"""What is written as LAS is read back, by us and by laspy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hpcapp.geometry.points import PointCloud
from hpcapp.io import read_points, write_points
from hpcapp.io.las.points import open_las
from hpcapp.io.las.writer import choose_grid
from hpccomponent.errors import OutputError

laspy = pytest.importorskip("laspy", reason="laspy is not installed")
pytest.importorskip("lazrs", reason="lazrs is not installed")

SUFFIXES = [".las", ".laz"]


def write_and_read(path: Path, cloud: PointCloud, crs: str | None = None) -> PointCloud:
    write_points(path, cloud, crs)
    (part,) = open_las(path).chunks(1 << 20)
    return part


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_all_columns(tmp_path: Path, cloud: PointCloud, suffix: str) -> None:
    random = np.random.default_rng(2)
    attributes: dict[str, Any] = {
        "intensity": random.integers(0, 65536, 50),
        "classification": random.integers(0, 6, 50),
        "gps_time": random.random(50),
        "scan_angle": random.integers(-9, 9, 50).astype(np.float32),
        "return_number": random.integers(1, 4, 50),
        "number_of_returns": random.integers(4, 9, 50),
        "point_source_id": random.integers(0, 65536, 50),
        "user_data": random.integers(0, 256, 50),
        "deviation": random.random(50).astype(np.float32),
        "precise": random.random(50),
        "row": np.arange(50, dtype=np.int32),
        "is_edge": random.random(50) < 0.5,
        "large": random.integers(-(1 << 60), 1 << 60, 50),
    }
    whole = PointCloud(
        cloud.positions, cloud.normals, cloud.colours, attributes, np.array([5e5, 4e6, 100.0])
    )
    again = write_and_read(tmp_path / f"a{suffix}", whole)
    np.testing.assert_allclose(
        again.positions, cloud.positions + whole.origin, rtol=0, atol=0.5001e-6
    )
    assert again.normals is not None
    assert cloud.normals is not None
    assert again.normals.tobytes() == cloud.normals.tobytes()  # float32 holds them
    assert again.colours is not None
    assert cloud.colours is not None
    assert (again.colours == cloud.colours.astype(np.uint16) * 257).all()
    for name, values in attributes.items():
        tolerance = 0.0031 if name == "scan_angle" else 0
        np.testing.assert_allclose(again.attributes[name], values, rtol=0, atol=tolerance)
    with laspy.open(tmp_path / f"a{suffix}") as reader:
        assert str(reader.header.version) == "1.4"
        assert reader.header.point_format.id == 7
        assert len(reader.read()) == 50


def test_defaults(tmp_path: Path) -> None:
    write_points(tmp_path / "a.las", PointCloud(np.eye(3)))
    written = laspy.read(tmp_path / "a.las")
    assert written.header.point_format.id == 6
    assert (np.array(written.return_number) == 1).all()
    assert (np.array(written.number_of_returns) == 1).all()
    assert written.header.mins.tolist() == [0, 0, 0]
    assert written.header.maxs.tolist() == [1, 1, 1]


@pytest.mark.parametrize(
    "positions",
    [
        np.array([[0.0, 0, 0], [1e-6, 2e-6, 0], [0, 3e-7, 1e-7]]),
        np.array([[0.0, 0, 0], [0.1, 0.15, 0], [0.123456789, 0, 0.05]]),
        np.array([[5e5, 4e6, 0], [5e5 + 1e-6, 4e6 + 123.456789, 33.3]]),
        np.array([[4e5, 4e6, 0], [6e5, 4.2e6, 3000.0], [5e5, 4.1e6, 7.25]]),
        np.array([[-6.4e6, 0, 0], [6.4e6, 1, 2]]),
        np.array([[1e12, 0, 0], [-1e12, 1e11, 2]]),
        np.array([[7.25, 7.25, 7.25]]),
    ],
)
def test_precision(tmp_path: Path, positions: NDArray[np.float64]) -> None:
    again = write_and_read(tmp_path / "a.las", PointCloud(positions)).positions
    extent = float(np.ptp(positions, axis=0).max())
    allowed = min(1e-6, 1e-6 * extent) if 0 < extent < 4000 else max(1e-6, 3e-9 * extent)
    # The last term is half a step of double precision.
    tolerance = allowed / 2 * 1.001 + np.abs(positions).max() * 2**-52
    assert np.abs(again - positions).max() <= tolerance


@pytest.mark.parametrize("power", range(-9, 10))
def test_grid_holds_the_cloud(power: int) -> None:
    for extent in np.linspace(1, 10, 37) * 10.0**power:
        low = np.array([3.7e5, -4.1e6, 0.0])
        scale, offset = choose_grid(low, low + extent)
        steps = np.array([low - offset, low + extent - offset]) / scale
        assert np.abs(steps).max() < 2**31 - 1


def test_values_that_fit_no_field(tmp_path: Path) -> None:
    attributes = {
        "intensity": np.array([0.0, 0.5, np.nan, 1.0]),
        "classification": np.array([0, 300, 2, 3]),
        "scan_angle": np.array([0.0, 200.0, 0, 0]),
        "withheld": np.array([1, 1, 1, 1]),
        "x" * 40: np.arange(4),
        "x" * 41: np.arange(4) * 2,
        "": np.arange(4),
    }
    cloud = PointCloud(np.eye(4)[:, :3].copy(), None, None, attributes)
    again = write_and_read(tmp_path / "a.las", cloud).attributes
    assert again["intensity"].tolist() == [0, 32768, 0, 65535]
    np.testing.assert_array_equal(again["intensity_raw"], attributes["intensity"])
    assert again["classification_raw"].tolist() == [0, 300, 2, 3]
    assert again["scan_angle_raw"].tolist() == [0, 200, 0, 0]
    assert again["withheld_raw"].tolist() == [1] * 4
    assert again["x" * 31].tolist() == [0, 1, 2, 3]
    assert again["x" * 27 + "_2"].tolist() == [0, 2, 4, 6]
    assert again["extra"].tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("crs", "unit"),
    [
        ("EPSG:32632", "m"),
        ("EPSG:4326", "degree"),
        ("EPSG:4978", "m"),
        ('PROJCS["a",UNIT["US survey foot",0.3048006096]]', "US ft"),
        ('GEOGCS["Größe",UNIT["degree",0.0174532925]]', "degree"),
        (None, None),
    ],
)
def test_crs(tmp_path: Path, crs: str | None, unit: str | None) -> None:
    write_points(tmp_path / "a.laz", PointCloud(np.eye(3)), crs)
    source = open_las(tmp_path / "a.laz")
    assert (source.crs, source.unit) == (crs, unit)


def test_crs_of_which_the_name_is_known(tmp_path: Path) -> None:
    write_points(tmp_path / "a.las", PointCloud(np.eye(3)), "local grid")
    assert open_las(tmp_path / "a.las").crs is None


def test_crs_too_long(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="has 70009 bytes"):
        write_points(tmp_path / "a.las", PointCloud(np.eye(3)), f'PROJCS["{"a" * 70_000}')
    assert not list(tmp_path.iterdir())


def test_far_from_zero(tmp_path: Path, cloud: PointCloud) -> None:
    far = PointCloud(cloud.positions, origin=np.array([5e5, 5.4e6, 0.0]))
    write_points(tmp_path / "A.LAZ", far)
    again = read_points(tmp_path / "A.LAZ")
    assert again.origin.any()
    away = (again.positions - cloud.positions) + (again.origin - far.origin)
    assert np.abs(away).max() < 0.501e-6


def test_no_points(tmp_path: Path) -> None:
    write_points(tmp_path / "a.laz", PointCloud(np.zeros((0, 3))))
    assert len(laspy.read(tmp_path / "a.laz")) == 0
