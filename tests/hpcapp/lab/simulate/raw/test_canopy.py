"""Crowns: what comes back of them lies in them, and how much goes through them follows Beer."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.lab.simulate.raw.canopy import Canopy, Crown

CROWN = Crown(10.0, 10.0, 4.0, 2.0, 12.0)


def test_returns_lie_within_the_crown_and_pulses_beside_it_go_on() -> None:
    rng = np.random.default_rng(0)
    origins = np.column_stack([rng.uniform(0.0, 20.0, (20_000, 2)), np.full(20_000, 50.0)])
    down = np.tile([0.0, 0.0, -1.0], (20_000, 1))
    canopy = Canopy([CROWN], 20.0)
    pulses, distances, goes_on = canopy.strike(origins, down, np.full(20_000, 50.0), rng)
    at = origins[pulses] + distances[:, None] * down[pulses]
    inside = ((at[:, :2] - 10.0) ** 2).sum(axis=1) / 16.0 + ((at[:, 2] - 7.0) / 5.0) ** 2
    assert inside.max() < 1.8  # the maps of a crown have cells of half a metre
    assert np.quantile(inside, 0.95) < 1.1
    away = np.hypot(*(origins[:, :2] - 10.0).T)
    assert goes_on[away > 5.0].all()
    # through 10 m in the middle of which a return comes every 4 m, and 7 of 10 pulses go on
    assert goes_on[away < 1.0].mean() == pytest.approx(np.exp(-0.3 * 10.0 / 4.0), abs=0.1)
    assert np.bincount(pulses, minlength=20_000)[away < 1.0].max() > 2


def test_nothing_comes_from_behind_the_surface() -> None:
    rng = np.random.default_rng(0)
    origins, down = np.tile([10.0, 10.0, 50.0], (2000, 1)), np.tile([0.0, 0.0, -1.0], (2000, 1))
    reach = np.full(2000, 42.0)
    _, distances, _ = Canopy([CROWN], 20.0).strike(origins, down, reach, rng)
    assert len(distances)
    assert distances.max() <= 42.0


def test_a_level_ray_meets_the_crown_too() -> None:
    rng = np.random.default_rng(0)
    origins, ahead = np.tile([0.0, 10.0, 7.0], (2000, 1)), np.tile([1.0, 0.0, 0.0], (2000, 1))
    _, distances, _ = Canopy([CROWN], 20.0).strike(origins, ahead, np.full(2000, 200.0), rng)
    assert distances.min() == pytest.approx(6.0, abs=0.5)
    assert distances.max() == pytest.approx(14.0, abs=0.5)
