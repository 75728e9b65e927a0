"""The levels of a field are the same however many vertices are fitted at a time."""

from __future__ import annotations

import numpy as np
import pytest

from hpccomponent.surface import field_levels
from hpccomponent.surface.far_field import FarField
from hpccomponent.surface.field_levels import find_trust, fit_field
from hpccomponent.surface.points import PointCloud, bounding_box
from hpccomponent.surface.pyramid import Pyramid, build_pyramid, count_levels, fit_levels
from hpccomponent.surface.weights import weigh_levels

CELL_SIZE = 0.06


def build() -> Pyramid:
    """Return the pyramid of a sphere with noise."""
    random = np.random.default_rng(3)
    directions = random.normal(size=(6_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    cloud = PointCloud(random.normal(1.0, 0.005, (6_000, 1)) * directions, directions)
    low, high = bounding_box(cloud.positions)
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
    runs = len(field_levels._cut_layers(pyramid.vertices[0])) - 1
    layers = int(np.ptp(pyramid.vertices[0] >> 42)) + 1
    assert runs == {1: layers, 1 << 30: 1}.get(at_once, runs)
    assert at_once != 3_000 or 3 < runs < layers
    found = fit_field(pyramid, weights, None, far)
    assert len(found) == len(expected) > 1
    for one, other in zip(found, expected, strict=True):
        assert one.keys.tolist() == other.keys.tolist()
        assert one.coefficients.tobytes() == other.coefficients.tobytes()
        assert one.trust.tobytes() == other.trust.tobytes()
    assert 0.0 < found[0].trust.min(initial=1.0, where=found[0].trust > 0.0) < 1.0
    assert not pyramid.levels  # nobody needs their points any more
