"""The table of formats: what a file of points holds, and what is said of the rest."""

from collections.abc import Callable
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from hpcapp.geometry.points import PointCloud
from hpcapp.io import open_points, read_points, write_points
from hpcapp.io.points.point_source import Scan
from hpcapp.io.registry import FORMATS, Format, list_suffixes

WKT = 'PROJCS["a",GEOGCS["b",UNIT["degree",0.0174532925]],UNIT["metre",1]]'
SCANS = (Scan(scanner=np.array([1.0, 2.0, 3.0])),)


def make_cloud() -> PointCloud:
    attributes = {"intensity": np.arange(9.0), "mark": np.arange(9)}
    return PointCloud(np.random.default_rng(0).random((9, 3)), None, None, attributes)


@pytest.mark.parametrize(
    ("name", "crs", "unit", "lost"),
    [
        ("a.ply", "EPSG:2180", "m", None),
        ("a.las", "EPSG:2180", "m", "no scanner positions"),
        ("a.las", WKT, "m", "no scanner positions"),
        ("a.laz", None, "US ft", "no scanner positions"),
        ("a.las", "local grid", "mm", "no CRS (local grid), no scanner positions"),
        ("a.las", None, "degree", "no unit (degree), no scanner positions"),
        ("a.e57", "EPSG:2180", "m", "no mark, no CRS (EPSG:2180), no scanner positions"),
        ("a.e57", WKT, "ft", "no mark, no unit (ft), no scanner positions"),
        ("a.npz", "EPSG:2180", "m", "no CRS (EPSG:2180), no unit (m), no scanner positions"),
        ("a.xyz", None, None, "no intensity, no mark, no scanner positions"),
    ],
)
def test_what_a_file_does_not_hold_is_one_line_and_the_rest_comes_back(
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
    name: str,
    crs: str | None,
    unit: str | None,
    lost: str | None,
) -> None:
    path = tmp_path / name
    write_points(path, make_cloud(), crs, unit, SCANS)
    if lost is None:
        assert not caplog.messages
    else:
        (message,) = caplog.messages
        suffix = path.suffix
        assert message.endswith(f"{suffix} holds {lost} of points: left out; .ply holds all")
    again = open_points(path)
    said = lost or ""
    assert again.crs == (None if "CRS" in said else crs)
    if "unit" not in said and unit is not None:
        assert again.unit == unit
    scanner = again.scans[0].scanner
    assert (scanner is not None and scanner.tolist() == [1, 2, 3]) == ("scanner" not in said)


@pytest.mark.parametrize("name", ["a.ply", "a.las", "a.laz", "a.e57", "a.npz", "a.xyz"])
def test_of_what_every_file_holds_nothing_is_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, cloud: PointCloud, name: str
) -> None:
    write_points(tmp_path / name, cloud)
    assert not caplog.messages


def test_text_holds_the_intensity_before_colours(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    colours = np.full((9, 3), 7, np.uint8)
    cloud = replace(make_cloud(), colours=colours)
    write_points(tmp_path / "a.xyz", cloud)
    assert "holds no mark of points" in caplog.text
    assert read_points(tmp_path / "a.xyz").attributes["intensity"].tolist() == list(range(9))


@pytest.mark.parametrize(
    "role",
    [
        lambda one: one.point_reader,
        lambda one: one.mesh_reader,
        lambda one: one.point_writer,
        lambda one: one.mesh_writer,
    ],
)
def test_a_suffix_means_one_format_and_its_functions_are_there(
    role: Callable[[Format], object],
) -> None:
    suffixes = list_suffixes(role)
    assert len(set(suffixes)) == len(suffixes) > 0
    for one in FORMATS:
        named = [getattr(role(one), name, None) for name in ("function", "finds_faces")]
        for module, _, name in (function.partition(":") for function in named if function):
            assert callable(getattr(import_module(f"hpcapp.io.{module}"), name))
