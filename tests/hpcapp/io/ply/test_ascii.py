from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from hpcapp.io.formats import open_points, read_mesh, read_points
from hpcapp.io.ply.points import open_ply
from hpcapp.io.points.point_source import read_whole
from hpccomponent.errors import InputError

Make = Callable[..., Path]
XYZ = "property float x\nproperty float y\nproperty float z\n"
FACES = "property list uchar int vertex_indices\n"


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
def test_legal_oddities_simply_work(make_ply: Make, newline: str) -> None:
    elements = (
        "comment made by hand\nobj_info 3 cols\nelement material 1\nproperty float shine\n"
        "property list uchar int ids\nelement vertex 2\nproperty uchar flags\n" + XYZ
    )
    body = "0.5 2 8 9\n\n7 1 2 3\n  7\t4 5e0 -6.25  \n".replace("\n", newline)
    cloud = read_points(make_ply("ascii", elements, body, newline))
    assert cloud.positions.tolist() == [[1, 2, 3], [4, 5, -6.25]]


@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60, deadline=None
)
@given(hnp.arrays(np.float64, st.tuples(st.integers(1, 20), st.just(3)), elements=st.floats(-5, 5)))
def test_decimal_numbers_come_back_exactly(make_ply: Make, points: np.ndarray) -> None:
    points = np.vstack([points, [[5.0, 5.0, 5.0], [-5.0, -5.0, -5.0]]])  # wide: no origin
    body = "\n".join(" ".join(map(repr, row)) for row in points.tolist())
    path = make_ply("ascii", f"element vertex {len(points)}\n{XYZ}", body)
    assert (read_whole(open_ply(path)).positions == points).all()


def test_nan_and_infinity_are_read(make_ply: Make) -> None:
    cloud = read_points(make_ply("ascii", f"element vertex 2\n{XYZ}", "nan 0 inf\n-inf 1 NaN\n"))
    assert np.isfinite(cloud.positions).sum() == 2


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("1 2 3\n4 5\n7 8 9\n", r":9: 2 columns where 3"),
        ("1 2 3\n4 5 6\n7 8", r":10: 2 columns where 3"),
        ("1 2 3\n4 5 6\n", "truncated: 3 rows of element 'vertex' are announced.* after 2"),
        ("", "truncated: 3 rows"),
        ("1 2 3\n4 five 6\n7 8 9\n", ":9: 'five' is not a number"),
        ("1,5 2,5 3,5\n4 5 6\n7 8 9\n", ":8: '1,5' is not a number; use a decimal point"),
        ("1 2 3\n\n4 5 6\n7 8 9\n1 1\n", ":12: lines follow after the last element"),
    ],
)
def test_bad_lines_are_named(make_ply: Make, body: str, said: str) -> None:
    path = make_ply("ascii", f"element vertex 3\n{XYZ}", body)
    with pytest.raises(InputError, match=said):
        read_points(path)


def test_more_rows_than_announced_are_left_out_with_a_word(make_ply: Make) -> None:
    source = open_points(make_ply("ascii", f"element vertex 2\n{XYZ}", "1 2 3\n4 5 6\n" * 3))
    assert [len(part) for part in source.chunks(10)] == [2]
    assert "6 rows of element 'vertex', of which the header announces 2" in str(source.findings)


def test_a_bad_line_far_down_is_named(make_ply: Make) -> None:
    rows = ["1 2 3"] * 20_000
    rows[17_000] = "1 2 x3"
    path = make_ply("ascii", f"element vertex 20000\n{XYZ}", "\n".join(rows))
    with pytest.raises(InputError, match=":17008: 'x3' is not a number"):
        read_points(path)


def test_a_vertex_count_too_small_before_faces(make_ply: Make) -> None:
    elements = f"element vertex 2\n{XYZ}element face 1\n{FACES}"
    path = make_ply("ascii", elements, "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    with pytest.raises(InputError, match="lines follow after the last element"):
        read_points(path)


def test_a_count_of_four_billion(make_ply: Make) -> None:
    path = make_ply("ascii", f"element vertex 4000000000\n{XYZ}", "1 2 3\n" * 9)
    with pytest.raises(InputError, match="the file ends after 9"):
        read_points(path)


@pytest.mark.parametrize("color", ["256", "-1", "1.5", "nan"])
def test_a_value_beyond_its_announced_type(make_ply: Make, color: str) -> None:
    elements = f"element vertex 1\n{XYZ}property uchar red\n"
    path = make_ply("ascii", elements, f"1 2 3 {color}\n")
    with pytest.raises(InputError, match=f"of red is {color}, not of the type uint8"):
        read_points(path)


@pytest.mark.parametrize("row", ["3 0 1", "3 0 1 2 3", "2.5 0 1 2", "-1 0", "3 a b c", "inf 0 1 2"])
def test_bad_faces_are_named(make_ply: Make, row: str) -> None:
    elements = f"element vertex 3\n{XYZ}element face 2\n{FACES}"
    path = make_ply("ascii", elements, f"0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n{row}\n")
    with pytest.raises(InputError, match=":14: not a row of element 'face'"):
        read_mesh(path)
