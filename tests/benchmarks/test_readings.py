"""What is said of how sure a reading is holds, and hangs on no number by a hair.

On what `benchmarks/readings.py` has measured of random worlds whose true sides are known.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from readings import RIGHT, Table, follow_world
from shared_data import shared
from worlds import SEED, make_worlds

from hpcapp.applications.surface.normals.evidence.likelihood import FITTED, ReadingFeatures
from hpcapp.geometry.points import FloatArray

RESULTS = Path(__file__).parents[2] / "benchmarks/results"
PAGE = Path(__file__).parents[2] / "docs/explanation/normals.md"
RECORD = json.loads((RESULTS / "readings.json").read_text(encoding="utf-8"))
ROWS = [
    json.loads(line)
    for line in (RESULTS / "readings-worlds.jsonl").read_text(encoding="utf-8").splitlines()
]
WORLDS, NUMBERS = Table.of(ROWS), np.array([*asdict(FITTED).values()])
ALIKE = 0.9  # share of the area on which two readings agree that say the same


def test_the_numbers_are_those_of_the_fit() -> None:
    notes = dict(note.split(": ") for note in RECORD["notes"])
    assert {name: float(notes[name]) for name in asdict(FITTED)} == asdict(FITTED)


def test_the_fit_weighs_readings_as_a_job_does() -> None:
    shares = WORLDS.shares(NUMBERS)
    for row, found in zip(ROWS, shares, strict=True):
        features = [
            ReadingFeatures(kind, cost, evenness, np.array(facing))
            for kind, cost, evenness, *facing, _ in row[2]
        ]
        expected = FITTED.find_shares(features, row[1])
        assert found[: len(features)] == pytest.approx(expected, abs=1e-9)


def test_what_is_said_is_right_as_often_as_it_says() -> None:
    """Of worlds that had no say in the fit, where it says nine times of ten or more."""
    for low, _, worlds, right in RECORD["rows"]:
        assert low < 0.9 or right >= (low - 0.02) * worlds - 1.0


def test_the_page_tells_how_often_it_is_right() -> None:
    told = " | ".join(f"{right} of {worlds}" for _, _, worlds, right in RECORD["rows"])
    assert f"| {told} |" in PAGE.read_text(encoding="utf-8")


def scale(name: str, factor: float) -> FloatArray:
    return np.array([*(asdict(FITTED) | {name: factor * asdict(FITTED)[name]}).values()])


def change(numbers: FloatArray) -> tuple[float, float]:
    """Return which share of the worlds gets other sides, and how much surer or less sure it is."""
    (sure, _, before), (other, _, after) = WORLDS.decide(NUMBERS), WORLDS.decide(numbers)
    is_other = WORLDS.agree[np.arange(len(before)), before, after] < ALIKE
    return float(is_other.mean()), float(np.abs(other - sure).mean())


@pytest.mark.parametrize("name", asdict(FITTED))
def test_a_tenth_of_a_number_changes_few_decisions(name: str) -> None:
    (less, changed), (more, also) = (change(scale(name, factor)) for factor in (0.9, 1.1))
    assert max(less, more) <= 0.02
    assert change(scale(name, 0.0))[1] > max(changed, also)


@pytest.mark.parametrize("name", ["power", "amid", "side", "facing"])
def test_sides_hang_on_the_numbers(name: str) -> None:
    assert change(scale(name, 0.0))[0] > 0.01


@pytest.mark.slow
def test_a_ball_of_a_world_has_one_reading_that_is_right(tmp_path: Path) -> None:
    pytest.importorskip("embreex", reason="there are no wheels of embreex for this machine")
    data, *_ = (shared(name).parent for name in ("worlds", "raw", "tuning"))
    ((name, entry),) = make_worlds(data, tmp_path, "whole_object", SEED, 1).items()
    row = follow_world(data, tmp_path, name, entry)
    assert row is not None
    table = Table.of([row])
    _, (is_right,), _ = table.decide(NUMBERS)
    assert is_right
    assert (table.right > RIGHT).any()
    assert np.diag(table.agree[0]) == pytest.approx(1.0)
