"""The path of a sensor is read by names or by the number of columns, and thinned."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hpcapp.geometry.paths import MOST_PLACES
from hpcapp.io.text.trajectory import read_trajectory
from hpccomponent.errors import InputError


@pytest.mark.parametrize(
    "text",
    [
        "1 2 3\n4 5 6\n",
        "0.5 1 2 3\n0.6 4 5 6\n",
        "0.5,1,2,3\n0.6,4,5,6\n",
        "# timestamp tx ty tz qx qy qz qw\n0.5 1 2 3 0 0 0 1\n0.6 4 5 6 0 0 0 1\n",
        "time,x,y,z\n0.5,1,2,3\n0.6,4,5,6\n",
        "Easting;Northing;Height;Roll\n1;2;3;9\n4;5;6;9\n",
        "X,Y,Z\n1,2,3\n,,\n4,5,6",
        "1 0 0 1 0 1 0 2 0 0 1 3\n0 -1 0 4 1 0 0 5 0 0 1 6\n",
        "0.5 1 2 3 1 0 0 0 0 0 0 0\n0.6 4 5 6 1 0 0 0 0 0 0 0\n",
    ],
)
def test_columns_are_told_by_names_or_by_their_number(tmp_path: Path, text: str) -> None:
    path = tmp_path / "path.txt"
    path.write_text(text)
    read = read_trajectory(path)
    assert read[:, :3].tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert read[:, 3:].tolist() == ([[0.5], [0.6]] if "0.5" in text else [[], []])


def test_places_are_even_along_the_path(tmp_path: Path) -> None:
    flown = 10.0 * np.sqrt(np.arange(20_001))  # it slows down
    path = tmp_path / "path.csv"
    np.savetxt(path, np.stack([flown, 0 * flown, 0 * flown + 900.0], axis=1), delimiter=",")
    places = read_trajectory(path)
    assert len(places) == MOST_PLACES  # their times are not known
    steps = np.diff(places[:, 0])
    assert steps.max() - steps.min() < 0.2 * steps.max()
    assert places[[0, -1], 0] == pytest.approx(flown[[0, -1]])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "no line of numbers"),
        ("hello there\n", "no line of numbers"),
        ("1 2\n3 4\n", "2 columns"),
        ("time,lat\n1,2\n3,4\n", "no column is named X"),
        ("a,b,c\n1,2,3\n", "no column is named X"),
        ("1 2 3\nhere it ends\n", ":2"),
        ("0.5 1 2 3\n0.6 9223372036854775808 2 3\n", r"row 2 .* \[9\.2233\d*e\+18, 2"),
        ("1 2 3\n\n4 5 nan\n-1e300 2 3\n", r"row 3 .* \[-1e\+300, 2"),
    ],
)
def test_what_is_no_trajectory_is_refused_in_a_line(
    tmp_path: Path, text: str, problem: str
) -> None:
    path = tmp_path / "path.csv"
    path.write_text(text)
    with pytest.raises(InputError, match=problem) as caught:
        read_trajectory(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
