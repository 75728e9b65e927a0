"""PCD files made by hand, and what must come of them."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from read_parts import read_parts

from hpcapp.io.pcd.points import open_pcd
from hpcapp.io.points.point_source import read_whole
from hpccomponent.errors import InputError

Make = Callable[..., Path]

POINTS = np.array([[1.5, 2.5, -3.5], [4.0, np.nan, 6.0], [-7.0, 8.0, 9.25], [0.5, 0.25, 0.0]])
COLOURS = np.array([[255, 0, 7], [1, 2, 3], [0, 128, 255], [9, 8, 7]], np.uint8)
PACKED = (COLOURS.astype(np.uint32) << [16, 8, 0]).sum(axis=1).astype("<u4") | 0xFF000000
HEADER = """# .PCD v0.7
VERSION 0.7
FIELDS {fields}
SIZE {sizes}
TYPE {types}
COUNT {counts}
WIDTH {width}
HEIGHT {height}
VIEWPOINT {viewpoint}
POINTS {points}
DATA {encoding}
"""


def header(fields: str, formats: str, encoding: str, **changes: object) -> bytes:
    """A header of four points, from the names of fields and formats such as ``3f4``."""
    words = formats.split()
    entries = {
        "fields": fields,
        "sizes": " ".join(word[-1] for word in words),
        "types": " ".join(word[-2].upper() for word in words),
        "counts": " ".join(word[:-2] or "1" for word in words),
        "width": 4,
        "height": 1,
        "viewpoint": "0 0 0 1 0 0 0",
        "points": 4,
        "encoding": encoding,
    }
    return HEADER.format_map({**entries, **changes}).encode()


def pack_lzf(content: bytes) -> bytes:
    """Compress as LZF does: repetitions of four bytes that were there before, else literals."""
    packed, at, literal = b"", 0, b""

    def flush(some: bytes) -> bytes:
        return b"".join(
            bytes([len(some[i : i + 32]) - 1]) + some[i : i + 32] for i in range(0, len(some), 32)
        )

    while at < len(content):
        start = content.rfind(content[at : at + 4], max(0, at - 8192), at + 3) if at else -1
        if start < 0 or at + 4 > len(content):
            literal += content[at : at + 1]
            at += 1
            continue
        length = 4
        while at + length < len(content) and length < 264:
            if content[start + length] != content[at + length]:
                break
            length += 1
        packed, literal, back = packed + flush(literal), b"", at - start - 1
        head = min(length - 2, 7) << 5 | back >> 8
        packed += bytes([head, *([length - 9] if length >= 9 else []), back & 255])
        at += length
    return packed + flush(literal)


def compressed(content: bytes) -> bytes:
    packed = pack_lzf(content)
    return struct.pack("<II", len(packed), len(content)) + packed


@pytest.mark.parametrize("encoding", ["ascii", "binary", "binary_compressed"])
@pytest.mark.parametrize("rgb", ["u4", "f4"])
@pytest.mark.parametrize("rows", [1, 3, 10])
def test_every_encoding_holds_the_same(make_file: Make, encoding: str, rgb: str, rows: int) -> None:
    """Fields of any case, padding, a field without numbers, packed colours, normals."""
    head = header(
        "X y Z _ empty rgb normal_x normal_y normal_z Curvature label ring",
        f"f4 f8 f4 3u1 0f4 {rgb} f4 f4 f4 f4 u1 2i2",
        encoding,
    )
    packed = PACKED.view("<f4") if rgb == "f4" else PACKED
    columns = [
        POINTS[:, 0].astype("<f4"), POINTS[:, 1].astype("<f8"), POINTS[:, 2].astype("<f4"),
        np.full((4, 3), 7, "u1"), packed, *np.eye(4, 3, dtype="<f4").T,
        np.arange(4, dtype="<f4"), np.arange(4, dtype="u1"),
        np.arange(8, dtype="<i2").reshape(4, 2),
    ]  # fmt: skip
    if encoding == "ascii":
        if rgb == "f4":  # alpha makes it NaN, whose bits no text holds
            columns[4] = (PACKED & 0xFFFFFF).view("<f4")
        rows_ = zip(*([np.atleast_1d(v) for v in column] for column in columns), strict=True)
        body = "".join(
            " ".join(repr(v) for part in row for v in part.tolist()) + "\n" for row in rows_
        ).encode()
    elif encoding == "binary":
        row = np.dtype([(f"c{i}", c.dtype, c.shape[1:]) for i, c in enumerate(columns)])
        table = np.empty(4, row)
        for i, column in enumerate(columns):
            table[f"c{i}"] = column
        body = table.tobytes()
    else:
        body = compressed(b"".join(column.tobytes() for column in columns))
    source = open_pcd(make_file("a.pcd", head + body))
    cloud = read_parts(source, rows)
    np.testing.assert_array_equal(cloud.positions, POINTS)
    np.testing.assert_array_equal(cloud.normals, np.eye(4, 3))
    np.testing.assert_array_equal(cloud.colours, COLOURS)
    assert {name: values.tolist() for name, values in cloud.attributes.items()} == {
        "Curvature": [0, 1, 2, 3],
        "label": [0, 1, 2, 3],
        "ring_0": [0, 2, 4, 6],
        "ring_1": [1, 3, 5, 7],
    }
    assert cloud.attributes["label"].dtype == np.uint8
    assert source.count == 4
    assert source.is_double
    assert not source.findings.warnings
    assert (source.records is not None) == (encoding == "binary")
    assert source.scans[0].scanner is None  # a viewpoint that is not known


def test_text_keeps_more_digits_than_the_size_announces(make_file: Make) -> None:
    body = b"289814.15,4320978.61,170.76\n" * 4
    source = open_pcd(make_file("a.pcd", header("x y z", "f4 f4 f4", "ascii") + body))
    assert read_parts(source, 10).positions[3].tolist() == [289814.15, 4320978.61, 170.76]
    assert source.is_double


def test_whole_numbers_in_text_are_packed_colours_whatever_their_type(make_file: Make) -> None:
    body = "".join(f"1 2 3 {word}\n" for word in PACKED.tolist())
    for kind in ("f4", "u4"):
        head = header("x y z rgba", f"f4 f4 f4 {kind}", "ascii")
        cloud = read_parts(open_pcd(make_file("a.pcd", head + body.encode())), 10)
        np.testing.assert_array_equal(cloud.colours, COLOURS)


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_an_organised_cloud_knows_its_grid_and_its_camera(make_file: Make, encoding: str) -> None:
    head = header("x y z", "f4 f4 f4", encoding, width=2, height=2)
    text = "\n".join(" ".join(map(repr, row)) for row in POINTS.tolist()).encode()
    body = text if encoding == "ascii" else POINTS.astype("<f4").tobytes()
    source = open_pcd(make_file("a.pcd", head + body))
    (scan,) = source.scans
    assert scan.grid == (2, 2)
    assert scan.scanner is not None
    assert not scan.scanner.any()
    for rows in (1, 3, 10):
        cloud = read_parts(source, rows)
        assert cloud.attributes["row"].tolist() == [0, 0, 1, 1]
        assert cloud.attributes["column"].tolist() == [0, 1, 0, 1]
        assert cloud.attributes["row"].dtype == np.int32
    assert source.records is None


@pytest.mark.parametrize(
    ("viewpoint", "scanner"),
    [
        ("1 2 3 1 0 0 0", [1, 2, 3]),
        ("0 0 0 0 1 0 0", [0, 0, 0]),
        ("0 0 0 1 0 0 0", None),
        ("nan 0 0 1 0 0 0", None),
    ],
)
def test_the_viewpoint_is_the_scanner(
    make_file: Make, viewpoint: str, scanner: list[float] | None
) -> None:
    head = header("x y z", "f4 f4 f4", "ascii", viewpoint=viewpoint)
    source = open_pcd(make_file("a.pcd", head + b"1 2 3\n" * 4))
    found = source.scans[0].scanner
    assert (None if found is None else found.tolist()) == scanner
    assert read_parts(source, 10).positions.tolist() == [[1, 2, 3]] * 4  # they stay where they are


def test_old_headers_leave_lines_out(make_file: Make) -> None:
    text = "# .PCD v.5\r\nVERSION .5\r\nCOLUMNS x y z\r\nPOINTS 1\r\nDATA ascii\r\n1 2 3\r\n"
    assert read_parts(open_pcd(make_file("a.pcd", text)), 10).positions.tolist() == [[1, 2, 3]]


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_more_points_than_announced_are_left_out_with_a_word(
    make_file: Make, encoding: str
) -> None:
    body = b"1 2 3\n" * 6 if encoding == "ascii" else bytes(12 * 6)
    source = open_pcd(make_file("a.pcd", header("x y z", "f4 f4 f4", encoding) + body))
    assert len(read_parts(source, 3)) == 4
    assert len(source.findings.warnings) == 1


def test_a_size_that_does_not_fit_the_points_is_no_grid(make_file: Make) -> None:
    head = header("x y z", "f4 f4 f4", "ascii", width=2, height=3)
    source = open_pcd(make_file("a.pcd", head + b"1 2 3\n" * 4))
    assert len(read_parts(source, 3)) == 4
    assert source.scans[0].grid is None
    assert "WIDTH 2 and HEIGHT 3 do not make 4 POINTS" in source.findings.warnings[0]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is empty"),
        (b"1 2 3\n4 5 6\n", ":1: no PCD header"),
        (b"VERSION 0.7\nFIELDS x y z\nPOINTS 1\n", "no line DATA"),
        (b"VERSION 0.7\nFIELDS x y z\n1 2 3\nDATA ascii\n", ":3: '1' is no part of a header"),
        (b"VERSION 0.7\nPOINTS 1\nDATA ascii\n", "no line FIELDS"),
        (b"FIELDS x y z\nDATA ascii\n1 2 3\n", "no line POINTS"),
        (b"FIELDS x y z\nPOINTS 1\nDATA zipped\n", "DATA 'zipped' is none of ascii"),
        (b"FIELDS x y z\nSIZE 4 4\nPOINTS 1\nDATA ascii\n", "SIZE '4 4' is not 3 whole numbers"),
        (b"FIELDS x y z\nSIZE 4 4 3\nPOINTS 1\nDATA ascii\n", "makes 'z' 3 bytes, which type F"),
        (b"FIELDS x y z\nPOINTS -1\nDATA ascii\n", "POINTS '-1' is not 1 whole number"),
        (b"FIELDS a b\nPOINTS 1\nDATA ascii\n1 2\n", "has no x, y, z"),
        (b"FIELDS x y z normal_x\nPOINTS 1\nDATA ascii\n1 2 3 4\n", "not all of nx, ny, nz"),
    ],
)
def test_bad_headers_are_refused(make_file: Make, content: bytes, said: str) -> None:
    with pytest.raises(InputError, match=said):
        read_whole(open_pcd(make_file("a.pcd", content)))


@pytest.mark.parametrize(
    ("encoding", "points", "body", "said"),
    [
        ("ascii", 4, b"1 2 3\n" * 3, "truncated: 4 points are announced, the file ends after 3"),
        ("ascii", 4, b"1 2 3\n1 2\n" * 2, ":13: 2 columns where 3 are expected"),
        ("binary", 4, bytes(47), "truncated: 4 points of 12 bytes are announced, 47 bytes follow"),
        ("binary", 10**14, bytes(48), "truncated"),
        ("binary_compressed", 4, bytes(7), "truncated"),
        ("binary_compressed", 4, compressed(bytes(48))[:-1], "truncated"),
        ("binary_compressed", 4, compressed(bytes(36)), "announce 48 bytes of points"),
        ("binary_compressed", 10**14, struct.pack("<II", 4, 48) + b"\1abc", "announce"),
        ("binary_compressed", 4, struct.pack("<II", 2, 48) + b"\x20\x00", "damaged: it repeats"),
        ("binary_compressed", 4, struct.pack("<II", 3, 48) + b"\0a\xe0", "damaged: it ends"),
        ("binary_compressed", 4, struct.pack("<II", 3, 48) + b"\1ab", "damaged: it holds other"),
    ],
)
def test_damaged_points_are_refused(
    make_file: Make, encoding: str, points: int, body: bytes, said: str
) -> None:
    head = header("x y z", "f4 f4 f4", encoding, width=points, points=points)
    with pytest.raises(InputError, match=said):
        read_whole(open_pcd(make_file("a.pcd", head + body)))
