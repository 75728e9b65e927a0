"""Neighbourhoods of points on curves and surfaces, and in volumes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from directions import random_directions
from hypothesis import given
from hypothesis import strategies as st

from hpcapp.applications.surface.scale.dimension import (
    FEWEST,
    Neighbourhoods,
    choose_counts,
    look_around,
)
from hpcapp.geometry.points import FloatArray

Random = np.random.Generator


def look(positions: FloatArray) -> Neighbourhoods:
    return look_around(positions, choose_counts(len(positions)))


def on_a_sphere(random: Random, count: int) -> FloatArray:
    return random_directions(count, random)


def in_a_ball(random: Random, count: int) -> FloatArray:
    ball: FloatArray = on_a_sphere(random, count) * random.random((count, 1)) ** (1 / 3)
    return ball


def on_an_arc(random: Random, count: int) -> FloatArray:
    angle = random.uniform(0.0, 2.0, count)
    return np.stack([np.cos(angle), np.sin(angle), 0.5 * angle], axis=1)


KINDS: dict[str, tuple[Callable[[Random, int], FloatArray], float]] = {
    "curve": (on_an_arc, 1.0),
    "surface": (on_a_sphere, 2.0),
    "volume": (in_a_ball, 2.7),
}


@given(
    kind=st.sampled_from(sorted(KINDS)),
    count=st.integers(1000, 4096),  # of 500 in a ball, one in twenty draws looks like less
    seed=st.integers(0, 1000),
    size=st.sampled_from([1e-30, 1.0, 1e30]),
)
def test_each_kind_is_told_at_any_size(kind: str, count: int, seed: int, size: float) -> None:
    make, dimension = KINDS[kind]
    around = look(make(np.random.default_rng(seed), count) * size)
    assert np.median(around.growth()) == pytest.approx(dimension, abs=0.3)
    shares = {
        "curve": around.follow_curve().mean(),
        "surface": around.lie_flat().mean(),
        "volume": around.fill_volume().mean(),
    }
    assert shares.pop(kind) > 0.5
    assert max(shares.values()) < 0.15


@pytest.mark.parametrize("noise", [0.01, 0.03, 0.1])
def test_noise_fills_no_volume_beyond_its_own_scale(noise: float) -> None:
    random = np.random.default_rng(3)
    positions = on_a_sphere(random, 4096) + noise * random.normal(size=(4096, 3))
    assert look(positions).fill_volume().mean() < 0.05


def test_variances_are_those_of_the_nearest() -> None:
    positions = np.random.default_rng(4).normal(size=(200, 3))
    around = look_around(positions, (20, 50))
    distances = np.linalg.norm(positions - positions[2 * 7], axis=1)
    nearest = np.argsort(distances)[:51]
    assert around.radii[7, 1] == pytest.approx(distances[nearest[-1]])
    expected = np.linalg.eigvalsh(np.cov(positions[nearest].T, bias=True))
    assert around.variances[7, 1] == pytest.approx(expected)


def test_few_points_have_few_counts() -> None:
    assert choose_counts(4 * FEWEST - 1) == ()
    assert choose_counts(8 * FEWEST) == (15, 30)
    assert choose_counts(4096) == (32, 128, 512, 1024)
