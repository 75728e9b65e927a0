"""What a header says is believed as far as the file's size allows."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from hpcapp.io.las.header import LasHeader, find_crs, read_header
from hpcapp.io.points.point_source import Findings
from hpccomponent.errors import InputError

MakeLas = Callable[..., Path]
POINT = struct.pack("<3i8x", 1, 2, 3)
WKT = 'PROJCS["a",UNIT["foot",0.3048]]'


def read(path: Path) -> tuple[LasHeader, list[str]]:
    findings = Findings()
    with path.open("rb") as file:
        header = read_header(file, path, findings)
    return header, findings.warnings


def test_plain(make_las: MakeLas) -> None:
    header, warnings = read(make_las([POINT] * 3, scale=0.25, offset=-7.0))
    assert (header.version, header.point_format, header.count) == ((1, 2), 0, 3)
    assert (header.points_start, header.record_length) == (227, 20)
    assert header.scales.tolist() == [0.25] * 3
    assert header.offsets.tolist() == [-7.0] * 3
    assert not header.is_compressed
    assert not warnings


@pytest.mark.parametrize("announced", [1, 3, 1_069_128_089])
def test_fewer_records_than_announced(make_las: MakeLas, announced: int) -> None:
    header, warnings = read(make_las([POINT], announced_vlrs=announced))
    assert header.count == 1
    assert warnings == [f"the header announces {announced} variable length records, there are 0"]


def test_record_longer_than_its_place(make_las: MakeLas) -> None:
    path = make_las([POINT], vlrs=[(b"LASF_Projection", 2112, WKT.encode())], padding=b"\0\0")
    damaged = bytearray(path.read_bytes())
    damaged[227 + 20 : 227 + 22] = b"\xff\xff"
    path.write_bytes(damaged)
    header, warnings = read(path)
    assert not header.records
    assert len(warnings) == 1


def test_padding_before_the_points(make_las: MakeLas) -> None:
    header, warnings = read(make_las([POINT], vlrs=[(b"x", 1, b"abc")], padding=b"\xdd\xcc"))
    assert header.points_start == 227 + 54 + 3 + 2
    assert not warnings


@pytest.mark.parametrize("user", [b"LASF_Projection", b"liblas"])
def test_crs_in_a_record(make_las: MakeLas, user: bytes) -> None:
    header, _ = read(make_las([POINT], vlrs=[(b"x", 1, b""), (user, 2112, WKT.encode() + b"\0")]))
    crs = find_crs(header.records)
    assert crs is not None
    assert (crs.text, crs.unit) == (WKT, "ft")


def test_crs_behind_the_points(make_las: MakeLas) -> None:
    path = make_las(
        [POINT + bytes(10)], 6, evlrs=[(b"y", 7, b"z"), (b"LASF_Projection", 2112, WKT.encode())]
    )
    crs = find_crs(read(path)[0].records)
    assert crs is not None
    assert crs.unit == "ft"


def test_unit_that_only_the_keys_state(make_las: MakeLas) -> None:
    keys = struct.pack("<8H", 1, 1, 0, 1, 3076, 0, 1, 9003)
    vlrs = [(b"LASF_Projection", 34735, keys), (b"LASF_Projection", 2112, b'PROJCS["a"]')]
    crs = find_crs(read(make_las([POINT], vlrs=vlrs))[0].records)
    assert crs is not None
    assert (crs.text, crs.unit) == ('PROJCS["a"]', "US ft")


def test_no_crs(make_las: MakeLas) -> None:
    assert find_crs(read(make_las([POINT]))[0].records) is None


def test_old_count_is_zero(make_las: MakeLas) -> None:
    assert read(make_las([POINT + bytes(10)] * 4, 6, legacy=0))[0].count == 4


def test_new_count_is_zero(make_las: MakeLas) -> None:
    assert read(make_las([POINT + bytes(10)] * 4, 6, announced=0, legacy=4))[0].count == 4


@pytest.mark.parametrize(
    ("at", "value", "named"),
    [
        (0, b"PK\3\4", "no LAS file"),
        (96, struct.pack("<I", 100), "header is damaged"),
        (96, struct.pack("<I", 1 << 31), "points, which begin at byte 2147483648"),
        (94, struct.pack("<H", 9), "header is damaged"),
        (131, struct.pack("<d", float("nan")), "scale"),
        (131, struct.pack("<d", 0.0), "scale"),
        (155, struct.pack("<d", float("inf")), "offset"),
    ],
)
def test_damaged_header(make_las: MakeLas, at: int, value: bytes, named: str) -> None:
    path = make_las([POINT])
    damaged = bytearray(path.read_bytes())
    damaged[at : at + len(value)] = value
    path.write_bytes(damaged)
    with pytest.raises(InputError, match=named):
        read(path)


@pytest.mark.parametrize("size", [0, 3, 4, 100, 226])
def test_cut_header(make_las: MakeLas, size: int) -> None:
    path = make_las([POINT])
    path.write_bytes(path.read_bytes()[:size])
    with pytest.raises(InputError, match=r"a\.las: "):
        read(path)
