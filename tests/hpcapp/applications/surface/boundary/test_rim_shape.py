"""What stood on a table draws together at its border, terrains and views do not."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.boundary.rim_shape import draws_together
from hpcapp.geometry.points import FloatArray

TURNS = [np.eye(3), np.eye(3)[[1, 2, 0]], np.diag([1.0, -1.0, -1.0])]


def _ball(count: int) -> FloatArray:
    ball = np.random.default_rng(0).normal(size=(count, 3))
    unit: FloatArray = ball / np.linalg.norm(ball, axis=1)[:, None]
    return unit


def _terrain(height: float) -> tuple[FloatArray, FloatArray]:
    places = np.random.default_rng(1).uniform(-3.0, 3.0, (6_000, 3))
    places[:, 2] = height * np.sin(places[:, 0]) * np.cos(places[:, 1])
    slopes = np.stack(
        [
            -height * np.cos(places[:, 0]) * np.cos(places[:, 1]),
            height * np.sin(places[:, 0]) * np.sin(places[:, 1]),
            np.ones(len(places)),
        ],
        axis=1,
    )
    return places, slopes / np.linalg.norm(slopes, axis=1)[:, None]


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("lowest", [-0.6, -0.3, 0.0])
def test_an_object_draws_together_whatever_is_up(turn: FloatArray, lowest: float) -> None:
    ball = _ball(9_000)
    dome = ball[ball[:, 2] > lowest] @ turn
    assert draws_together(dome, dome, np.ones(len(dome)))


@pytest.mark.parametrize("height", [0.0, 0.3, 0.8])
def test_terrains_do_not(height: float) -> None:
    places, normals = _terrain(height)
    assert not draws_together(places, normals, np.ones(len(places)))


def test_what_is_closed_does_not() -> None:
    ball = _ball(6_000)
    assert not draws_together(ball, ball, np.ones(len(ball)))


def test_a_flat_view_of_something_round_does_not() -> None:
    ball = _ball(20_000)
    cap = ball[ball[:, 2] > 0.96]
    assert not draws_together(cap, cap, np.ones(len(cap)))


def test_few_points_tell_nothing() -> None:
    ball = _ball(60)
    dome = ball[ball[:, 2] > 0.0]
    assert not draws_together(dome, dome, np.ones(len(dome)))
