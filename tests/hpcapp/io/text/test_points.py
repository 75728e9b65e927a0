from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hpcapp.io.formats import read_points
from hpcapp.io.text.writer import write_text_points
from hpccomponent.errors import InputError
from hpccomponent.surface.types.points import PointCloud

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
        ("", "no line of numbers"),
        ("# only\n\n; comments\n", "no line of numbers"),
        ("x y z\n1 2 3\n", ":1: 'x' is not a number"),
        ("1 2 3\n4 5\n", ":2: 2 columns where 3"),
        ("1 2 3\n\n# c\n4 oops 6\n", ":4: 'oops' is not a number"),
        ("1,5;2,5;3,5\n", ":1: '1,5' is not a number; use a decimal point"),
        ("1,5 2,5 3,5\n", ":1: '5 2' is not a number; use a decimal point"),
        ("1 2 3\n4,5,6\n", ":2: '4,5,6' is not a number; use a decimal point"),
        ("1,2,\n", ":1: '' is not a number"),
        ("1 2\n3 4\n", ":1: 2 columns, none of 3, 4, 6, 7, 9"),
        ("1 2 3 4 5\n", ":1: 5 columns"),
        ("3\n1 2 3\n4 5 6\n", "truncated: 3 points are announced, the file ends after 2"),
        ("4000000000\n1 2 3\n", "the file ends after 1"),
        ("1\n1 2 3\n4 5 6\n", ":3: lines follow after the 1 points that line 1 announces"),
        ("0\n", "the file announces none"),
        ("1 2 3 0 300 0 0\n", "point 0 has the colour"),
        ("9" * 5000, "1 columns"),
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


@pytest.mark.parametrize("with_normals", [True, False])
@pytest.mark.parametrize("with_colors", [True, False])
def test_what_is_written_comes_back(
    tmp_path: Path, cloud: PointCloud, with_normals: bool, with_colors: bool
) -> None:
    some = PointCloud(
        cloud.positions / 3,
        cloud.normals if with_normals else None,
        cloud.colours if with_colors else None,
    )
    write_text_points(tmp_path / "a.xyz", some)
    again = read_points(tmp_path / "a.xyz")
    assert (again.positions == some.positions).all()
    np.testing.assert_array_equal(again.normals, some.normals)
    np.testing.assert_array_equal(again.colours, some.colours)


def test_georeferenced_millimetres_survive(tmp_path: Path) -> None:
    utm = np.random.default_rng(3).uniform(0, 50, (100, 3)).round(3) + 5.4e6
    write_text_points(tmp_path / "a.xyz", PointCloud(utm - 5.4e6, origin=np.full(3, 5.4e6)))
    cloud = read_points(tmp_path / "a.xyz")
    assert np.abs(cloud.positions).max() < 50
    assert np.abs(cloud.positions + cloud.origin - utm).max() < 1e-6
