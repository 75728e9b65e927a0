"""The verb ``convert``, from file to file."""

import logging
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from hpcapp.applications.points.command import convert
from hpcapp.geometry.points import PointCloud
from hpcapp.io import open_points, read_points, write_points
from hpccomponent.errors import OutputError


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    attributes = {"intensity": rng.integers(0, 999, 40).astype(np.uint16)}
    origin = np.array([4.5e5, 5.4e6, 0.0])
    cloud = PointCloud(rng.random((40, 3)), None, None, attributes, origin)
    write_points(tmp_path / "scan.ply", cloud, "EPSG:2180", "m")
    return tmp_path / "scan.ply"


def run(*words: str | Path) -> None:
    done = CliRunner().invoke(convert, [str(word) for word in words], catch_exceptions=False)
    assert done.exit_code == 0


@pytest.mark.parametrize("name", ["a.las", "a.laz"])
def test_coordinate_system_and_unit_are_kept(scan: Path, tmp_path: Path, name: str) -> None:
    run(scan, "-o", tmp_path / name)
    again = open_points(tmp_path / name)
    assert (again.crs, again.unit) == ("EPSG:2180", "m")
    wanted, read = read_points(scan), read_points(tmp_path / name)
    away = read.positions + read.origin - (wanted.positions + wanted.origin)
    assert np.abs(away).max() < 1e-6
    assert read.attributes["intensity"].tolist() == wanted.attributes["intensity"].tolist()


def test_what_the_output_cannot_hold_is_said_in_one_line(
    scan: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    run(scan, "-o", tmp_path / "a.xyz")
    (warning,) = [record.message for record in caplog.records if record.levelno == logging.WARNING]
    assert "holds no intensity, no CRS (EPSG:2180), no unit (m) of points" in warning


def test_points_that_are_left_out_are_counted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rows = [f"{x / 7} {x % 5} {x % 3}" for x in range(1, 200)] + ["0 0 0"] * 100
    (tmp_path / "a.xyz").write_text("\n".join(rows) + "\n")
    run(tmp_path / "a.xyz", "-o", tmp_path / "a.ply")
    assert len(read_points(tmp_path / "a.ply")) == 199
    assert "dropped 100 points" in caplog.text


@pytest.mark.parametrize("name", ["a.las", "a.e57"])
def test_missing_returns_stay_out_of_formats_that_have_none(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, name: str
) -> None:
    positions = np.random.default_rng(0).random((40, 3))
    positions[[3, 9], 1] = np.nan
    write_points(tmp_path / "a.npz", PointCloud(positions))
    run(tmp_path / "a.npz", "-o", tmp_path / name)
    assert len(read_points(tmp_path / name)) == 38
    assert "dropped 2 NaN or infinite points" in caplog.text


def test_several_files_become_one(scan: Path, tmp_path: Path) -> None:
    run(scan, scan, "-o", tmp_path / "both.ply")
    both = read_points(tmp_path / "both.ply")
    assert both.attributes["scan"].tolist() == [0] * 40 + [1] * 40
    assert open_points(tmp_path / "both.ply").crs == "EPSG:2180"


def test_the_input_is_not_overwritten(scan: Path) -> None:
    before = scan.read_bytes()
    with pytest.raises(OutputError, match="is the input itself"):
        run(scan, "-o", scan)
    assert scan.read_bytes() == before


def test_what_a_job_drops_can_be_written_by_itself(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    random = np.random.default_rng(1)
    flat = np.column_stack([random.uniform(0.0, 60.0, (3_600, 2)), np.zeros(3_600)])
    above = np.column_stack([random.uniform(10.0, 50.0, (20, 2)), np.full(20, 6.0)])
    colours = np.zeros((3_620, 3), np.uint8)
    colours[3_600:] = 255
    cloud = PointCloud(np.concatenate([flat, above]), None, colours)
    write_points(tmp_path / "scan.ply", cloud)
    caplog.set_level(logging.INFO)
    run(tmp_path / "scan.ply", "-o", tmp_path / "a.ply", "--rejected", tmp_path / "r.ply")
    rejected = read_points(tmp_path / "r.ply")
    assert 15 <= len(rejected) <= 20
    assert rejected.colours is not None
    assert (rejected.colours == 255).all()
    assert len(read_points(tmp_path / "a.ply")) == len(cloud)
    assert "strays" in caplog.text
