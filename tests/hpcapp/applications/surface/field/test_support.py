from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.field.support import (
    crowd_vertices,
    sum_squares,
    surrounded_vertices,
)
from hpcapp.geometry.lattice import pack_places, spread_keys, unique_keys, unpack_keys
from hpcapp.geometry.points import FloatArray, IntArray

LevelCounts = tuple[IntArray, FloatArray, IntArray, IntArray]


@pytest.fixture
def level() -> LevelCounts:
    """Return finer cells with points, their parents, and these cells' corners with some more."""
    rng = np.random.default_rng(5)
    children = unique_keys(pack_places(rng.integers(-5, 6, (60, 3))))
    counts = rng.integers(1, 30, len(children)).astype(float)
    parents = unique_keys(pack_places(unpack_keys(children) >> 1))
    return children, counts, parents, spread_keys(parents, -1, 2)


def points_around(level: LevelCounts, vertex: np.int64) -> FloatArray:
    """Return the finer counts in the eight cells around a vertex."""
    children, counts, _, _ = level
    steps = (unpack_keys(children) >> 1) - unpack_keys(np.asarray(vertex))
    values: FloatArray = counts[((steps == 0) | (steps == -1)).all(axis=1)]
    return values


def test_squares_are_summed_by_parent(
    level: LevelCounts,
) -> None:
    children, counts, parents, _ = level
    squares = sum_squares(children, counts, parents)
    owners = pack_places(unpack_keys(children) >> 1)
    expected = [(counts[owners == parent] ** 2).sum() for parent in parents]
    np.testing.assert_array_equal(squares, expected)


def test_crowds_are_what_a_point_meets_in_its_finer_cell(
    level: LevelCounts,
) -> None:
    children, counts, parents, vertices = level
    around = [points_around(level, vertex) for vertex in vertices]
    totals = np.array([n.sum() for n in around], np.float32)
    crowds = crowd_vertices(vertices, totals, parents, sum_squares(children, counts, parents))
    # Each of n points in a cell meets n - 1 others.
    expected = [(n * (n - 1)).sum() / n.sum() if len(n) else np.inf for n in around]
    assert np.isinf(expected).any()
    np.testing.assert_allclose(crowds, expected, atol=1e-12)


def test_single_points_meet_nobody() -> None:
    cell = pack_places(np.array([[0, 0, 0]]))
    corners = spread_keys(cell, 0, 1)
    counts = np.ones(len(corners), np.float32)
    assert (crowd_vertices(corners, counts, cell, np.array([1.0])) == 0.0).all()


def test_points_surround_a_vertex_where_four_of_its_cells_hold_some(
    level: LevelCounts,
) -> None:
    _, _, cells, vertices = level
    places = unpack_keys(cells)
    steps = places - unpack_keys(vertices)[:, None]
    occupied = ((steps == 0) | (steps == -1)).all(axis=2).sum(axis=1)
    assert 0 < (occupied >= 4).sum() < len(vertices)
    np.testing.assert_array_equal(surrounded_vertices(vertices, cells), occupied >= 4)


def test_a_sheet_surrounds_the_vertices_within_it_and_not_those_at_its_rim() -> None:
    x, y = (axis.ravel() for axis in np.mgrid[:4, :4])
    cells = unique_keys(pack_places(np.stack([x, y, np.zeros_like(x)], axis=1)))
    vertices = spread_keys(cells, 0, 1)
    inner = ((unpack_keys(vertices)[:, :2] % 4) > 0).all(axis=1)
    np.testing.assert_array_equal(surrounded_vertices(vertices, cells), inner)
