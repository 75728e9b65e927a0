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
from hpcapp.applications.surface.normals.readings import CERTAIN, GROUND, HABIT, RARE, choose
from hpcapp.geometry.pieces import SMALL

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"
GROUNDS = "street, yard", "view, terrain"
READINGS = ("outside", "inside", "side", "turned", "camera")


def _read(name: str) -> list[dict[str, Any]]:
    table = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
    return [dict(zip(table["columns"], row, strict=True)) for row in table["rows"]]


SIDES, NORMALS = _read("decisions-sides"), _read("decisions-normals")
HANDLES, PIECES = _read("decisions-handles"), _read("decisions-pieces")


def _weigh(
    scan: dict[str, Any], rare: float, habit: float, ground: float = GROUND
) -> tuple[bool, float]:
    """Return whether a scan is read rightly, and by which margin over what turns it round."""
    names = [name for name in READINGS if scan[name] != ""]
    costs = [scan[name] + (rare if name == "inside" else scan["stand"]) for name in names]
    downwards = {"side": scan["habit"], "turned": 1.0 - scan["habit"]}
    habits = {**downwards, "camera": 1.0}
    costs = [
        cost + ground * scan["level"] * downwards.get(name, 0.0)
        for name, cost in zip(names, costs, strict=True)
    ]
    best = choose(costs, [habit * habits[name] if name in habits else None for name in names])
    right = scan["right"].split()
    rivals = [cost for name, cost in zip(names, costs, strict=True) if name not in right]
    return names[best] in right, min(rivals, default=1.0) - costs[best]


def _misread(rare: float = RARE, habit: float = HABIT, ground: float = GROUND) -> int:
    return sum(not _weigh(scan, rare, habit, ground)[0] for scan in SIDES)


def test_a_scan_from_inside_is_as_rare_as_parts_objects_and_rooms() -> None:
    assert _misread() == 0
    assert _misread(rare=0.9 * RARE) == _misread(rare=1.1 * RARE) == 0
    assert _misread(rare=2.0 * RARE) > 0  # half of it: see `test_readings`


def test_rare_has_room_on_both_sides() -> None:
    assert _misread(rare=0.7 * RARE) == _misread(rare=1.3 * RARE) == 0
    assert _misread(rare=0.5 * RARE) > 0


def test_few_look_at_the_ground_from_below() -> None:
    """A yard and a street, of which the sky saw nothing, look as well from below."""
    for factor in (0.9, 1.0, 1.1, 2.0):
        assert _misread(habit=factor * HABIT) == _misread(ground=factor * GROUND) == 0
    assert _misread(habit=0.25 * HABIT, ground=0.25 * GROUND) > 0
    level = [scan for scan in SIDES if scan["level"] and scan["group"] in GROUNDS]
    lying = {scan["scan"] for scan in level if scan["camera"] == ""}
    assert len(lying) > 20
    assert lying <= _sure(1.0, 0.9 * GROUND)
    assert lying <= _sure(1.0)
    assert not lying <= _sure(1.0, 0.5 * GROUND)


def _sure(factor: float, ground: float = GROUND) -> set[str]:
    least = factor * SURE * CERTAIN
    return {scan["scan"] for scan in SIDES if _weigh(scan, RARE, HABIT, ground)[1] >= least}


def test_sure_is_what_all_rivals_leave_by_far() -> None:
    assert _sure(0.9) == _sure(1.0) == _sure(1.1)
    assert _sure(1.0) > _sure(1.5)
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


def test_no_part_of_a_scan_is_small_and_shreds_are() -> None:
    """A third more of either is between them; shreds of every size are told apart by half."""
    parts = [row["least part"] for row in PIECES if row["parts"]]
    shreds = [row["largest shred"] for row in PIECES if row["largest shred"] != ""]
    assert len(parts) == 8
    assert len(shreds) == 3
    assert 2.5 * SMALL < min(parts) < 3.0 * SMALL
    assert SMALL / 4.0 < max(shreds) < SMALL / 3.0
    counts = [sum(row[name] for row in PIECES) for name in ("in half", "in one", "in two")]
    assert counts[0] < 0.75 * counts[1]
    assert counts[2] > 1.1 * counts[1]
