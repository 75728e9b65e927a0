"""All scans of a file as one cloud."""

from __future__ import annotations

import struct
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mutated_files import page_e57, read_pages
from read_parts import read_parts
from shared_data import shared

from hpcapp.geometry.points import PointCloud
from hpcapp.io.e57.points import open_e57
from hpcapp.io.points.point_source import PointSource
from hpccomponent.errors import InputError, MissingLibraryError

pytest.importorskip("pye57", reason="pye57 is not installed")

MakeE57 = Callable[..., Path]
MakeScan = Callable[..., Any]


def read(path: Path, rows: int = 1000) -> tuple[PointSource, PointCloud]:
    source = open_e57(path)
    return source, read_parts(source, rows)


def colours_of(values: Any) -> dict[str, Any]:
    names = ("colorRed", "colorGreen", "colorBlue")
    return {name: np.array(values)[:, i] for i, name in enumerate(names)}


@pytest.mark.parametrize("rows", [1, 2, 100])
def test_scans_in_order(make_e57: MakeE57, scan: MakeScan, rows: int) -> None:
    path = make_e57(
        scan([[1, 2, 3], [4, 5, 6], [7, 8, 9]], translation=(10, 0, 0)),
        scan([], translation=(0, 0, 0)),
        # A quarter turn about z, then a step.
        scan([[1, 0, 0]], rotation=(0.5**0.5, 0, 0, 0.5**0.5), translation=(0, 0, 5)),
        scan([[1, 1, 1]]),
    )
    source, cloud = read(path, rows)
    expected = [[11, 2, 3], [14, 5, 6], [17, 8, 9], [0, 1, 5], [1, 1, 1]]
    np.testing.assert_allclose(cloud.positions, expected, atol=1e-15)
    assert cloud.attributes["scan"].tolist() == [0, 0, 0, 2, 3]
    assert cloud.attributes["scan"].dtype == np.int32
    assert [one.points for one in source.scans] == [3, 0, 1, 1]
    scanners = [one.scanner.tolist() for one in source.scans if one.scanner is not None]
    assert scanners == [[10, 0, 0], [0, 0, 0], [0, 0, 5], [0, 0, 0]]
    assert (source.count, source.unit, source.format) == (5, "m", "E57")
    assert not source.findings.warnings


def test_a_cloud_without_a_pose_was_seen_from_nowhere(make_e57: MakeE57, scan: MakeScan) -> None:
    """Points that were exported, as by `convert`, have no pose; so has a scan in its own frame."""
    positions = [[1, 0, 0], [1, 1, 0], [1, 0, 1], [1, 1, 1]]
    bare = open_e57(make_e57(scan(positions), scan(positions)))
    assert [one.scanner for one in bare.scans] == [None, None]
    rows, columns = np.array([0, 0, 1, 1], np.int32), np.array([0, 1, 0, 1], np.int32)
    organised = scan(positions, fields={"rowIndex": rows, "columnIndex": columns})
    for source in (
        open_e57(make_e57(organised)),
        open_e57(make_e57(scan(positions, rotation=(0.5**0.5, 0, 0, 0.5**0.5)))),
    ):
        assert source.scans[0].scanner is not None
        assert not source.scans[0].scanner.any()


@pytest.mark.parametrize("rotation", [None, (0.0, 0.0, 0.0, 0.0), (2.0, 0.0, 0.0, 0.0)])
def test_rotation_that_is_none(
    make_e57: MakeE57, scan: MakeScan, rotation: tuple[float, ...] | None
) -> None:
    path = make_e57(scan([[1, 2, 3]], rotation=rotation, translation=(4, 5, 6)))
    assert read(path)[1].positions.tolist() == [[5, 7, 9]]


@pytest.mark.parametrize("rows", [1, 7, 50])
def test_parts_have_the_bits_of_the_whole(make_e57: MakeE57, scan: MakeScan, rows: int) -> None:
    positions = np.random.default_rng(1).normal(size=(100, 3))
    path = make_e57(scan(positions, rotation=(0.1, 0.7, -0.3, 0.4), translation=(0.1, 0.2, 1e6)))
    assert read(path, rows)[1].positions.tobytes() == read(path)[1].positions.tobytes()


def test_normals_turn_with_the_scan(make_e57: MakeE57, scan: MakeScan) -> None:
    fields = {f"nor:normal{axis}": np.array([float(axis == "X")]) for axis in "XYZ"}
    turned = scan([[1, 0, 0]], fields=fields, rotation=(0.5**0.5, 0, 0, 0.5**0.5))
    source, cloud = read(make_e57(turned))
    assert source.has_normals
    assert cloud.normals is not None
    np.testing.assert_allclose(cloud.normals, [[0, 1, 0]], atol=1e-15)


def test_spherical_coordinates(make_e57: MakeE57, scan: MakeScan) -> None:
    one = scan([])
    fields = {
        "sphericalRange": np.array([2.0, 2.0, 4.0]),
        "sphericalAzimuth": np.array([0.0, np.pi / 2, np.pi]),
        "sphericalElevation": np.array([0.0, 0.0, np.pi / 6]),
        "sphericalInvalidState": np.array([0, 2, 0], np.int8),
    }
    source, cloud = read(make_e57(type(one)(fields, translation=(1, 0, 0))))
    np.testing.assert_allclose(
        cloud.positions, [[3, 0, 0], [1 - 4 * np.cos(np.pi / 6), 0, 2]], atol=1e-15
    )
    assert source.findings.dropped == {"invalid": 1}


@pytest.mark.parametrize("rows", [1, 2, 100])
def test_invalid_points(make_e57: MakeE57, scan: MakeScan, rows: int) -> None:
    states = np.array([0, 1, 2, 0, 2], np.int8)
    fields = {"cartesianInvalidState": states, "intensity": np.arange(5.0)}
    path = make_e57(scan(np.arange(15.0).reshape(5, 3), fields=fields))
    source, cloud = read(path, rows)
    assert cloud.attributes["intensity"].tolist() == [0, 3]
    assert source.findings.dropped == {"invalid": 3}
    list(source.chunks(rows))
    assert source.findings.dropped == {"invalid": 3}
    assert set(cloud.attributes) == {"intensity"}


def test_only_invalid_points(make_e57: MakeE57, scan: MakeScan) -> None:
    fields = {"cartesianInvalidState": np.array([2], np.int8), "intensity": np.ones(1)}
    source, cloud = read(make_e57(scan([[1, 2, 3]], fields=fields)))
    assert len(cloud) == 0
    assert set(cloud.attributes) == {"intensity"}
    assert source.findings.dropped == {"invalid": 1}


def test_grid(make_e57: MakeE57, scan: MakeScan) -> None:
    fields = {
        "rowIndex": np.array([3, 3, 4, 5], np.int32),
        "columnIndex": np.array([10, 11, 10, 11], np.int32),
    }
    numbers = {"indexBounds": {"rowMinimum": 0, "rowMaximum": 9999}}  # not what there is
    organised = scan(np.zeros((4, 3)), fields=fields, numbers=numbers)
    source, cloud = read(make_e57(organised, scan([[0, 0, 0]])))
    assert [one.grid for one in source.scans] == [(2, 3), None]
    assert cloud.attributes["row"].tolist() == [0, 0, 1, 2, -1]
    assert cloud.attributes["column"].tolist() == [0, 1, 0, 1, -1]


@pytest.mark.parametrize(
    ("rows", "columns"), [([0, 1, 2, 3], [0] * 4), ([0, 1, 2, 2_000_000], [0, 1, 0, 1])]
)
def test_what_is_no_grid(
    make_e57: MakeE57, scan: MakeScan, rows: list[int], columns: list[int]
) -> None:
    fields = {"rowIndex": np.array(rows, np.int32), "columnIndex": np.array(columns, np.int32)}
    source, cloud = read(make_e57(scan(np.zeros((4, 3)), fields=fields)))
    assert source.scans[0].grid is None
    assert not cloud.attributes


@pytest.mark.parametrize(
    ("values", "limits", "expected"),
    [
        (np.array([[1, 2, 255]], np.uint8), None, np.array([[1, 2, 255]], np.uint8)),
        (np.array([[1, 2, 65280]], np.uint16), None, np.array([[1, 2, 65280]], np.uint16)),
        (np.array([[1, 2, 255]], np.uint16), 255, np.array([[1, 2, 255]], np.uint8)),
        (np.array([[0, 1023, 0]], np.uint16), 1023, np.array([[0, 65535, 0]], np.uint16)),
        (np.array([[0.0, 1.0, 0.5]]), 1.0, np.array([[0, 65535, 32768]], np.uint16)),
        (np.array([[np.nan, -1.0, 300.0]]), 255.0, np.array([[0, 0, 255]], np.uint8)),
        (np.array([[0.0, 1.0, 0.5]]), None, np.array([[0.0, 1.0, 0.5]])),
    ],
)
def test_colours(
    make_e57: MakeE57, scan: MakeScan, values: Any, limits: float | None, expected: Any
) -> None:
    stated = {f"color{name}Maximum": limits for name in ("Red", "Green", "Blue")}
    numbers = {} if limits is None else {"colorLimits": stated}
    _, cloud = read(make_e57(scan([[0, 0, 0]], fields=colours_of(values), numbers=numbers)))
    assert cloud.colours is not None
    assert cloud.colours.dtype == expected.dtype
    assert cloud.colours.tolist() == expected.tolist()


def test_colours_of_scans_have_one_scale(make_e57: MakeE57, scan: MakeScan) -> None:
    path = make_e57(
        scan([[0, 0, 0]], fields=colours_of(np.array([[1, 2, 255]], np.uint8))),
        scan([[0, 0, 0]], fields=colours_of(np.array([[1, 2, 65280]], np.uint16))),
    )
    colours = read(path)[1].colours
    assert colours is not None
    assert colours.tolist() == [[257, 514, 65535], [1, 2, 65280]]


def test_columns_that_most_points_have(make_e57: MakeE57, scan: MakeScan) -> None:
    many = {
        **colours_of(np.full((3, 3), 7, np.uint8)),
        **{f"nor:normal{axis}": np.ones(3) for axis in "XYZ"},
        "intensity": np.arange(3.0),
    }
    path = make_e57(scan(np.zeros((3, 3)), fields=many), scan(np.zeros((2, 3))))
    source, cloud = read(path)
    assert cloud.colours is not None
    assert cloud.normals is not None
    assert cloud.colours[:, 0].tolist() == [7, 7, 7, 255, 255]
    assert cloud.normals[:, 0].tolist() == [1, 1, 1, 0, 0]
    np.testing.assert_array_equal(cloud.attributes["intensity"], [0, 1, 2, np.nan, np.nan])
    assert source.findings.warnings == [
        "2 of 5 points are of scans without normals: these are zero there",
        "2 of 5 points are of scans without colours: they are white",
    ]


def test_colours_are_kept_and_normals_left_out_where_few_points_have_them(
    make_e57: MakeE57, scan: MakeScan
) -> None:
    few = colours_of(np.full((1, 3), 7, np.uint8))
    few |= {f"nor:normal{axis}": np.ones(1) for axis in "XYZ"}
    source, cloud = read(make_e57(scan([[0, 0, 0]]), scan([[0, 0, 0]], fields=few)))
    assert cloud.colours is not None
    assert cloud.colours.tolist() == [[255, 255, 255], [7, 7, 7]]
    assert cloud.normals is None
    assert source.findings.warnings == [
        "1 of 2 points are of scans without normals: no normals are kept",
        "1 of 2 points are of scans without colours: they are white",
    ]


def test_other_fields(make_e57: MakeE57, scan: MakeScan) -> None:
    fields = {
        "intensity": np.array([257.896]),
        "timeStamp": np.array([12.5]),
        "returnIndex": np.array([1], np.int8),
        "returnCount": np.array([2], np.int8),
    }
    source, cloud = read(make_e57(scan([[0, 0, 0]], fields=fields)))
    assert {name: values.tolist() for name, values in cloud.attributes.items()} == {
        "intensity": [257.896], "time": [12.5], "return_number": [1], "number_of_returns": [2],
    }  # fmt: skip
    assert source.columns == ("cartesianX", "cartesianY", "cartesianZ", *fields)


def test_crs(make_e57: MakeE57, scan: MakeScan) -> None:
    wkt = 'PROJCS["a",UNIT["metre",1]]'
    assert open_e57(make_e57(scan([[0, 0, 0]]), crs=wkt)).crs == wkt
    assert open_e57(make_e57(scan([[0, 0, 0]]), crs=" ")).crs is None


def test_no_scan(make_e57: MakeE57) -> None:
    with pytest.raises(InputError, match="holds no scan"):
        open_e57(make_e57())


def test_no_points(make_e57: MakeE57, scan: MakeScan) -> None:
    with pytest.raises(InputError, match="no points: its scans are empty"):
        open_e57(make_e57(scan([])))


def test_no_coordinates(make_e57: MakeE57, scan: MakeScan) -> None:
    one = scan([])
    with pytest.raises(InputError, match="scan 0 has no coordinates: intensity"):
        open_e57(make_e57(type(one)({"intensity": np.ones(2)})))


@pytest.mark.parametrize("at", [100, 1500, 2500])
def test_flipped_byte(make_e57: MakeE57, scan: MakeScan, at: int) -> None:
    path = make_e57(scan(np.zeros((200, 3))))
    content = bytearray(path.read_bytes())
    content[at] ^= 0xFF
    path.write_bytes(content)
    with pytest.raises(InputError, match="is no sound E57 file: checksum"):
        read(path)


@pytest.mark.parametrize("size", [0, 10, 48, 500, 1024, 2048, 3000])
def test_cut(make_e57: MakeE57, scan: MakeScan, size: int) -> None:
    path = make_e57(scan(np.zeros((200, 3))))
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(InputError, match="is no sound E57 file"):
        read(path)


def sum_page(page: bytes) -> int:
    """Return CRC-32C of a page."""
    checksum = 0xFFFFFFFF
    for byte in page:
        checksum ^= byte
        for _ in range(8):
            checksum = checksum >> 1 ^ (0x82F63B78 if checksum & 1 else 0)
    return checksum ^ 0xFFFFFFFF


@pytest.mark.parametrize("seed", range(30))
def test_damage_behind_right_checksums(make_e57: MakeE57, scan: MakeScan, seed: int) -> None:
    path = make_e57(scan(np.arange(60.0).reshape(20, 3), fields={"intensity": np.arange(20.0)}))
    content = bytearray(path.read_bytes())
    random = np.random.default_rng(seed)
    for at in random.integers(0, len(content), 2).tolist():
        content[at] = random.integers(0, 256)
        page = at // 1024 * 1024
        checksum = sum_page(bytes(content[page : page + 1020]))
        content[page + 1020 : page + 1024] = struct.pack(">I", checksum)
    path.write_bytes(content)
    with suppress(InputError):
        read(path)


def test_fewer_points_than_declared(make_e57: MakeE57, scan: MakeScan) -> None:
    path = make_e57(scan(np.zeros((200, 3))), scan(np.ones((20, 3))))
    held = read_pages(path.read_bytes())
    path.write_bytes(page_e57(held.replace(b'recordCount="20"', b'recordCount="60"')))
    with pytest.raises(InputError, match="scan 1 ends after 20 of 60 points"):
        read(path)


def test_no_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pye57", None)
    with pytest.raises(MissingLibraryError, match=r"pip install 'pye57>"):
        open_e57(tmp_path / "a.e57")


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        open_e57(tmp_path / "a.e57")


@pytest.mark.parametrize(
    ("name", "count"),
    [("pumpAVisualReferenceImage", 155_201), ("bunnyInt32", 30_571), ("ColourRepresentation", 153)],
)
def test_real_files(name: str, count: int) -> None:
    source, cloud = read(shared(f"real/e57/{name}.e57"), 10_000)
    assert len(cloud) == count
    if name.startswith("pump"):
        assert source.scans[0].grid == (345, 1074)
        assert cloud.attributes["row"].max() == 1073
