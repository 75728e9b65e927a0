"""``--viewpoint`` takes a direction, places, and files of trajectories."""

from __future__ import annotations

from pathlib import Path

import pytest

from hpcapp.applications.surface.job.load import told_sensor
from hpcapp.applications.surface.viewpoint import (
    Viewpoint,
    parse_viewpoint,
    type_viewpoint,
)
from hpccomponent.errors import UsageError


@pytest.mark.parametrize(
    ("words", "viewpoint"),
    [
        ([], ()),
        (["above"], "above"),
        (["inside", "inside"], "inside"),
        (["1,-2,3e5"], ((1.0, -2.0, 3e5),)),
        (["1,2,3", "4,5,6"], ((1.0, 2.0, 3.0), (4.0, 5.0, 6.0))),
    ],
)
def test_words_are_parsed_and_typed_again(words: list[str], viewpoint: Viewpoint) -> None:
    assert parse_viewpoint(words) == viewpoint
    assert parse_viewpoint(type_viewpoint(viewpoint)[1::2]) == viewpoint


def test_places_and_trajectories_stand_together(tmp_path: Path) -> None:
    path = tmp_path / "path.txt"
    path.write_text("1 2 3\n")
    assert parse_viewpoint(["0,0,9", str(path)]) == ((0.0, 0.0, 9.0), (1.0, 2.0, 3.0))


@pytest.mark.parametrize(
    "words",
    [["1,2"], ["1,2,nan"], ["1e300,0,0"], ["1,9999999999999999999,2"], ["up"], ["no.csv"], [""]],
)
def test_other_words_are_refused(words: list[str]) -> None:
    with pytest.raises(UsageError, match=r"neither above, below, inside, outside, nor"):
        parse_viewpoint(words)


def test_a_direction_stands_alone() -> None:
    with pytest.raises(UsageError, match="viewpoints='above' stands beside"):
        parse_viewpoint(["1,2,3", "above"])


def test_what_the_user_says_is_told() -> None:
    assert told_sensor("below").kind == "below"
    assert told_sensor("below").is_told
    places = told_sensor(((1.0, 2.0, 3.0),)).places
    assert places is not None
    assert places.tolist() == [[1.0, 2.0, 3.0]]
    assert not told_sensor(()).is_told
