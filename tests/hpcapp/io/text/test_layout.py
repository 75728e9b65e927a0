from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hpcapp.io.points.column_roles import AXES
from hpcapp.io.points.point_source import Findings
from hpcapp.io.text.columns import assign_by_name
from hpcapp.io.text.layout import TextLayout, find_layout
from hpccomponent.errors import InputError

Make = Callable[..., Path]
ROWS = "1.5 2 3 4\n5 6 7 8\n"


def _find(path: Path) -> tuple[TextLayout, list[str]]:
    findings = Findings()
    layout, sample = find_layout(path, findings)
    assert sample.shape[1] == len(layout.rows.wanted)
    return layout, findings.warnings


@pytest.mark.parametrize(
    "head",
    [
        "x y z a\n",
        "X,Y,Z,a\n",
        '"X";"Y";"Z";"a"\n',
        "x\ty\tz\ta\t\n",
        "//X Y Z a\n",
        "# x, y, z, a\n# more\n\n",
        "#\n2\nx y z a\n",
        "//X Y Z a\n2\n",
        "\ufeffx y z a\n",
    ],
)
def test_lines_of_names(make_file: Make, head: str) -> None:
    layout, warnings = _find(make_file("a.txt", head + ROWS))
    assert layout.names is not None
    assert [name.lower() for name in layout.names] == ["x", "y", "z", "a"]
    assert layout.first_row == head.count("\n") + 1
    assert warnings == []


@pytest.mark.parametrize(
    ("head", "axes"),
    [
        ("P,N,E,Z", "yxz"),
        ("# p, e, n, z", "xyz"),
        ("Point,Northing,Easting,Elevation", "yxz"),
        ("PNEZ", "yxz"),
        ("Pt;N [m];E [m];Elev", "yxz"),
        ("N\tE\tH\tD", "yxz"),
        ("E N Z Lat", "xyz"),
        ("X,Y,Z,N", "xyz"),
    ],
)
def test_letters_of_surveyors_name_columns(make_file: Make, head: str, axes: str) -> None:
    layout, warnings = _find(make_file("a.csv", f"{head}\n{ROWS}"))
    columns = assign_by_name(list(layout.names or ()), np.zeros((1, 4)))
    assert "".join(role for role in columns.roles if role in AXES) == axes
    assert warnings == []


@pytest.mark.parametrize("head", ["", "# x y z\n", "// made by me\n", "% x, y\n", "2\n"])
def test_files_without_names(make_file: Make, head: str) -> None:
    layout, warnings = _find(make_file("a.txt", head + ROWS))
    assert layout.names is None
    assert layout.rows.columns == 4
    assert warnings == []


@pytest.mark.parametrize(
    ("rows", "separator", "comma", "columns"),
    [
        ("1 2 3\n", None, ",", 3),
        ("1\t2\t3\t\n", None, ",", 3),
        ("1,2,3\n", ",", ",", 3),
        ("1 , 2,3 ,4\n", ",", ",", 4),
        ("1;2;3\n", ";", ",", 3),
        ("1,5;2;3\n", ";", ".", 3),
        ("1,5\t2,5\t3,5\n", None, ".", 3),
        ("1.5 2.5 3.5,7,8,9\n", None, " ", 6),
        ("1 2 3\n1 2 3\n1,2,3\n", None, ",", 3),
    ],
)
def test_separators(
    make_file: Make, rows: str, separator: str | None, comma: str, columns: int
) -> None:
    found = _find(make_file("a.txt", rows))[0].rows
    assert (found.separator, found.comma, found.columns) == (separator, comma, columns)


def test_most_rows_decide_how_many_columns_there_are(make_file: Make) -> None:
    layout, _ = _find(make_file("a.csv", "x,y,z\n\n1,2,3,4\n1,2,3\n1,2,3\n"))
    assert layout.rows.columns == 3
    assert layout.rows.takes_surplus


def test_columns_that_hold_no_numbers_are_passed_over(make_file: Make) -> None:
    named, warnings = _find(make_file("a.csv", "n,x,y,z,m,k\nP1,1,2,3,,a\nP2,1,2,3,,7\n"))
    assert named.rows.wanted == (1, 2, 3)
    assert warnings == ["left out, as not all of a column is numbers: k"]
    unnamed, warnings = _find(make_file("b.csv", "P1,1,2,3,\nP2,1,2,3,\n"))
    assert unnamed.rows.wanted == (1, 2, 3)
    assert warnings == ["column 1 holds no numbers, and is passed over"]


@pytest.mark.parametrize("start", [0, 1])
def test_a_column_that_counts_the_points_is_passed_over(make_file: Make, start: int) -> None:
    text = "".join(f"{i + start} {i * 0.3} {i % 7 + 0.5} 0.25\n" for i in range(30))
    layout, warnings = _find(make_file("a.xyz", text))
    assert layout.rows.wanted == (1, 2, 3)
    assert warnings == ["column 1 counts the points, and is passed over"]
    named, warnings = _find(make_file("b.xyz", "x y z i\n" + text))
    assert named.rows.wanted == (0, 1, 2, 3)
    assert warnings == []
    layout, warnings = _find(make_file("c.xyz", text.replace(" 0.25", " 2")))
    assert layout.rows.wanted == (0, 1, 2, 3)


def test_fewer_names_than_columns(make_file: Make) -> None:
    layout, warnings = _find(make_file("a.csv", "x,y,z\n1,2,3,4,5\n"))
    assert layout.names == ("x", "y", "z", "", "")
    assert layout.rows.wanted == (0, 1, 2)
    assert warnings == ["3 names for 5 columns: those after 'z' are passed over"]
    _, warnings = _find(make_file("b.csv", "x,y,z\n1,2,3,\n"))
    assert warnings == []


def test_counts_begin_scans(make_file: Make) -> None:
    layout, _ = _find(make_file("a.pts", "2\n1 2 3\n4 5 6\n1\n\n7 8 9\n 3 \n1 1 1"))
    assert layout.counts == ((1, 2), (4, 1), (7, 3))
    layout, _ = _find(make_file("a.xyz", "1 2 3\n4 5 6\n"))
    assert layout.counts == ()


def test_a_line_of_words_after_the_count_is_passed_over(make_file: Make) -> None:
    layout, warnings = _find(make_file("a.xyz", "2\nmade by me\n" + ROWS))
    assert layout.first_row == 3
    assert warnings == ["line 2 is no row of numbers, and is passed over"]


def test_the_sample_spans_the_file(make_file: Make) -> None:
    lines = [f"{i} {i + 0.5} {-i}" for i in range(150_000)]
    _, sample = find_layout(make_file("a.xyz", "\n".join(lines)), Findings())
    assert len(sample) > 4096
    assert sample[:, 0].min() == 0
    assert sample[:, 0].max() > 149_000
    assert (sample[:, 2] == -sample[:, 0]).all()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", ": no points: the file has no line of numbers"),
        ("# only\n\n; comments\n", ": no points"),
        ("x,y,z\n", ": no points"),
        ("X,Y,X\n1,2,3\n", ":1: no column is named Z: X, Y, X"),
        ("# a\nfoo bar\n1 2 3\n", ":2: no column is named X, Y, Z"),
        ("scan 1 of mine\n1 2 3\n", ":1: neither numbers nor names of columns: 'scan 1 of mine'"),
        ("x y z\nx y z\n1 2 3\n", ":2: neither numbers nor names"),
        ("ncols 3\nnrows 2\n1 2 3\n", ":1: neither numbers nor names of columns: 'ncols 3'"),
        ("1 2\n3 4\n", ":1: 2 columns of numbers, x, y and z are 3"),
        ("x,y,z,nx\n1,2,3\n", ":1: 4 names for 3 columns"),
        ("1,5 2,5 3,5\n", ":1: is the comma a decimal comma, .*use a decimal point"),
        ('"1,5","2,5","3,5"\n', ":1: decimal commas within quotes"),
        ("5\n1\n1\n1\n", ": no points"),
        ("1\n1 2 3\n" + "1\n" * 20_000, ": more than 10000 lines announce points"),
        ("9" * 5000, ":1: 1 columns of numbers"),
        ("a" * 200_000 + ",y,z\n1,2,3\n", ":1: no column is named X, Y, Z"),
    ],
)
def test_what_is_no_layout_is_named(make_file: Make, content: str, said: str) -> None:
    path = make_file("bad.csv", content)
    with pytest.raises(InputError, match=said) as refusal:
        find_layout(path, Findings())
    assert str(refusal.value).startswith(str(path))
