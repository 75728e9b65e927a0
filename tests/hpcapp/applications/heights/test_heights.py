"""Heights and contours of a terrain whose heights are known, on a map."""

from __future__ import annotations

import json
import logging
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from click.testing import CliRunner
from on_earth import put_on_earth

import hpcapp
from hpcapp.applications.heights.command import heights
from hpcapp.applications.heights.grid import HeightGrid
from hpcapp.cli import hpcapp as program
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, FloatArray, PointCloud
from hpcapp.io import write_mesh, write_points
from hpcapp.io.crs import Crs
from hpcapp.io.placement import note_origin
from hpccomponent.errors import InputError, MissingLibraryError, UsageError

PLACE = np.array([512_000.0, 5_403_000.0, 300.0])
NOISE = 0.05


def rise(x: FloatArray, y: FloatArray) -> FloatArray:
    """Return the height of the ground at places of the map."""
    x, y = x - PLACE[0], y - PLACE[1]
    height: FloatArray = PLACE[2] + 3.0 * np.sin(x / 9.0) * np.cos(y / 11.0) + 0.05 * x
    return height


def scan(count: int, noise: float = NOISE) -> PointCloud:
    """Return points of the ground, 60 by 40, but of a pond."""
    rng = np.random.default_rng(0)
    local = rng.random((count, 2)) * (60.0, 40.0)
    local = local[~in_pond(local)]
    z = rise(*(local + PLACE[:2]).T) + rng.normal(0.0, noise, len(local)) - PLACE[2]
    return PointCloud(np.column_stack([local, z]), origin=PLACE)


def in_pond(local: FloatArray) -> BoolArray:
    inside: BoolArray = np.hypot(local[:, 0] - 40.0, local[:, 1] - 20.0) < 6.0
    return inside


def lay_mesh() -> Mesh:
    """Return faces 0.5 wide of the same ground."""
    y, x = np.indices((81, 121)) * 0.5
    places = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    places[:, 2] = rise(*(places[:, :2] + PLACE[:2]).T) - PLACE[2]
    number = np.arange(x.size).reshape(x.shape)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    faces = np.concatenate(
        [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, d), (a, d, c))]
    )
    return Mesh(places, faces, origin=PLACE)


def run(*words: str | Path) -> None:
    CliRunner().invoke(heights, list(map(str, words)), catch_exceptions=False)


def read(path: Path) -> tuple[SimpleNamespace, FloatArray, FloatArray]:
    """Return an image, its heights, and those that are true at the middles of its cells."""
    rasterio = pytest.importorskip("rasterio")
    with rasterio.open(path) as image:
        rows, columns = np.indices(image.shape)
        a, _, west, _, e, north = image.transform[:6]
        x, y = west + a * (columns + 0.5), north + e * (rows + 0.5)
        told = SimpleNamespace(
            transform=image.transform, shape=image.shape, count=image.count, crs=image.crs,
            nodata=image.nodata, units=image.units,
        )  # fmt: skip
        return told, image.read(1).astype(np.float64), rise(x, y)


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    write_points(tmp_path / "ground.las", scan(20_000), "EPSG:25832")
    return tmp_path / "ground.las"


def test_heights_of_points_are_as_sure_as_is_said(
    survey: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO, "hpcapp")
    run(survey, "-o", tmp_path / "dtm.tif", "--step", "1")
    image, found, true = read(tmp_path / "dtm.tif")
    assert image.crs.to_epsg() == 25832
    assert image.transform[:6] == (1.0, 0.0, PLACE[0], 0.0, -1.0, PLACE[1] + 40.0)
    assert (*image.shape, image.count) == (40, 60, 1)
    assert np.isnan(image.nodata)
    assert image.units == ("m",)
    assert "of the heights are off by" in caplog.text
    said = float(caplog.text.split("are off by ")[1].split()[0])
    off = np.abs(found - true)[np.isfinite(found)]
    assert (off <= said).mean() >= 0.95
    assert said < 3.0 * np.quantile(off, 0.95)
    pond = np.pi * 6.0**2
    assert np.isnan(found).sum() == pytest.approx(pond, rel=0.25)


def test_a_mesh_has_the_heights_of_its_faces(tmp_path: Path) -> None:
    write_mesh(tmp_path / "ground.ply", lay_mesh())
    note_origin(tmp_path / "ground.ply", np.zeros(3), Crs("EPSG:25832", "m"), holds_crs=False)
    run(tmp_path / "ground.ply", "-o", tmp_path / "dtm.tif", "--step", "0.25")
    image, found, true = read(tmp_path / "dtm.tif")
    assert image.shape == (160, 240)
    assert image.crs.to_epsg() == 25832
    assert np.isfinite(found).all()
    assert np.abs(found - true).max() < 0.002  # the faces' own error, and single precision


@pytest.mark.parametrize(("step", "corner"), [("7", (511_994.0, 5_403_041.0)), ("0.3", None)])
def test_borders_are_multiples_of_the_step(
    survey: Path, tmp_path: Path, step: str, corner: tuple[float, float] | None
) -> None:
    run(survey, "-o", tmp_path / "dtm.tif", "--step", step)
    image, found, true = read(tmp_path / "dtm.tif")
    west, north = image.transform[2], image.transform[5]
    assert west / float(step) == pytest.approx(round(west / float(step)), abs=1e-6)
    assert north / float(step) == pytest.approx(round(north / float(step)), abs=1e-6)
    if corner is not None:
        assert (west, north) == corner
    else:
        assert np.nanmedian(np.abs(found - true)) < NOISE


@pytest.mark.parametrize("count", [3_000, 8_000, 20_000])
def test_cells_are_as_wide_as_points_are_apart(tmp_path: Path, count: int) -> None:
    """Half as wide has holes; twice as wide errs more in between, of a ground without noise."""
    write_points(tmp_path / "ground.las", scan(count, noise=0.0), "EPSG:25832")
    usual = hpcapp.heights(tmp_path / "ground.las")
    narrow, wide = (
        hpcapp.heights(tmp_path / "ground.las", step=factor * usual.step) for factor in (0.5, 2.0)
    )
    error, more = (find_error(grid) for grid in (usual, wide))
    known, less, _ = (np.isfinite(grid.values).mean() for grid in (usual, narrow, wide))
    assert more > 2.0 * error
    assert known > 0.9
    assert less < known - 0.05


def find_error(grid: HeightGrid) -> float:
    """Return the root mean square where four cells meet: a map is read between its middles."""
    v = grid.values
    rows, columns = np.indices(v[1:, 1:].shape) + 1
    between = (v[:-1, :-1] + v[1:, :-1] + v[:-1, 1:] + v[1:, 1:]) / 4.0
    true = rise(*(np.stack([columns, -rows]) * grid.step + [[[grid.west]], [[grid.north]]]))
    return float(np.sqrt(np.nanmean((between - true) ** 2)))


def test_cells_are_wider_where_they_would_be_too_many(
    survey: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = hpcapp.heights(survey)
    monkeypatch.setattr("hpcapp.applications.heights.grid.MOST_CELLS", usual.values.size // 2)
    fewer = hpcapp.heights(survey)
    assert usual.step < fewer.step
    assert fewer.values.size <= usual.values.size // 2


def test_contours_lie_at_their_heights(survey: Path, tmp_path: Path) -> None:
    lines = tmp_path / "lines.geojson"
    run(survey, "-o", tmp_path / "dtm.tif", "--contours", lines, "--interval", "0.5")
    found = json.loads(lines.read_text())
    assert found["crs"]["properties"]["name"] == "urn:ogc:def:crs:EPSG::25832"
    levels = {feature["properties"]["height"] for feature in found["features"]}
    assert levels == set(np.arange(min(levels), max(levels) + 0.1, 0.5))
    assert max(levels) - min(levels) > 5.0
    for feature in found["features"]:
        places = np.array(feature["geometry"]["coordinates"])
        off = rise(*places.T) - feature["properties"]["height"]
        assert np.abs(off).max() < 0.25
        assert np.hypot(*(places - PLACE[:2] - (40.0, 20.0)).T).min() > 3.0  # no line on the pond
    image, _, _ = read(tmp_path / "dtm.tif")
    assert image.transform[0] in (0.5, 1.0)  # eight points for each of the latter


def test_python_writes_the_same_files(survey: Path, tmp_path: Path) -> None:
    typed, called = tmp_path / "typed", tmp_path / "called"
    for folder in (typed, called):
        folder.mkdir()
    run(survey, "-o", typed / "a.tif", "--contours", typed / "a.json", "--interval", "0.5")
    grid = hpcapp.heights(survey)
    assert grid.save(called / "a.tif", contours=called / "a.json", interval=0.5) > 0
    for name in ("a.tif", "a.json"):
        assert (called / name).read_bytes() == (typed / name).read_bytes()
    with pytest.raises(UsageError, match="belong together"):
        grid.save(called / "b.tif", contours=called / "b.json")
    with pytest.raises(UsageError, match=r"are more than .* give step=.* or more"):
        hpcapp.heights(survey, step=1e-3)


def test_contours_name_what_epsg_has_no_code_for(survey: Path, tmp_path: Path) -> None:
    rasterio = pytest.importorskip("rasterio")
    own = (
        rasterio.crs.CRS.from_epsg(25832)
        .to_wkt()
        .replace('"central_meridian",9', '"central_meridian",9.7')
    )
    own = own.split(',AUTHORITY["EPSG","25832"]')[0].replace("ETRS89 / UTM zone 32N", "site") + "]"
    write_mesh(tmp_path / "ground.ply", lay_mesh())
    note_origin(tmp_path / "ground.ply", np.zeros(3), Crs(own, "m"), holds_crs=False)
    lines = tmp_path / "lines.geojson"
    run(tmp_path / "ground.ply", "-o", tmp_path / "dtm.tif", "--contours", lines, "--interval", "1")
    name = json.loads(lines.read_text())["crs"]["properties"]["name"]
    assert rasterio.crs.CRS.from_user_input(name) == read(tmp_path / "dtm.tif")[0].crs


def test_heights_stay_in_their_own_unit(tmp_path: Path) -> None:
    cloud = scan(20_000, 0.0)
    feet = PointCloud(cloud.positions / (1.0, 1.0, 0.3048), origin=PLACE / (1.0, 1.0, 0.3048))
    write_points(tmp_path / "feet.las", feet, "EPSG:25832", "m", height_unit="ft")
    run(tmp_path / "feet.las", "-o", tmp_path / "dtm.tif", "--step", "1")
    image, found, true = read(tmp_path / "dtm.tif")
    assert image.units == ("ft",)
    assert np.nanmax(np.abs(0.3048 * found - true)) < 0.2


def test_what_is_not_known_of_the_map_is_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    none = ("the site's own", "EPSG:1e9", "EPSG:0", '{"init": 5}', "/etc/passwd", "PROJCS[")
    for crs, said in ((None, "the input has none"), *((name, "is none by name") for name in none)):
        caplog.clear()
        write_points(tmp_path / "ground.ply", scan(5_000), crs)
        run(tmp_path / "ground.ply", "-o", tmp_path / "dtm.tif")
        assert said in caplog.text
        assert read(tmp_path / "dtm.tif")[0].crs is None


def test_what_cannot_be_written_is_refused_in_one_line(
    survey: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    dtm, lines = tmp_path / "dtm.tif", tmp_path / "lines.geojson"
    for words, problem in (
        ((survey, "-o", "dtm.png"), "is no GeoTIFF"),
        ((survey, "-o", dtm, "--contours", "lines.dxf", "--interval", "1"), "is no GeoJSON"),
        ((survey, "-o", dtm, "--interval", "1"), "belong together"),
        ((survey, "-o", dtm, "--step", "1e-3"), "cells 0.001 wide are more than"),
        ((survey, "-o", dtm, "--contours", lines, "--interval", "1e-6"), "more than 10,000"),
    ):
        with pytest.raises(UsageError, match=problem):
            run(*words)
    write_points(tmp_path / "one.ply", PointCloud(np.zeros((30, 3))))
    with pytest.raises(InputError, match="over one place"):
        run(tmp_path / "one.ply", "-o", dtm)
    write_points(tmp_path / "few.ply", PointCloud(np.eye(3)))
    with pytest.raises(InputError, match="no height at the middles of cells"):
        run(tmp_path / "few.ply", "-o", dtm)
    with pytest.raises(InputError, match=r"cells 5e\+03 wide.*dense enough for 0.5$"):
        run(survey, "-o", dtm, "--step", "5000")
    assert not dtm.exists()
    monkeypatch.setitem(sys.modules, "rasterio", None)
    with pytest.raises(MissingLibraryError, match="rasterio"):
        run(survey, "-o", dtm)


@pytest.mark.parametrize("suffix", [".laz", ".xyz", ".ply"])
def test_from_the_centre_of_the_earth_z_is_no_height(tmp_path: Path, suffix: str) -> None:
    local = scan(2_000)
    earth = put_on_earth(replace(local, origin=np.zeros(3)), 48.0)
    terrain, output = tmp_path / f"terrain{suffix}", tmp_path / "dtm.tif"
    write_points(terrain, earth, "EPSG:4978" if suffix == ".laz" else None)
    for command in (["heights", "-o", str(output)], ["compare", str(terrain), "--volume"]):
        run = CliRunner().invoke(program, [*command, str(terrain)])
        assert isinstance(run.exception, InputError)
        assert "centre of the earth (ECEF), and z is no height" in str(run.exception)
    assert not output.exists()
