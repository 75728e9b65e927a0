from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from read_parts import read_parts

from hpcapp.geometry.points import FloatArray
from hpcapp.io.text.ptx import open_ptx
from hpccomponent.errors import InputError

Make = Callable[..., Path]
RANDOM = np.random.default_rng(6)


def _rotation() -> FloatArray:
    matrix: FloatArray = np.linalg.qr(RANDOM.normal(size=(3, 3)))[0]
    return matrix


def _write(
    grid: tuple[int, int], rows: FloatArray, pose: FloatArray, scanner: FloatArray | None = None
) -> str:
    """Write a scan; `pose` has four rows of three numbers."""
    axes = [scanner if scanner is not None else pose[3], *pose[:3]]
    lines = [str(grid[0]), str(grid[1])]
    lines += [" ".join(map(repr, row)) for row in np.array(axes).tolist()]
    lines += [" ".join(map(repr, row)) for row in np.c_[pose, [0, 0, 0, 1]].tolist()]
    lines += [" ".join(f"{v:.17g}" for v in row) for row in rows.tolist()]
    return "\n".join([*lines, ""])


def _pose() -> FloatArray:
    return np.vstack([_rotation(), RANDOM.normal(size=3) * 100])


def _rows(cells: int, columns: int) -> FloatArray:
    rows = RANDOM.uniform(-10, 10, (cells, columns))
    if columns >= 6:
        rows[:, -3:] = RANDOM.integers(0, 256, (cells, 3))
    return rows


@pytest.mark.parametrize("columns", [3, 4, 6, 7])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_a_scan_is_placed_by_its_pose(make_file: Make, columns: int, end: str) -> None:
    pose, rows = _pose(), _rows(6, columns)
    path = make_file("a.ptx", _write((3, 2), rows, pose).replace("\n", end).rstrip())
    source = open_ptx(path)
    cloud = read_parts(source)
    np.testing.assert_allclose(cloud.positions, rows[:, :3] @ pose[:3] + pose[3], atol=1e-12)
    assert source.count == 6
    assert source.format == "PTX"
    (scan,) = source.scans
    assert (scan.points, scan.grid) == (6, (3, 2))
    np.testing.assert_array_equal(scan.scanner, pose[3])
    assert cloud.attributes["column"].tolist() == [0, 0, 1, 1, 2, 2]
    assert cloud.attributes["row"].tolist() == [0, 1] * 3
    assert "scan" not in cloud.attributes
    assert ("intensity" in cloud.attributes) == (columns in (4, 7))
    if columns in (4, 7):
        assert (cloud.attributes["intensity"] == rows[:, 3]).all()
    assert (cloud.colours is None) == (columns < 6)
    if columns >= 6:
        np.testing.assert_array_equal(cloud.colours, rows[:, -3:])
    assert source.findings.warnings == []
    assert source.findings.dropped == {}


@pytest.mark.parametrize("rows_at_once", [1, 4, 1000])
def test_missing_returns_are_dropped_before_the_pose(make_file: Make, rows_at_once: int) -> None:
    scans = [((4, 5), _rows(20, 7), _pose()), ((2, 3), _rows(6, 7), _pose())]
    scans[0][1][::3, :4] = [0, 0, 0, 0.5]
    scans[1][1][-1, :3] = 0
    source = open_ptx(make_file("a.ptx", "".join(_write(*scan) for scan in scans)))
    truth = [rows[rows[:, :3].any(axis=1)][:, :3] @ pose[:3] + pose[3] for _, rows, pose in scans]
    for _ in range(2):  # counted once, however often it is read
        cloud = read_parts(source, rows_at_once)
        np.testing.assert_allclose(cloud.positions, np.concatenate(truth), atol=1e-12)
        assert source.findings.dropped == {"missing returns": 8}
    assert cloud.attributes["scan"].tolist() == [0] * 13 + [1] * 5
    assert cloud.attributes["row"].tolist()[-5:] == [0, 1, 2, 0, 1]
    assert all(cloud.attributes[name].dtype == np.int32 for name in ("scan", "row", "column"))
    assert [scan.grid for scan in source.scans] == [(4, 5), (2, 3)]


def test_a_matrix_need_not_be_rigid(make_file: Make) -> None:
    pose = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 2], [600_000, 800_000, 400]])
    rows = np.array([[37012.24, 49028.31, 15.83]])
    cloud = read_parts(open_ptx(make_file("a.ptx", _write((1, 1), rows, pose))))
    np.testing.assert_allclose(cloud.positions, [[637012.24, 849028.31, 431.66]], atol=1e-9)


def test_where_the_scanner_stood(make_file: Make) -> None:
    pose, rows, stand = _pose(), _rows(1, 3), np.array([7.0, 8.0, 9.0])
    (scan,) = open_ptx(make_file("a.ptx", _write((1, 1), rows, pose, stand))).scans
    np.testing.assert_array_equal(scan.scanner, stand)
    (scan,) = open_ptx(make_file("b.ptx", _write((1, 1), rows, pose, np.zeros(3)))).scans
    np.testing.assert_array_equal(scan.scanner, pose[3])


def test_scans_that_lack_what_others_have(make_file: Make) -> None:
    first, second = _write((1, 2), _rows(2, 3), _pose()), _write((1, 1), _rows(1, 7), _pose())
    source = open_ptx(make_file("a.ptx", first + "\n\n" + second))
    cloud = read_parts(source, 1)
    assert cloud.colours is not None
    assert cloud.colours[:2].tolist() == [[255, 255, 255]] * 2
    assert np.isnan(cloud.attributes["intensity"]).tolist() == [True, True, False]
    assert source.columns == ("x", "y", "z", "intensity", "red", "green", "blue")
    assert source.findings.warnings == [
        "some scans lack intensities (NaN) or colours (white) that others have"
    ]


def test_nothing_but_missing_returns_is_one_empty_part(make_file: Make) -> None:
    source = open_ptx(make_file("a.ptx", _write((2, 2), np.zeros((4, 7)), _pose())))
    assert [len(part) for part in source.chunks(3)] == [0]
    assert source.findings.dropped == {"missing returns": 4}


HEAD = "1\n2\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", ": no points"),
        ("1 2 3\n", ":1: '1 2 3' is no number of columns"),
        ("9999999999\n1\n", ":1: '9999999999' is no number of columns"),
        (HEAD.replace("1\n2\n", "0\n0\n", 1), ": no points"),
        (HEAD, ": truncated: 2 points are announced in line 1, the file ends after 0"),
        (HEAD + "1 2 3 4\n", ": truncated: .* ends after 1"),
        (HEAD[:16], ":1: the file ends within the scan"),
        (HEAD.replace("0 0 0 1\n", "0 0 0\n"), ":10: 3 columns where 4"),
        (HEAD.replace("0 1 0\n", "0 oops 0\n", 1), ":5: 'oops' is not a number"),
        (HEAD.replace("0 1 0\n", "0 nan 0\n", 1), ":5: '0 nan 0' are not 3 finite"),
        (HEAD.replace("0 1 0\n", "# 1 0\n", 1), ":5: '# 1 0' are not 3 finite"),
        (HEAD.replace("1 0 0 0\n", "1 0 0 5\n"), ":1: the matrix"),
        (HEAD + "1 2 3 4 5\n" * 2, ":11: 5 columns, none of 3, 4, 6, 7"),
        (HEAD + "1 2 3 4\n1 2 3\n", ":12: 3 columns where 4"),
        (HEAD + "1 2 3 4\n\n", ":1: the scan announces 2 points and has 1"),
        (HEAD + "1 2 3 0 7 8 9\n1 2 3 0 7 8 0.5\n", ": point 1 has the colour"),
        (HEAD + "1 2 3 4\n" * 3, ":13: '1 2 3 4' is no number of columns"),
        (HEAD + "1 2 3 4\n" * 2 + "2\n", ":13: the file ends within the scan"),
        (HEAD + "1 2 3 4\n" + HEAD + "1 2 3 4\n" * 2, ":14: '0 0 0' is no number of rows"),
    ],
)
def test_what_does_not_fit_is_named(make_file: Make, content: str, said: str) -> None:
    path = make_file("bad.ptx", content)
    with pytest.raises(InputError, match=said) as refusal:
        read_parts(open_ptx(path))
    assert str(refusal.value).startswith(str(path))


@given(st.data())
@settings(max_examples=200, deadline=None)
def test_damage_gives_points_or_an_error(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    content = bytearray((HEAD + "1 2 3 0.5 7 8 9\n0 0 0 0.5 0 0 0\n").encode() * 2)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        content[at : at + data.draw(st.integers(0, 3))] = data.draw(
            st.sampled_from([b"", b"\n", b" ", b"9", b"-", b"\0", b"\xff", b"nan", b"e9", b","])
        )
    path = tmp_path_factory.mktemp("damage") / "a.ptx"
    path.write_bytes(content)
    said = str(path)
    try:
        assert read_parts(open_ptx(path), 3).positions.shape[1] == 3
    except InputError as error:
        said = str(error)
    assert str(path) in said
