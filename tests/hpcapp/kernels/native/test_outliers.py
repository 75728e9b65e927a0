"""The native kernels of outliers, strays and normals: numpy's results, the same bits, no crash."""

from __future__ import annotations

import contextlib
from types import ModuleType

import numpy as np
import pytest
from both_builds import assert_alike
from directions import random_directions
from hypothesis import given, settings
from hypothesis import strategies as st

from hpcapp.kernels import portable


@given(st.integers(0, 2**32), st.integers(1, 300), st.floats(0.05, 5.0))
@settings(deadline=None, max_examples=40)
def test_cells_and_their_neighbours(native: ModuleType, seed: int, count: int, edge: float) -> None:
    random = np.random.default_rng(seed)
    positions = random.normal(size=(count, 3))
    low = positions.min(axis=0)
    keys = assert_alike(native, "count_cells", positions, low, edge)[0]
    values = random.integers(-9, 9, (len(keys), 3))
    assert_alike(native, "sum_neighbours", keys, values, random.integers(0, len(keys), 20))


@given(st.integers(0, 2**32), st.integers(1, 300), st.floats(0.05, 5.0), st.integers(0, 9))
@settings(deadline=None, max_examples=40)
def test_halved_cells(native: ModuleType, seed: int, count: int, edge: float, depth: int) -> None:
    random = np.random.default_rng(seed)
    positions = np.round(random.normal(size=(count, 3)), random.integers(0, 9))
    assert_alike(native, "count_halved", positions, random.normal(size=3), edge, depth)


@given(st.integers(0, 2**32), st.integers(1, 400), st.booleans())
@settings(deadline=None, max_examples=40)
def test_neighbours(native: ModuleType, seed: int, points: int, is_gridded: bool) -> None:
    random = np.random.default_rng(seed)
    positions = random.normal(size=(points, 3)) * (1.0, 1.0, 0.1)
    if is_gridded:  # many are equally far away
        positions = np.round(4.0 * positions) / 4.0
    edge = random.uniform(0.1, 1.5)
    cells = portable.sort_points(positions, positions.min(axis=0) - 0.01, edge)
    radii = edge * random.uniform(0.1, 1.0, len(cells[0]))
    for threads in (1, 3):
        assert_alike(native, "find_sparse", positions, *cells, radii, 5, threads)
    asked = random.integers(0, points, random.integers(0, 40))
    count, limit = int(random.integers(1, 30)), float(edge * random.uniform(0.3, 6.0))
    assert_alike(native, "find_nearest", positions, *cells, edge, asked, count, limit, 2)


@given(st.integers(0, 2**32), st.floats(0.1, 0.6), st.floats(0.01, 0.3))
@settings(deadline=None, max_examples=25)
def test_polls(native: ModuleType, seed: int, reach: float, tolerance: float) -> None:
    random = np.random.default_rng(seed)
    directions = random_directions(600, random)
    positions = directions * (1.0, 0.7, 0.2)
    given_normals = directions * np.where(random.random(600) < 0.2, -1.0, 1.0)[:, None]
    keys, _, cell_of = portable.count_cells(positions, positions.min(axis=0), reach)
    asked = (random.random(600) < 0.9).astype(np.uint8)
    poll = (positions, given_normals, keys, cell_of, asked, reach, tolerance, 0.5 * tolerance)
    for threads in (1, 3):
        assert_alike(native, "poll_normals", *poll, threads)


@given(st.integers(0, 2**32))
@settings(deadline=None, max_examples=25)
def test_normals_are_polled_alike_however_they_are_held(native: ModuleType, seed: int) -> None:
    random = np.random.default_rng(seed)
    positions = random.normal(size=(600, 3)) * (1.0, 0.7, 0.02)
    singles = random.normal(size=(600, 3)).astype(np.float32)
    keys, _, cell_of = portable.count_cells(positions, positions.min(axis=0), 0.4)
    rest = keys, cell_of, np.ones(600, np.uint8), 0.4, 0.1, 0.05
    wide = native.poll_normals(positions, singles.astype(np.float64), *rest, 1)
    assert native.poll_normals(positions, singles, *rest, 1).tobytes() == wide.tobytes()
    assert len(np.unique(wide)) > 1


@given(st.data())
@settings(deadline=None, max_examples=100)
def test_contradictory_arguments(native: ModuleType, data: st.DataObject) -> None:
    random = np.random.default_rng(data.draw(st.integers(0, 2**16)))
    points = random.normal(size=(9, 3)) * data.draw(st.sampled_from([1.0, 1e300, np.nan]))
    keys = np.unique(random.integers(0, 2**63 - 1, data.draw(st.integers(0, 9))))
    rows = random.integers(-1, 9, 9)
    lengths = [data.draw(st.sampled_from([0.0, 0.1, 1e300, np.nan])) for _ in range(3)]
    asked = np.ones(data.draw(st.integers(8, 9)), np.uint8)
    calls = [
        ("count_cells", points, points[0], lengths[0]),
        ("count_halved", points, points[0], lengths[0], int(random.integers(-1, 22))),
        ("sum_neighbours", keys, random.integers(-(2**62), 2**62, (len(keys), 4)), rows),
        ("poll_normals", points, points, keys, rows, asked, *lengths, 2),
        ("find_sparse", points, keys, rows, rows.astype(np.uint32), points[0], 3, 2),
        (
            "find_nearest",
            points,
            keys,
            rows,
            rows.astype(np.uint32),
            lengths[0],
            rows,
            3,
            lengths[1],
            2,
        ),
    ]
    name, *values = data.draw(st.sampled_from(calls))
    with contextlib.suppress(ValueError):
        getattr(native, name)(*values)


def test_messages_name_the_argument(native: ModuleType) -> None:
    keys = np.array([5, 9])
    with pytest.raises(ValueError, match="wanted: a row is out of range"):
        native.sum_neighbours(keys, np.ones((2, 1), np.int64), np.array([2]))
    with pytest.raises(ValueError, match="cells: expected sorted"):
        native.sum_neighbours(keys[::-1].copy(), np.ones((2, 1), np.int64), np.array([0]))


@given(st.integers(0, 2**32), st.integers(0, 300), st.integers(0, 60))
@settings(deadline=None, max_examples=40)
def test_support(native: ModuleType, seed: int, points: int, places: int) -> None:
    random = np.random.default_rng(seed)
    positions = random.normal(size=(points, 3)) * (1.0, 1.0, 0.1)
    normals = random.normal(size=(points, 3)) * 0.2 + (0.0, 0.0, 1.0)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    radii = random.uniform(0.05, 0.8, points)
    cloud = positions, normals, radii, radii * random.uniform(0.1, 1.0, points)
    asked = random.normal(size=(places, 3)) * (1.5, 1.5, 0.1)
    ways = random.normal(size=(places, 8, 3))
    for threads in (1, 3):
        assert_alike(native, "count_supporting", asked, *cloud, threads)
        for enough in (1, 3):
            bounds = enough, 0.7, 2.25
            assert_alike(native, "measure_aside", asked, ways, *cloud, *bounds, threads)
