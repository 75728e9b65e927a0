"""Which points of a LAS file there are, and which are left out."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from shared_data import shared

from hpcapp.geometry.points import PointCloud
from hpcapp.io import open_points
from hpcapp.io.las.points import open_las
from hpccomponent.errors import InputError

MakeLas = Callable[..., Path]
GPS_WITHHELD, OVERLAP = 4, 8


def old_point(number: int, classification: int = 0, format_0: bool = True) -> bytes:
    start = struct.pack("<3iHBBbBH", number, 0, 0, 9, 0, classification, 0, 0, 0)
    return start if format_0 else start + struct.pack("<d", float("nan"))


def new_point(number: int, flags: int = 0, classification: int = 0) -> bytes:
    return struct.pack("<3iHBBBBhHd", number, 0, 0, 9, 0, flags, classification, 0, 0, 0, 0.0)


def read(path: Path, rows: int = 1000) -> tuple[list[float], dict[str, int]]:
    source = open_las(path)
    parts = list(source.chunks(rows))
    xs = np.concatenate([part.positions[:, 0] for part in parts])
    return xs.tolist(), source.findings.dropped


@pytest.mark.parametrize("rows", [1, 3, 100])
def test_withheld_and_noise_are_left_out(make_las: MakeLas, rows: int) -> None:
    classes = [0, 7, 0x80, 0x87, 12, 2, 18, 0x60]
    path = make_las([old_point(i, some) for i, some in enumerate(classes)], scale=1, offset=0)
    assert read(path, rows) == ([0, 4, 5, 6, 7], {"withheld": 2, "noise": 1})


@pytest.mark.parametrize("rows", [1, 3, 100])
def test_overlap_stays(make_las: MakeLas, rows: int) -> None:
    points = [
        new_point(0), new_point(1, OVERLAP), new_point(2, GPS_WITHHELD), new_point(3, 0, 18),
        new_point(4, 0, 7), new_point(5, GPS_WITHHELD, 7), new_point(6, 3), new_point(7, 0, 128),
    ]  # fmt: skip
    path = make_las(points, 6, scale=1, offset=0)
    assert read(path, rows) == ([0, 1, 6, 7], {"withheld": 2, "noise": 2})


def test_each_pass_counts_anew(make_las: MakeLas) -> None:
    source = open_las(make_las([old_point(0), old_point(1, 0x80)]))
    for _ in range(2):
        list(source.chunks(10))
    assert source.findings.dropped == {"withheld": 1}


def test_nothing_left(make_las: MakeLas) -> None:
    (part,) = open_las(make_las([old_point(0, 0x80)])).chunks(10)
    assert len(part) == 0
    assert "intensity" in part.attributes


def test_time_that_is_no_number(make_las: MakeLas) -> None:
    path = make_las([old_point(3, format_0=False)], 1, scale=1, offset=0)
    assert read(path) == ([3], {})


def test_last_point_cut_behind_its_coordinates(make_las: MakeLas) -> None:
    path = make_las([old_point(i) for i in range(3)], scale=1, offset=0)
    path.write_bytes(path.read_bytes()[:-6])
    assert read(path) == ([0, 1, 2], {})
    assert "last point is cut" in open_las(path).findings.warnings[0]


@pytest.mark.parametrize(("missing", "whole"), [(9, 2), (20, 2), (39, 1), (60, 0)])
def test_cut_points(make_las: MakeLas, missing: int, whole: int) -> None:
    path = make_las([old_point(i) for i in range(3)])
    path.write_bytes(path.read_bytes()[:-missing])
    with pytest.raises(InputError, match=f"ends after {whole} of 3 points"):
        open_las(path)


def test_cut_after_opening(make_las: MakeLas) -> None:
    path = make_las([old_point(i) for i in range(3)])
    source = open_las(path)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(InputError, match="ends before its last point"):
        list(source.chunks(10))


def test_heights_of_another_unit_are_told(make_las: MakeLas) -> None:
    wkt = b'COMPD_CS["a",PROJCS["b",UNIT["f",0.3048]],VERT_CS["c",UNIT["m",1]]]'
    source = open_points(make_las([old_point(0)], vlrs=[(b"LASF_Projection", 2112, wkt)]))
    (warning,) = source.findings.warnings
    assert warning.startswith("x and y are in ft, heights in m: ")
    assert "multiplied by 3.2808 for the surface" in warning


def test_what_was_flown_over_is_found_in_the_points(make_las: MakeLas) -> None:
    places = np.random.default_rng(0).integers(0, 10_000, (2_000, 2)).tolist()
    for ground in (2, 1):
        points = [struct.pack("<3iH2BbBH", x, y, 9, 0, 9, ground, 0, 0, 0) for x, y in places]
        source = open_points(make_las(points, name=f"{ground}.las"))
        assert source.is_flown == (ground == 2)
        assert source.up == ("z (flown)" if ground == 2 else "unknown")


def test_no_points(make_las: MakeLas) -> None:
    with pytest.raises(InputError, match="no points"):
        open_las(make_las([old_point(0)], announced=0))


@pytest.mark.parametrize("rows", [100, 4096, 1 << 20])
def test_parts_are_the_whole(make_las: MakeLas, rows: int) -> None:
    path = make_las([old_point(i) for i in range(5000)], scale=0.001, offset=5e6)
    source = open_points(path)
    parts = list(source.chunks(rows))
    assert all(len(part) <= rows for part in parts)
    xs = np.concatenate([part.positions[:, 0] for part in parts])
    assert xs.tobytes() == (np.arange(5000) * 0.001 + 5e6).tobytes()
    assert (source.count, source.unit, source.crs) == (5000, None, None)
    assert source.up == "unknown"
    assert source.columns[:4] == ("x", "y", "z", "intensity")


def real(name: str) -> Path:
    return shared(f"real/las/{name}")


def read_real(name: str) -> PointCloud:
    parts = list(open_las(real(name)).chunks(10_000))
    return PointCloud(
        np.concatenate([part.positions for part in parts]),
        None,
        np.concatenate([part.colours for part in parts if part.colours is not None]),
    )


def test_compressed_and_plain_are_the_same() -> None:
    one, other = read_real("autzen_trim.laz"), read_real("autzen_trim.las")
    assert one.positions.tobytes() == other.positions.tobytes()
    assert one.colours is not None
    assert other.colours is not None
    assert one.colours.tobytes() == other.colours.tobytes()
    assert len(one) == 110_000


@pytest.mark.parametrize(
    ("name", "count", "unit"),
    [
        ("garbage_nVariableLength.las", 719, None),
        ("lone-star.laz", 518_862, "m"),
        ("4_6_crop.las", 23_875, "US ft"),
        ("epsg_4326.las", 5380, "degree"),
        ("simple1_3.las", 999, "m"),
        ("1_4_w_evlr.laz", 1000, "US ft"),
        ("fullwave.laz", 10_750, "m"),
        ("1.2-with-color.copc.laz", 1065, "m"),
    ],
)
def test_real_files(name: str, count: int, unit: str | None) -> None:
    source = open_las(real(name))
    assert sum(len(part) for part in source.chunks(1 << 16)) == count
    assert source.unit == unit
