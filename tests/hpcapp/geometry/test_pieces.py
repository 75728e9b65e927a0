"""Which pieces of a mesh stay, and which are small."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hpcapp.geometry.pieces import SMALL, PieceChoice, find_small, round_areas
from hpccomponent.errors import UsageError

AREAS = np.array([2.0, 9.0, 0.5, 2.0, 1.0])


@pytest.mark.parametrize(
    ("choice", "stays"),
    [
        (PieceChoice(), [0, 1, 2, 3, 4]),
        (PieceChoice(most=1), [1]),
        (PieceChoice(most=2), [0, 1]),  # of two that are as large as each other, the first
        (PieceChoice(most=9), [0, 1, 2, 3, 4]),
        (PieceChoice(smallest=1.0), [0, 1, 3, 4]),
        (PieceChoice(most=4, smallest=1.5), [0, 1, 3]),
    ],
)
def test_the_largest_stay(choice: PieceChoice, stays: list[int]) -> None:
    assert np.flatnonzero(choice.choose(AREAS)).tolist() == stays


def test_something_stays() -> None:
    with pytest.raises(UsageError, match="as large as 10: the largest has 9") as found:
        PieceChoice(smallest=10.0).choose(AREAS)
    assert found.value.advice == "give a smaller smallest"


@pytest.mark.parametrize("most", [0, -1, 1.5])
def test_a_number_of_pieces_is_a_whole_one(most: Any) -> None:
    with pytest.raises(UsageError, match="pieces is"):
        PieceChoice(most).check()


@pytest.mark.parametrize("smallest", [0.0, -1.0, float("nan"), float("inf")])
def test_an_area_is_positive(smallest: float) -> None:
    with pytest.raises(UsageError, match="smallest is"):
        PieceChoice(smallest=smallest).check()


def test_three_thousandths_of_the_largest_are_small() -> None:
    """Halved or doubled, the rule takes another piece of these, and moved by a tenth the same."""
    shares = np.array([1.0, 0.0044, 0.0034, 0.0026, 0.0017])
    assert find_small(500.0 * shares).tolist() == [False, False, False, True, True]
    for factor in (0.9, 1.1):
        assert ((shares < factor * SMALL) == find_small(shares)).all()
    for factor in (0.5, 2.0):
        assert ((shares < factor * SMALL) != find_small(shares)).any()


def test_nothing_has_no_small_pieces() -> None:
    assert not len(find_small(np.empty(0)))


@pytest.mark.parametrize("scale", [1e-300, 1e-66, 1.0, 1e66, 1e300])
def test_sums_in_another_order_are_as_large_at_any_scale(scale: float) -> None:
    parts = scale * np.random.default_rng(3).uniform(0.1, 1.0, 1000)
    sums = np.array([parts.sum(), parts[::-1].sum(), sum(parts.tolist())]) / 2.0
    rounded = round_areas(sums)
    assert len(set(rounded.tolist())) == 1
    assert np.abs(rounded / sums - 1.0).max() < 2.0**-23
