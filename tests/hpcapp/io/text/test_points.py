from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hpcapp.io.formats import open_points, read_points
from hpccomponent.errors import InputError

Make = Callable[..., Path]


@pytest.mark.slow
@pytest.mark.parametrize("separator", [" ", "\t", ",", ";", ", ", "  "])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_separators_are_told_apart(make_file: Make, separator: str, newline: str) -> None:
    rows = [separator.join(row.split()) for row in ("1 2 3.5", "-4e0 5 6")]
    cloud = read_points(make_file("a.xyz", newline.join(rows)))
    assert cloud.positions.tolist() == [[1, 2, 3.5], [-4, 5, 6]]


@pytest.mark.parametrize("row", ["1 2 3", "1;2;3"])
def test_comments_and_blank_lines_are_passed_over(make_file: Make, row: str) -> None:
    lines = ["\ufeff# by hand", "; x y z", "//X Y Z", "", f" {row} # first", "  ", f"{row} // 2nd"]
    assert len(read_points(make_file("a.txt", "\n".join(lines)))) == 2


@pytest.mark.parametrize(
    ("row", "normal", "color"),
    [
        ("1 2 3", None, None),
        ("1 2 3 0.7", None, None),
        ("1 2 3 0 0.6 -0.8", [0, 0.6, -0.8], None),
        ("1 2 3 0 0 1", [0, 0, 1], None),
        ("1 2 3 255 0 127", None, [255, 0, 127]),
        ("1 2 3 -1300 255 0 127", None, [255, 0, 127]),
        ("1 2 3 0 0 1 255 0 127", [0, 0, 1], [255, 0, 127]),
        ("1 2 3 255 0 127 0 0 1", [0, 0, 1], [255, 0, 127]),
    ],
)
def test_columns_tell_what_they_are(
    make_file: Make, row: str, normal: list[float] | None, color: list[int] | None
) -> None:
    cloud = read_points(make_file("a.xyz", f"{row}\n{row}\n"))
    assert cloud.positions.tolist() == [[1, 2, 3]] * 2 or cloud.origin.tolist() == [1, 2, 3]
    assert (cloud.normals is None) == (normal is None)
    if cloud.normals is not None:
        assert cloud.normals.tolist() == [normal] * 2
    assert (cloud.colours is None) == (color is None)
    if cloud.colours is not None:
        assert cloud.colours.tolist() == [color] * 2


def test_a_count_line_announces_the_points(make_file: Make) -> None:
    cloud = read_points(make_file("a.pts", "2\n1 2 3 -7 10 20 30\n4 5 6 8 40 50 60\n"))
    assert cloud.positions.tolist() == [[1, 2, 3], [4, 5, 6]]
    np.testing.assert_array_equal(cloud.colours, [[10, 20, 30], [40, 50, 60]])


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("1 2 3\n4 5\n", ":2: 2 columns where 3"),
        ("1 2 3\n\n# c\n4 oops 6\n", ":4: 'oops' is not a number"),
        ("1 2 3\n4,5,6\n", ":2: '4,5,6' is not a number"),
        ("1,2,3\n1,2,\n4,5\n", ":3: 2 columns where 3"),
        ("2\n\n1 2 3\n1\n4 5\n", ":5: 2 columns where 3"),
    ],
)
def test_what_does_not_fit_is_named(make_file: Make, content: str, said: str) -> None:
    path = make_file("bad.xyz", content)
    with pytest.raises(InputError, match=said) as refusal:
        read_points(path)
    assert str(path) in str(refusal.value)


def test_binary_junk_is_refused(make_file: Make) -> None:
    with pytest.raises(InputError):
        read_points(make_file("junk.xyz", bytes(range(256)) * 40))


@pytest.mark.parametrize(
    ("count", "warnings"),
    [
        ("2\n", []),
        ("1\n", ["line 1 announces 1 points, 2 follow, and are read"]),
        ("", []),
    ],
)
def test_counts_are_compared_with_the_rows(
    make_file: Make, count: str, warnings: list[str]
) -> None:
    source = open_points(make_file("a.pts", count + "1 2 3\n4 5 6\n"))
    assert [len(part) for part in source.chunks(5)] == [2]
    assert source.findings.warnings == warnings
    assert (source.count or 0) < 10


@pytest.mark.parametrize("rows", [1, 2, 100])
def test_scans_one_behind_the_other(make_file: Make, rows: int) -> None:
    source = open_points(make_file("a.pts", "2\n1 2 3\n4 5 6\n1\n7 8 9\n\n0\n1\n1 1 1\n"))
    parts = list(source.chunks(rows))
    positions = np.concatenate([part.positions for part in parts])
    assert positions.tolist() == [[1, 2, 3], [4, 5, 6], [7, 8, 9], [1, 1, 1]]
    numbers = np.concatenate([part.attributes["scan"] for part in parts])
    assert numbers.tolist() == [0, 0, 1, 3]
    assert numbers.dtype == np.int32
    assert [scan.points for scan in source.scans] == [2, 1, 0, 1]
    assert not source.findings.warnings


@pytest.mark.parametrize("count", ["3", "4000000000"])
@pytest.mark.parametrize(("before", "line"), [("", 1), ("1\n1 2 3\n", 3)])
def test_a_scan_that_is_cut_is_refused(make_file: Make, before: str, line: int, count: str) -> None:
    path = make_file("a.pts", f"{before}{count}\n1 2 3\n4 5 6\n")
    problem = rf"a\.pts:{line}: truncated: {count} points are announced, 2 follow"
    with pytest.raises(InputError, match=problem):
        list(open_points(path).chunks(5))


def test_columns_go_by_their_names(make_file: Make) -> None:
    text = '"id","B","G","R","Normal_X","Normal_Y","Normal_Z","north","east","h","Height"\n'
    source = open_points(make_file("a.csv", text + "P1,3,2,1,0,0,1,20,10,5,30\n" * 3))
    (part,) = source.chunks(10)
    assert part.positions.tolist() == [[10, 20, 30]] * 3
    np.testing.assert_array_equal(part.normals, [[0, 0, 1]] * 3)
    np.testing.assert_array_equal(part.colours, [[1, 2, 3]] * 3)
    assert {name: column.tolist() for name, column in part.attributes.items()} == {"h": [5] * 3}
    assert source.columns[:2] == ("id", "B")
    assert source.format == "text, separated by commas"
    assert not source.findings.warnings  # names of points are no measurement


@pytest.mark.parametrize(
    ("names", "unit"),
    [
        ("x y z", None),
        ("lon lat height", "degree"),
        ("lon;lat;x;y;z", None),
        ("X [mm];Y [mm];Z [mm]", "mm"),
        ("X(m),Y(m),Z(m)", "m"),
    ],
)
def test_names_tell_the_unit(make_file: Make, names: str, unit: str | None) -> None:
    separator = next((mark for mark in ";," if mark in names), " ")
    rows = separator.join("1" * len(names.split(separator)))
    assert open_points(make_file("a.txt", f"{names}\n{rows}\n")).unit == unit


def test_full_precision_over_blocks(make_file: Make) -> None:
    values = np.random.default_rng(2).normal(size=(40_000, 3)) + np.array([4e5, 5e6, 100])
    path = make_file("a.csv", "".join("{!r},{!r},{!r}\n".format(*row) for row in values.tolist()))
    parts = list(open_points(path).chunks(7_000))
    assert [len(part) for part in parts] == [7_000] * 5 + [5_000]
    assert (np.concatenate([part.positions for part in parts]) == values).all()


def test_what_comes_late_in_a_large_file_counts(make_file: Make) -> None:
    """Whole numbers at the start alone are no colours."""
    rows = "1.25 2.25 3.25 1 0 2\n" * 40_000 + "1.25 2.25 3.25 -0.5 0.25 0.125\n" * 40_000
    (part,) = open_points(make_file("a.xyz", rows)).chunks(100_000)
    assert part.colours is None
    assert part.normals is None
    assert list(part.attributes) == ["intensity", "column_5", "column_6"]


WORDS = [
    "1",
    "-2.5",
    "1e3",
    "nan",
    "x",
    "y",
    "z",
    "nx",
    "red",
    '"',
    ",",
    ";",
    "\t",
    " ",
    "\n",
    "\r",
]
WORDS += ["#", "//", "1,5", "255", "0.5", "\0", "\ufeff", "\u2028", "P1", "1.#IND", "1_0", "9" * 30]


@given(st.lists(st.sampled_from(WORDS), max_size=80), st.sampled_from([".xyz", ".pts", ".xyzn"]))
@settings(max_examples=300, deadline=None)
def test_any_text_gives_points_or_an_error(
    tmp_path_factory: pytest.TempPathFactory, words: list[str], suffix: str
) -> None:
    _assert_points_or_error(tmp_path_factory, "".join(words).encode(), suffix)


@given(st.binary(max_size=300), st.sampled_from(["", "1 2 3\n4 5 6\n", "\ufeff", "x,y,z\n1,2,3\n"]))
@settings(max_examples=200, deadline=None)
def test_any_bytes_give_points_or_an_error(
    tmp_path_factory: pytest.TempPathFactory, content: bytes, start: str
) -> None:
    _assert_points_or_error(tmp_path_factory, start.encode() + content, ".txt")


def _assert_points_or_error(
    tmp_path_factory: pytest.TempPathFactory, content: bytes, suffix: str
) -> None:
    path = tmp_path_factory.mktemp("any") / f"a{suffix}"
    path.write_bytes(content)
    said, parts = "", []
    try:
        parts = list(open_points(path).chunks(3))
    except InputError as error:
        said = str(error)
    assert ("\n" not in said and str(path) in said) if said else sum(map(len, parts)) > 0
    assert all(part.positions.shape == (len(part), 3) for part in parts)
    assert len({tuple(part.attributes) for part in parts}) <= 1


def test_a_large_file_keeps_all_its_named_columns(make_file: Make) -> None:
    """Its lines are so long that any of them is looked at, that of the names as well."""
    extra = [f"c{number}" for number in range(200)]
    rows = np.random.default_rng(1).random((1200, 203))
    lines = [",".join(["x", "y", "z", *extra]), *(",".join(map(str, row)) for row in rows.tolist())]
    path = make_file("wide.csv", "\n".join(lines))
    assert path.stat().st_size > 1 << 20
    source = open_points(path)
    part = next(source.chunks(1))
    assert list(part.attributes) == extra
    assert source.findings.warnings == []


def test_many_columns_without_names_are_told_in_one_line(make_file: Make) -> None:
    rows = np.random.default_rng(1).normal(size=(50, 40)) * 9
    path = make_file("wide.xyz", "\n".join(" ".join(map(str, row)) for row in rows.tolist()))
    (warning,) = [w for w in open_points(path).findings.warnings if "without a name" in w]
    assert warning.startswith("without a name, and kept as attributes: ")
    assert warning.endswith(" and so on")


@pytest.mark.parametrize(
    ("names", "order", "down"),
    [
        ("lon,lat,alt", (0, 1, 2), False),
        ("Rechtswert;Hochwert;Höhe", (0, 1, 2), False),
        ("Hochwert;Rechtswert;Hoehe", (1, 0, 2), False),
        ("X,Y,Depth (m)", (0, 1, 2), True),
        ("Northing,Easting,Depth", (1, 0, 2), True),
        ("Tiefe;x;y", (1, 2, 0), True),
    ],
)
def test_words_of_surveyors_are_coordinates(
    tmp_path: Path, names: str, order: tuple[int, int, int], down: bool
) -> None:
    mark = ";" if ";" in names else ","
    rows = np.array([1.0, 2.0, 3.0]) + np.random.default_rng(0).random((40, 3))
    lines = [mark.join(f"{number:.6f}" for number in row) for row in rows]
    (tmp_path / "points.csv").write_text("\n".join([names, *lines]), encoding="utf-8")
    source = open_points(tmp_path / "points.csv")
    (part,) = source.chunks(100)
    true = rows[:, order] * (1.0, 1.0, -1.0 if down else 1.0)
    assert np.abs(part.positions - true).max() < 1e-6
    assert ("z is a depth, which counts down: heights are its negative" in
            source.findings.warnings) == down  # fmt: skip


def test_depths_that_are_negative_are_heights(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text("x,y,depth\n1,2,-3\n2,3,-4\n4,4,-2\n")
    source = open_points(tmp_path / "points.csv")
    assert next(source.chunks(9)).positions[:, 2].tolist() == [-3.0, -4.0, -2.0]
    assert not source.findings.warnings


def test_a_depth_beside_z_is_an_attribute(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text("x,y,z,depth\n1,2,3,4\n2,3,4,5\n4,4,5,6\n")
    (part,) = open_points(tmp_path / "points.csv").chunks(9)
    assert part.positions[:, 2].tolist() == [3.0, 4.0, 5.0]
    assert part.attributes["depth"].tolist() == [4.0, 5.0, 6.0]
