"""The levels of a field are the same however many vertices are fitted at a time."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from directions import random_directions

from hpcapp.applications.surface.field import levels as field_levels
from hpcapp.applications.surface.field.levels import SlabFields, find_trust, fit_above
from hpcapp.applications.surface.field.pyramid import (
    Pyramid,
    build_pyramid,
    count_levels,
    fit_levels,
)
from hpcapp.applications.surface.field.weights import weigh_levels
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.lattice import unpack_keys
from hpcapp.geometry.points import PointCloud
from hpcapp.kernels.types.field import FarField
from hpcapp.kernels.types.grid import Grid

CELL_SIZE = 0.06


def build() -> Pyramid:
    """Return the pyramid of a sphere with noise."""
    random = np.random.default_rng(3)
    directions = random_directions(6_000, random)
    cloud = PointCloud(random.normal(1.0, 0.005, (6_000, 1)) * directions, directions)
    low, high = bound_points(cloud.positions)
    return build_pyramid(cloud, low, CELL_SIZE, count_levels(float((high - low).max()), CELL_SIZE))


def far_field() -> FarField:
    """Return a far field that is right outside a ball of half the size, and wrong inside."""
    step = 0.125
    places = step * (np.stack(np.meshgrid(*[np.arange(20)] * 3, indexing="ij"), -1)) - 1.2
    values = np.linalg.norm(places, axis=-1) - 0.97
    return FarField(values.astype(np.float32), np.full(3, -1.2), step)


@pytest.mark.parametrize("tolerance", [np.inf, 0.01])
@pytest.mark.parametrize("at_once", [1, 3_000, 1 << 30])
def test_runs_of_vertices_do_not_show(
    monkeypatch: pytest.MonkeyPatch, tolerance: float, at_once: int
) -> None:
    whole, far = build(), far_field()
    weights = weigh_levels(CELL_SIZE, whole.height, 0.005, tolerance)
    quadrics, _ = fit_levels(whole, weights)
    expected = find_trust(whole, quadrics, far)
    monkeypatch.setattr(field_levels, "_AT_ONCE", at_once)
    pyramid = build()
    runs = len(field_levels._cut_layers(pyramid.vertices[0]))
    layers = int(np.ptp(pyramid.vertices[0] >> 42)) + 1
    assert runs == {1: layers, 1 << 30: 1}.get(at_once, runs)
    assert at_once != 3_000 or 3 < runs < layers
    above, features, parents = fit_above(pyramid, weights, None, far)
    assert len(pyramid.levels) == 1  # nobody needs the others any more
    grid = Grid(np.full(3, -1.3), 0.05, (7, 7, 7))
    fields = SlabFields(pyramid, weights, parents, above, features, far, grid)
    found = fields.fit(0, 7).levels
    assert len(found) == len(expected) > 1
    for one, other in zip(found, expected, strict=True):
        assert one.keys.tolist() == other.keys.tolist()
        assert one.coefficients.tobytes() == other.coefficients.tobytes()
        assert one.trust.tobytes() == other.trust.tobytes()
    assert 0.0 < found[0].trust.min(initial=1.0, where=found[0].trust > 0.0) < 1.0


@pytest.mark.parametrize("quadrics", [1, 4_000, 10_000, 1 << 30])
def test_slabs_have_the_quadrics_around_their_bricks(quadrics: int) -> None:
    pyramid, far = build(), far_field()
    weights = weigh_levels(CELL_SIZE, pyramid.height, 0.005, np.inf)
    above, features, parents = fit_above(pyramid, weights, None, far)
    grid = Grid(np.full(3, -1.3), 0.0125, (26, 26, 26))
    fields = SlabFields(pyramid, weights, parents, above, features, far, grid)
    whole = fields.fit(0, 26).levels[0]
    bounds = fields.cut(0, 26, quadrics)
    assert len(bounds) == {1: 4, 4_000: 4, 10_000: 3, 1 << 30: 2}[quadrics]
    for first, end in pairwise(bounds):
        level = fields.fit(first, end).levels[0]
        low, high = -1.3 + 0.1 * np.array([first, end])  # where its nodes lie
        places = pyramid.origin[0] + CELL_SIZE * unpack_keys(whole.keys)[:, 0]
        near = np.flatnonzero((places > low - CELL_SIZE) & (places < high + CELL_SIZE))
        rows = np.searchsorted(level.keys, whole.keys[near])
        assert np.array_equal(level.keys[rows], whole.keys[near])
        assert level.coefficients[rows].tobytes() == whole.coefficients[near].tobytes()
        assert level.trust[rows].tobytes() == whole.trust[near].tobytes()


def test_a_field_without_points_is_one_slab() -> None:
    none = np.empty(0, np.int64)
    pyramid = Pyramid(np.zeros(3), CELL_SIZE, [], [none], 0, 3)
    grid = Grid(np.full(3, -1.3), 0.05, (7, 7, 7))
    fields = SlabFields(pyramid, [], None, (), (), far_field(), grid)
    assert fields.cut(2, 5, 1000) == [2, 5]
    (finest,) = fields.fit(2, 5).levels
    assert finest.coefficients.shape == (0, 10)
