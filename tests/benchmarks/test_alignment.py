"""The limits of sure poses part right ones from wrong ones, with a margin.

On what `benchmarks/alignment.py` has measured: moved by a tenth, nothing wrong becomes sure; moved
by half, something right is lost, or something wrong becomes sure.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hpcapp.alignment.judge import Verdict
from hpcapp.alignment.pair import PairPose

_TABLE = json.loads(
    (Path(__file__).parents[2] / "benchmarks/results/alignment.json").read_text(encoding="utf-8")
)
ROWS = [dict(zip(_TABLE["columns"], row, strict=True)) for row in _TABLE["rows"]]
RIGHT = 1.0  # spacings: half of one is what is aimed at
LIMITS = ("worth", "margin", "slides", "through")


def _is_sure(row: dict[str, Any], limit: str = "", factor: float = 1.0) -> bool:
    """Tell whether a pose is sure where one limit is moved: what it limits is, the other way."""
    worth, second, slid, through = (row[name] for name in ("worth", "next", "slid", "through"))
    if limit == "worth":
        worth, second, slid = worth / factor, second / factor, slid / factor
    elif limit == "margin":
        second = worth - (worth - second) / factor
    elif limit == "slides":
        slid /= factor
    elif limit == "through":
        through /= factor
    verdict = Verdict(worth, 0.5, through)
    return PairPose(np.eye(4), verdict, second, slid, 0.0, np.eye(6), np.zeros(3)).is_sure


def _count(limit: str, factor: float, *, is_right: bool) -> int:
    return sum(
        _is_sure(row, limit, factor)
        for row in ROWS
        if (row["off"] != "-" and row["off"] < RIGHT) == is_right
    )


def test_most_pairs_that_have_an_answer_are_right() -> None:
    answered = [row["off"] for row in ROWS if row["off"] != "-"]
    assert sum(off < RIGHT for off in answered) > 0.7 * len(answered)


@pytest.mark.parametrize("limit", LIMITS)
@pytest.mark.parametrize("factor", [0.9, 1.0, 1.1])
def test_nothing_wrong_is_sure(limit: str, factor: float) -> None:
    assert _count(limit, factor, is_right=False) == 0
    assert _count(limit, factor, is_right=True) > 0.8 * _count(limit, 1.0, is_right=True)


@pytest.mark.parametrize("limit", LIMITS)
def test_by_half_something_else_is_decided(limit: str) -> None:
    moved = [
        _count(limit, factor, is_right=is_right) - _count(limit, 1.0, is_right=is_right)
        for factor in (0.5, 1.5)
        for is_right in (True, False)
    ]
    assert any(moved)
