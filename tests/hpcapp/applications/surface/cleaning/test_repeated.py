from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.cleaning.repeated import find_repeated


@pytest.mark.parametrize("step", [1.0, 2.0**-30, 1e-3])
@pytest.mark.parametrize("points", [0, 1, 2, 50_000])
def test_all_but_the_first_at_each_place_are_found(points: int, step: float) -> None:
    """On a lattice with many zeros at the end of each number, which hash alike if badly mixed."""
    random = np.random.default_rng(points)
    positions = (random.integers(-40, 40, (points, 3)) * step).astype(np.float64)
    repeated = find_repeated(positions)
    _, first = np.unique(positions, axis=0, return_index=True)
    assert np.array_equal(np.flatnonzero(~repeated), np.sort(first))


def test_a_negative_zero_is_a_zero() -> None:
    positions = np.array([[0.0, 1.0, -0.0], [-0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    assert find_repeated(positions).tolist() == [False, True, False]


def test_coordinates_in_another_order_are_another_place() -> None:
    positions = np.array([[1.0, 2.0, 3.0], [3.0, 2.0, 1.0], [2.0, 1.0, 3.0]])
    assert not find_repeated(positions).any()
