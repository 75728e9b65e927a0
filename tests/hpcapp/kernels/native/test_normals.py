"""The native kernels of normals without a side: numpy's results, the same bits, no crash."""

from __future__ import annotations

import contextlib
from types import ModuleType

import numpy as np
import pytest
from both_builds import assert_alike
from directions import random_directions
from hypothesis import given, settings
from hypothesis import strategies as st

from hpcapp.geometry.points import FloatArray
from hpcapp.kernels import portable


def _make_points(kind: str, seed: int) -> FloatArray:
    """Return points about 0.1 apart, and some that are not."""
    random = np.random.default_rng(seed)
    if kind == "grid":  # most neighbours of a point are as far away as others
        places = np.stack(np.meshgrid(*[np.arange(24)] * 2, [0, 7], indexing="ij"), axis=-1)
        return 0.1 * places.reshape(-1, 3)[random.permutation(24 * 24 * 2)].astype(np.float64)
    if kind == "wall":  # both sides of one, little thicker than points are apart
        sides = 0.07 * random.choice([-1.0, 1.0], size=1500) + 0.005 * random.normal(size=1500)
        return np.column_stack([random.uniform(0.0, 2.7, size=(1500, 2)), sides])
    if kind == "edge":  # of 30 degrees
        along = random.uniform(0.0, 2.7, size=(1500, 2))
        sides = along[:, 0] * random.choice([-0.27, 0.27], size=1500)
        return np.column_stack([along, sides + 0.005 * random.normal(size=1500)])
    directions = random_directions(1500, random)
    if kind == "noisy":  # planes of many points
        directions *= 1.0 + 0.1 * random.normal(size=(1500, 1))
    if kind == "uneven":  # most points lie much closer, some at one place, some far from all
        directions[500:] = [1.0, 0.0, 0.0] + 0.02 * directions[500:]
        directions[:40] = directions[0]
        directions[-5:] *= np.array([[3.0], [4.0], [5.0], [6.0], [90.0]])
    return directions


KINDS = ["sphere", "noisy", "uneven", "grid", "wall", "edge"]


@pytest.mark.parametrize("kind", KINDS)
@given(seed=st.integers(0, 2**32), share=st.floats(0.0, 1.0))
@settings(deadline=None, max_examples=8)
def test_planes(native: ModuleType, kind: str, seed: int, share: float) -> None:
    positions = _make_points(kind, seed)
    asked = (np.random.default_rng(seed).random(len(positions)) < share).astype(np.uint8)
    given_points = positions, asked, positions.min(axis=0) - 0.03, 0.1
    for threads in (1, 3):
        vectors = assert_alike(native, "fit_planes", *given_points, threads)
    assert vectors.shape == (np.count_nonzero(asked), 3)


@pytest.mark.parametrize("kind", KINDS)
def test_planes_depend_on_no_order(native: ModuleType, kind: str) -> None:
    positions = _make_points(kind, 5)
    order = np.random.default_rng(6).permutation(len(positions))
    asked, low = np.ones(len(positions), np.uint8), positions.min(axis=0)
    vectors = native.fit_planes(positions, asked, low, 0.1)
    assert (
        native.fit_planes(positions[order], asked, low, 0.1).tobytes() == vectors[order].tobytes()
    )


@pytest.mark.parametrize("kind", KINDS)
@given(seed=st.integers(0, 2**32), share=st.floats(0.0, 1.0))
@settings(deadline=None, max_examples=8)
def test_groups_and_links(native: ModuleType, kind: str, seed: int, share: float) -> None:
    positions, low = _make_points(kind, seed), np.full(3, -2.0)
    own = (np.random.default_rng(seed).random(len(positions)) < share).astype(np.uint8)
    vectors = portable.fit_planes(positions, np.ones_like(own), low, 0.1)
    points = positions, vectors, low, 0.4, 0.1
    for threads in (1, 3):
        grouped = assert_alike(native, "group_sheets", *points, threads)
        assert_alike(native, "link_groups", positions, own, grouped[2], low, 0.1, threads)


@given(st.data())
@settings(deadline=None, max_examples=100)
def test_contradictory_arguments(native: ModuleType, data: st.DataObject) -> None:
    random = np.random.default_rng(data.draw(st.integers(0, 2**16)))
    points = random.normal(size=(9, 3)) * data.draw(st.sampled_from([0.0, 1.0, 1e300, np.nan]))
    single = random.normal(size=(9, 3)).astype(np.float32)
    lengths = [data.draw(st.sampled_from([0.0, 0.1, 1e-300, 1e300, np.nan])) for _ in range(2)]
    asked = np.ones(data.draw(st.integers(8, 9)), np.uint8)
    calls = [
        ("fit_planes", points, asked, points[0], lengths[0]),
        ("link_groups", points, asked, random.integers(-1, 10, 9), points[0], lengths[0]),
        ("group_sheets", points, single, points[0], *lengths),
    ]
    name, *values = data.draw(st.sampled_from(calls))
    with contextlib.suppress(ValueError):
        getattr(native, name)(*values, threads=2)


def test_messages_name_the_argument(native: ModuleType) -> None:
    points, ones = np.zeros((2, 3)), np.ones(2, np.uint8)
    with pytest.raises(ValueError, match="group_of: a row is out of range"):
        native.link_groups(points, ones, np.array([0, 2]), points[0], 0.1)
    with pytest.raises(ValueError, match="positions: a point lies off the lattice"):
        native.fit_planes(points + np.nan, ones, points[0], 0.1)
