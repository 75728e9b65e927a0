"""The numbers that decide over normals and warnings lie between what they part, with a margin.

On what `benchmarks/decisions.py` has measured: moved by a tenth, they decide the same; halved or
doubled, something else.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from hpcapp.applications.surface.normals.consistency import TORN, Torn
from hpcapp.geometry.pieces import SMALL

RESULTS = Path(__file__).parents[2] / "benchmarks" / "results"


def _read(name: str) -> list[dict[str, Any]]:
    table = json.loads((RESULTS / f"{name}.json").read_text(encoding="utf-8"))
    return [dict(zip(table["columns"], row, strict=True)) for row in table["rows"]]


NORMALS, HANDLES = _read("decisions-normals"), _read("decisions-handles")
PIECES = _read("decisions-pieces")


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


def _count_handles(column: str) -> tuple[int, int, int]:
    """Return how many meshes have all of the truth's handles and no more, and how many others."""
    off = [row[column] - row["true"] for row in HANDLES]
    return off.count(0), sum(max(more, 0) for more in off), sum(max(-more, 0) for more in off)


def test_small_handles_are_those_that_the_truth_has_not() -> None:
    uncut, half, cut, twice = map(_count_handles, ("uncut", "cut to half", "cut", "cut to twice"))
    assert cut[0] > 1.3 * uncut[0]  # meshes that are right
    assert cut[1] < 0.2 * uncut[1]  # handles too many
    assert half[1] > 3.0 * cut[1]
    assert cut[2] - uncut[2] < 0.25 * (uncut[1] - cut[1])  # true ones that are lost
    assert twice[2] > 1.1 * cut[2]
    assert half[0] < cut[0]


def test_no_part_of_a_scan_is_small_and_shreds_are() -> None:
    """A third more of either is between them; shreds of every size are told apart by half."""
    parts = [row["least part"] for row in PIECES if row["parts"]]
    shreds = [row["largest shred"] for row in PIECES if row["largest shred"] != ""]
    assert len(parts) == 8
    assert len(shreds) == 3
    assert 2.5 * SMALL < min(parts) < 3.0 * SMALL
    assert SMALL / 4.0 < max(shreds) < SMALL / 3.0
    counts = [sum(row[name] for row in PIECES) for name in ("in half", "in one", "in two")]
    assert counts[0] < 0.85 * counts[1]
    assert counts[2] > 1.1 * counts[1]
