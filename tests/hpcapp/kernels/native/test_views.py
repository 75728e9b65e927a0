"""The native kernels of views and of what follows over links: numpy's results, threads or not."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest
from both_builds import assert_alike
from directions import random_directions
from hypothesis import given, settings
from hypothesis import strategies as st

from hpcapp.kernels import portable


@given(
    seed=st.integers(0, 2**32), patches=st.integers(0, 400), far=st.sampled_from([0.3, 3.0, 1e9])
)
@settings(deadline=None, max_examples=20)
def test_views(native: ModuleType, seed: int, patches: int, far: float) -> None:
    """From near, where patches fill pixels of several sizes, and from far away."""
    random = np.random.default_rng(seed)
    normals = random_directions(patches, random)
    centres = np.round(normals * (1.0, 0.8, 0.6), 2)  # several are as far away as others
    noise = random.uniform(0.0, 0.1, patches)
    viewpoints = far * random.normal(size=(5, 3))
    given_patches = centres, normals, noise, noise * 5.0, viewpoints, 0.02
    for threads in (1, 3):
        seen = assert_alike(native, "view_patches", *given_patches, threads)
    assert_alike(native, "add_views", *seen)


@given(seed=st.integers(0, 2**32), nodes=st.integers(1, 60), known=st.integers(0, 60))
@settings(deadline=None, max_examples=20)
def test_leanings(native: ModuleType, seed: int, nodes: int, known: int) -> None:
    random = np.random.default_rng(seed)
    ends = np.argwhere(np.triu(random.random((nodes, nodes)) < 0.2, 1)).T
    first, second = np.ascontiguousarray(ends)
    strengths = random.normal(size=len(first))
    sums = np.full(nodes, 1e-3)
    for end in ends:
        sums += np.bincount(end, np.abs(strengths), nodes)
    right = np.where(np.arange(nodes) < known, random.normal(size=nodes), 0.0)
    start = random.normal(size=nodes)
    system = first, second, strengths, sums, right, start
    found = native.spread_leanings(*system, 1e-10, 500)
    wanted = portable.spread_leanings(*system, 1e-10, 500)
    np.testing.assert_allclose(found, wanted, 1e-6, 1e-6)
    matrix = np.diag(sums)
    matrix[first, second] = matrix[second, first] = -strengths
    np.testing.assert_allclose(matrix @ found, right, atol=1e-8)


@given(seed=st.integers(0, 2**32), sides=st.tuples(*[st.integers(1, 15)] * 3))
@settings(deadline=None, max_examples=40)
def test_distances(native: ModuleType, seed: int, sides: tuple[int, int, int]) -> None:
    occupied = np.random.default_rng(seed).random(sides) < 0.03
    distances = native.measure_distances(occupied)
    assert distances.tobytes() == portable.measure_distances(occupied).tobytes()
    assert distances.tobytes() == native.measure_distances(occupied, 3).tobytes()


def test_messages_name_the_argument(native: ModuleType) -> None:
    points, ones = np.zeros((2, 3)), np.ones(2)
    with pytest.raises(ValueError, match="viewpoints: expected finite numbers below 1e150"):
        native.view_patches(points, points, ones, ones, points + 1e200, 0.1)
    rows = np.zeros(1, np.int64)
    with pytest.raises(ValueError, match="second: a row is out of range"):
        native.spread_leanings(rows, rows + 2, ones[:1], ones, ones, ones, 0.1, 9)
    with pytest.raises(ValueError, match="most: expected 0 to"):
        native.spread_leanings(rows, rows + 1, ones[:1], ones, ones, ones, 0.1, -1)
