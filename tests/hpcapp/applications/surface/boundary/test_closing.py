"""Open or closed is one probability, of the reading and the share that no point supports."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.boundary import closing
from hpcapp.applications.surface.boundary.closing import SURE, say_closing, weigh_open
from hpcapp.applications.surface.types.reading import Reading

# What scans of each kind have in the middle: the share without points, and the reading.
SCANS = {
    "object": (0.02, Reading("outside", missing=(0.0, 0.0, -0.03)), False),
    "object, patchy": (0.07, Reading("outside", missing=(0.1, 0.0, 0.0)), False),
    "on a table": (0.17, Reading("+y", missing=(0.0, -0.32, 0.0), drawn=0.59), False),
    "terrain": (0.66, Reading("above", missing=(0.0, 0.0, -0.9)), True),
    "terrain, low": (0.35, Reading("above", missing=(0.0, 0.0, -0.95)), True),
    "facade": (0.79, Reading("-y+z", missing=(0.0, 0.6, -0.3), drawn=-0.3), True),
    "room": (0.13, Reading("inside", 1.0, missing=(0.0, 0.0, 0.05)), True),
    "tunnel": (0.3, Reading("amid", 1.0, missing=(0.0, 0.0, 0.15), drawn=-0.5), True),
}


@pytest.mark.parametrize("name", SCANS)
def test_each_kind_of_scan_is_decided_surely_and_with_a_tenth_to_spare(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    share, reading, is_open = SCANS[name]
    assert (weigh_open(reading, share) if is_open else 1.0 - weigh_open(reading, share)) > SURE
    fitted = np.array(closing.COEFFICIENTS)
    for factors in (*(1.0 + 0.1 * np.eye(len(fitted))), *(1.0 - 0.1 * np.eye(len(fitted)))):
        monkeypatch.setattr(closing, "COEFFICIENTS", tuple(factors * fitted))
        assert (weigh_open(reading, share) > 0.5) == is_open


@pytest.mark.parametrize(
    ("share", "reading"),
    [
        (0.45, Reading("-x+y", missing=(0.4, -0.4, 0.0), drawn=0.5)),  # half an object
        (0.32, Reading("outside", missing=(0.0, 0.0, 0.2), drawn=0.3)),  # twigs, seen from below
    ],
)
def test_what_is_seen_in_part_is_unsure(share: float, reading: Reading) -> None:
    assert 1.0 - SURE < weigh_open(reading, share) < SURE


def test_more_that_is_missing_opens_and_drawing_together_closes() -> None:
    missing = [weigh_open(Reading(missing=(0.0, 0.0, one)), 0.3) for one in (0.0, 0.3, 0.6)]
    drawn = [
        weigh_open(Reading(missing=(0.0, 0.0, 0.5), drawn=one), 0.3) for one in (0.0, 0.5, 1.0)
    ]
    assert missing == sorted(missing)
    assert drawn == sorted(drawn, reverse=True)


def test_the_reason_names_where_it_was_seen_from() -> None:
    assert say_closing(Reading("above"), 0.5, is_open=True).startswith("open: seen from above;")
    assert "75 %" in say_closing(Reading("above"), 0.25, is_open=False)
