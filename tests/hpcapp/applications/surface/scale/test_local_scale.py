"""The local scale against clouds whose spacing is known at every place."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.scale.local_scale import (
    LocalScale,
    count_depth,
    count_scale,
    make_scale,
)
from hpcapp.geometry.points import FloatArray

ORIGIN, EDGE = np.full(3, -8.0), 0.25


def measure(positions: FloatArray, spacing: float, parts: int = 1) -> LocalScale:
    """Count a cloud in slabs of whole cells, and put them together in another order."""
    slab = np.floor((positions[:, 0] - ORIGIN[0]) / EDGE).astype(int) % parts
    depth = count_depth(EDGE, spacing)
    counted = [count_scale(positions[slab == i], ORIGIN, EDGE, depth) for i in range(parts)]
    return make_scale(spacing, ORIGIN, EDGE, counted[::-1])


def sheet(low: float, high: float, spacing: float, seed: int | None = None) -> FloatArray:
    """Return points of a tilted sheet over [low, high] x [0, 2]: on a lattice, or by chance."""
    count = np.array([(high - low) / spacing, 2.0 / spacing]).astype(int)
    if seed is None:
        x, y = (axis.ravel() for axis in np.meshgrid(np.arange(count[0]), np.arange(count[1])))
        x, y = low + spacing * x, spacing * y
    else:
        random = np.random.default_rng(seed)
        x = random.uniform(low, high, count.prod())
        y = random.uniform(0.0, 2.0, count.prod())
    return np.stack([x, 0.8 * y, 0.6 * y], axis=1)


@pytest.mark.parametrize("seed", [None, 1, 2])
def test_an_even_sheet_has_one_spacing_up_to_its_rim(seed: int | None) -> None:
    positions = sheet(-1.0, 1.0, 0.02, seed)
    found = measure(positions, 0.02).at(positions)
    assert np.median(found) == pytest.approx(0.02, rel=0.25)
    assert found.min() > 0.6 * 0.02
    assert found.max() < 1.7 * 0.02


@pytest.mark.parametrize("ratio", [3.0, 10.0, 30.0])
def test_where_two_scans_meet_each_keeps_its_own(ratio: float) -> None:
    fine, coarse = 0.1 / ratio, 0.1
    dense, sparse = sheet(-1.0, 0.0, fine, 3), sheet(0.0, 6.0, coarse, 4)
    scale = measure(np.concatenate([dense, sparse]), 0.05)
    assert np.abs(np.log(scale.at(dense) / fine)).max() < np.log(1.8)
    assert np.abs(np.log(scale.at(sparse) / coarse)).max() < np.log(1.8)
    low, high = scale.range
    assert low < 1.2 * fine
    assert high > 0.8 * coarse


def test_a_density_that_falls_is_followed() -> None:
    random = np.random.default_rng(5)
    distance = 0.1 * 60.0 ** random.uniform(0.0, 1.0, 60_000)  # as before a scanner
    angle = random.uniform(0.0, 2.0 * np.pi, len(distance))
    positions = np.stack(
        [distance * np.cos(angle), distance * np.sin(angle), np.zeros(len(angle))], axis=1
    )
    truth = distance * np.sqrt(2.0 * np.pi * np.log(60.0) / 60_000)
    found = measure(positions, 0.03).at(positions)
    inner = distance > 0.3  # nearer, the finest cells span a wide range of spacings
    assert np.quantile(np.abs(np.log(found / truth))[inner], 0.99) < np.log(2.0)


def test_it_does_not_depend_on_regions() -> None:
    positions = np.concatenate([sheet(-1.0, 0.0, 0.005, 6), sheet(0.0, 3.0, 0.05, 7)])
    one, many = measure(positions, 0.02), measure(positions, 0.02, parts=5)
    for name in ("levels", "keys", "spacings"):
        assert getattr(one, name).tobytes() == getattr(many, name).tobytes()


def test_it_does_not_depend_on_other_places_or_their_order() -> None:
    positions = np.concatenate([sheet(-1.0, 0.0, 0.01, 3), sheet(0.0, 6.0, 0.1, 4)])
    scale = measure(positions, 0.05)
    in_order = positions[np.lexsort(positions.T)]
    shuffled = np.random.default_rng(5).permutation(len(positions))
    found = scale.at(in_order)
    assert scale.at(in_order[shuffled]).tobytes() == found[shuffled].tobytes()
    assert scale.at(in_order[::7]).tobytes() == found[::7].tobytes()
    assert not len(scale.at(in_order[:0]))


def test_places_without_points_have_the_spacing_of_the_whole() -> None:
    scale = measure(sheet(-1.0, 1.0, 0.02), 0.02)
    far = np.array([[7.0, 7.0, 7.0], [1e9, -1e9, 0.0]])
    assert scale.at(far).tolist() == [0.02, 0.02]
    assert LocalScale.uniform(0.5).at(far).tolist() == [0.5, 0.5]
    assert LocalScale.uniform(0.5).range == (0.5, 0.5)


def test_a_few_strays_do_not_tell_a_spacing_beyond_measure() -> None:
    random = np.random.default_rng(8)
    strays = random.uniform(-7.9, 7.9, (200, 3))
    positions = np.concatenate([sheet(-1.0, 1.0, 0.02), strays])
    scale = measure(positions, 0.02)
    assert scale.range[1] <= 16.0 * 0.02
    near = scale.at(sheet(-1.0, 1.0, 0.02))
    assert np.quantile(near, 0.99) < 1.7 * 0.02
