"""Numbers of points, times and northings in front are told from x, y and z, however sorted."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hpcapp.geometry.points import FloatArray
from hpcapp.io import open_points, read_whole
from hpcapp.io.points.point_source import PointSource

RANDOM = np.random.default_rng(6)
ROWS = 3000
DIRECTIONS = RANDOM.normal(size=(ROWS, 3))
BALL = np.round(DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1)[:, None], 4)
MAP = np.array([476_000.0, 5_200_000.0, 400.0])
SITE = np.round(80 * BALL + MAP, 3)
SHINE = np.round(RANDOM.uniform(0, 1, ROWS), 3)
CODES = np.where(np.arange(ROWS) % 3 > 0, "GND", "TREE")
COUNT = np.arange(ROWS)


def open_rows(path: Path, *columns: NDArray[Any]) -> PointSource:
    """Write columns, and open them."""
    rows = zip(*(column.tolist() for column in columns), strict=True)
    path.write_text("\n".join(",".join(map(str, row)) for row in rows))
    return open_points(path)


def read(source: PointSource) -> FloatArray:
    cloud = read_whole(source)
    return np.add(cloud.positions, cloud.origin)


CLOCKS: dict[str, Callable[[], NDArray[Any]]] = {
    "even": lambda: 1.6e9 + 0.0371 * COUNT,
    "from zero": lambda: np.round(0.1 * COUNT, 3),
    "uneven": lambda: 412_000 + np.cumsum(RANDOM.uniform(0.07, 0.13, ROWS)),
    "with losses": lambda: 412_000 + np.cumsum(np.where(RANDOM.random(ROWS) < 0.1, 0.7, 0.1)),
    "nanoseconds": lambda: 1.6e18 + 5e7 * COUNT,
    "packets": lambda: 1.6e9 + 0.1 * (COUNT // 300),
}


@pytest.mark.parametrize("name", CLOCKS)
@pytest.mark.parametrize("shift", [0 * MAP, MAP])
def test_a_first_column_that_only_grows_is_the_time(
    tmp_path: Path, name: str, shift: FloatArray
) -> None:
    source = open_rows(tmp_path / "a.txt", CLOCKS[name](), *(BALL + shift).T, SHINE)
    np.testing.assert_allclose(read(source), BALL + shift)
    assert source.columns == ("time", "x", "y", "z", "intensity")
    assert len(source.findings.warnings) == 1


def _sort(positions: FloatArray, decimals: int = 4) -> FloatArray:
    return np.round(positions[np.argsort(positions[:, 0])], decimals)


def _make_raster() -> FloatArray:
    x, y = (axis.ravel() for axis in np.meshgrid(0.5 * np.arange(60), 0.5 * np.arange(50)))
    return np.column_stack([x, y, np.round(np.sin(x) + y, 3)])


def _make_helix() -> FloatArray:
    return np.column_stack([0.01 * COUNT, np.cos(0.1 * COUNT), np.sin(0.1 * COUNT)])


SORTED: dict[str, tuple[FloatArray, ...]] = {
    "sorted": (_sort(BALL), SHINE),
    "sorted, two decimals": (_sort(BALL, 2), SHINE),
    "sorted, one of many decimals": (_sort(BALL, 9), SHINE),
    "sorted, on a map": (_sort(SITE), SHINE),
    "raster row by row": (_make_raster(), SHINE),
    "raster column by column": (_sort(_make_raster()), SHINE),
    "x y z alone": (_make_helix(),),
    "helix with normals": (_make_helix(), _make_helix() * (0, 1, 1)),
    "helix with bytes": (_make_helix(), np.rint(255 * SHINE)),
}


@pytest.mark.parametrize("name", SORTED)
def test_x_that_grows_is_no_time(tmp_path: Path, name: str) -> None:
    columns = [column for part in SORTED[name] for column in np.atleast_2d(part.T)]
    source = open_rows(tmp_path / "a.txt", *columns)
    assert source.columns[:3] == ("x", "y", "z")
    assert not source.findings.warnings


NUMBERS = {
    "from one": 1 + COUNT,
    "from a thousand, with gaps": 1000 + np.cumsum(1 + (RANDOM.random(ROWS) < 0.1)),
    "in no order": RANDOM.permutation(ROWS),
    "words": np.array([f"P{number}" for number in COUNT]),
}


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize(
    ("file", "swaps"),
    [("a.csv", False), ("a.csv", True), ("site_pnezd.csv", True), ("PENZD.txt", False)],
)
def test_survey_lists_are_not_mirrored(tmp_path: Path, name: str, file: str, swaps: bool) -> None:
    columns = SITE[:, [1, 0, 2]] if swaps else SITE
    source = open_rows(tmp_path / file, NUMBERS[name], *columns.T, CODES)
    np.testing.assert_allclose(read(source), SITE)
    said = any("northing" in line for line in source.findings.warnings)
    assert said == (swaps or file != "a.csv")


@pytest.mark.parametrize(
    ("names", "swaps"), [("number,y,x,z,code", True), ("number,x,y,z,code", False)]
)
def test_a_list_that_nothing_tells_of_is_doubted_and_names_help(
    tmp_path: Path, names: str, swaps: bool
) -> None:
    path, local = tmp_path / "a.csv", np.round(40 * BALL + (5000, 4800, 100), 3)
    source = open_rows(path, 1 + COUNT, *local.T, CODES)
    np.testing.assert_allclose(read(source), local)
    (line,) = (line for line in source.findings.warnings if "number,y,x,z,code" in line)
    assert "x, y, z" in line
    path.write_text(f"{names}\n{path.read_text()}")
    named = open_points(path)
    np.testing.assert_allclose(read(named), local[:, [1, 0, 2]] if swaps else local)
    assert not named.findings.warnings


STATE_PLANE = {  # northing, easting in US feet
    "Idaho": (820_000, 2_700_000),
    "Indiana": (850_000, 3_200_000),
    "Michigan": (450_000, 13_300_000),
    "Montana": (450_000, 1_500_000),
}


@pytest.mark.parametrize("zone", STATE_PLANE)
@pytest.mark.parametrize("more", [(), (CODES,), (SHINE,)])
def test_a_list_in_feet_is_doubted(
    tmp_path: Path, zone: str, more: tuple[NDArray[Any], ...]
) -> None:
    places = np.round(80 * BALL + (*STATE_PLANE[zone], 400.0), 3)
    source = open_rows(tmp_path / "a.csv", 1 + COUNT, *places.T, *more)
    np.testing.assert_allclose(read(source), places)
    assert any("number,y,x,z,code" in line for line in source.findings.warnings)


@pytest.mark.parametrize("file", ["a.csv", "nez.csv", "pnezdx.csv"])
def test_x_y_z_alone_stay_as_they_are(tmp_path: Path, file: str) -> None:
    """As of American grids, whose eastings are larger than their northings."""
    source = open_rows(tmp_path / file, *(SITE[:, [1, 0, 2]]).T)
    np.testing.assert_allclose(read(source), SITE[:, [1, 0, 2]])
    assert not source.findings.warnings
