"""The numbers that decide over sides and warnings lie between what they part, with a margin.

On what `benchmarks/decisions.py` has measured: moved by a tenth, they decide the same; halved or
doubled, something else.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from hpcapp.applications.surface.normals.consistency import TORN, Torn
from hpcapp.applications.surface.normals.orientation import SURE
from hpcapp.applications.surface.normals.readings import CERTAIN, HABIT, RARE, choose

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"
READINGS = ("outside", "inside", "side", "turned")


def _read(name: str) -> list[dict[str, Any]]:
    table = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
    return [dict(zip(table["columns"], row, strict=True)) for row in table["rows"]]


SIDES, NORMALS = _read("decisions-sides"), _read("decisions-normals")
HANDLES = _read("decisions-handles")


def _weigh(scan: dict[str, Any], rare: float, habit: float) -> tuple[bool, float]:
    """Return whether a scan is read rightly, and by which margin over what turns it round."""
    names = [name for name in READINGS if scan[name] != ""]
    costs = [scan[name] + (rare if name == "inside" else scan["stand"]) for name in names]
    habits = {"side": habit * scan["habit"], "turned": habit * (1.0 - scan["habit"])}
    best = choose(costs, [habits.get(name) for name in names])
    right = scan["right"].split()
    rivals = [cost for name, cost in zip(names, costs, strict=True) if name not in right]
    return names[best] in right, min(rivals, default=1.0) - costs[best]


def _misread(rare: float = RARE, habit: float = HABIT) -> int:
    return sum(not _weigh(scan, rare, habit)[0] for scan in SIDES)


def test_a_scan_from_inside_is_as_rare_as_parts_objects_and_rooms() -> None:
    assert _misread() == 0
    assert _misread(rare=0.9 * RARE) == _misread(rare=1.1 * RARE) == 0
    assert _misread(rare=2.0 * RARE) > 0  # half of it: see `test_readings`


def test_habit_decides_where_nothing_else_does() -> None:
    """A yard and a street, of which the sky saw nothing, look as well from below."""
    for factor in (0.9, 1.0, 1.1, 2.0):
        assert _misread(habit=factor * HABIT) == 0
    assert _misread(habit=0.5 * HABIT) > 0
    views = [s for s in SIDES if s["group"] == "view, terrain" and s["turned"] != ""]
    gaps = [abs(view["turned"] - view["side"]) for view in views]
    assert sum(gap < 0.5 * HABIT for gap in gaps) > len(gaps) / 2


def _sure(factor: float) -> set[str]:
    least = factor * SURE * CERTAIN
    return {scan["scan"] for scan in SIDES if _weigh(scan, RARE, HABIT)[1] >= least}


def test_sure_is_what_all_rivals_leave_by_far() -> None:
    assert _sure(0.9) == _sure(1.0) == _sure(1.1)
    assert _sure(0.5) > _sure(1.0) > _sure(1.5)
    sure = [scan for scan in SIDES if scan["scan"] in _sure(1.0)]
    assert len(sure) > 0.8 * len(SIDES)


@pytest.mark.parametrize("signed", ["to +z", "to a camera", "to the middle"])
def test_normals_that_follow_a_place_are_torn(signed: str) -> None:
    found = [_is_torn(row) for row in NORMALS if row["signed"] == signed]
    assert sum(found) > 0.9 * len(found)


def _is_torn(row: dict[str, Any], factor: float = 1.0) -> bool:
    return Torn(row["following"], row["pairs"], row["torn"] / factor).is_torn


def _count_torn(factor: float, *, is_true: bool) -> int:
    rows = [row for row in NORMALS if (row["signed"] == "as they are") == is_true]
    return sum(_is_torn(row, factor) for row in rows)


def test_torn_parts_right_normals_and_those_that_follow_a_place() -> None:
    assert 0.0 < TORN < 1.0
    for factor in (0.9, 1.0, 1.1):
        assert _count_torn(factor, is_true=True) == 0
        assert _count_torn(factor, is_true=False) == _count_torn(1.0, is_true=False)
    assert _count_torn(0.5, is_true=True) > 0
    assert _count_torn(1.5, is_true=False) < _count_torn(1.0, is_true=False)


def _count_warned(column: str, *, is_right: bool) -> int:
    rows = [row for row in HANDLES if (row["genus"] == row["true genus"]) == is_right]
    return sum(row[column] > 0 for row in rows)


def test_small_handles_are_those_that_the_truth_has_not() -> None:
    more = [row for row in HANDLES if row["genus"] > row["true genus"]]
    assert sum(row["in one"] > 0 for row in more) > 0.9 * len(more)
    assert _count_warned("in one", is_right=True) <= 0.05 * len(HANDLES)
    assert _count_warned("in half", is_right=False) < _count_warned("in one", is_right=False)
