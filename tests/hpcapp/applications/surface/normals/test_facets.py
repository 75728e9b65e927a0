"""Facets are exact sums: the same in whatever parts a cloud is gone through."""

from __future__ import annotations

import numpy as np
import pytest
from directions import random_directions

from hpcapp.applications.surface.cloud.measure import find_scale
from hpcapp.applications.surface.normals.facets import FacetShape, gather_facets, merge_facets
from hpcapp.geometry.points import FloatArray

LOW = np.full(3, -1.25)


def shape_of(positions: FloatArray, normals: FloatArray, edge: float = 0.2) -> FacetShape:
    scale = find_scale(positions)
    return FacetShape.of(gather_facets(positions, normals, LOW, edge), LOW, edge, scale)


def ball(count: int) -> FloatArray:
    unit = random_directions(count, 0)
    return unit.astype(np.float32).astype(np.float64)


@pytest.mark.parametrize("parts", [2, 7])
def test_parts_give_the_sums_of_the_whole_to_the_last_bit(parts: int) -> None:
    points = ball(5_000)
    whole = gather_facets(points, points, LOW, 0.2)
    order = np.random.default_rng(1).permutation(len(points))
    some = [points[rows] for rows in np.array_split(order, parts)]
    merged = merge_facets([gather_facets(one, one, LOW, 0.2) for one in some])
    assert merged.keys.tobytes() == whole.keys.tobytes()
    assert merged.sums.tobytes() == whole.sums.tobytes()


def test_nothing_is_missing_of_a_ball_and_half_of_it_of_a_dome() -> None:
    points = ball(20_000)
    for lowest, expected in ((-2.0, 0.0), (0.0, 0.5)):
        kept = points[points[:, 2] > lowest]
        shape = shape_of(kept, kept)
        np.testing.assert_allclose(shape.missing, [0.0, 0.0, -expected], atol=0.03)


def test_the_side_scanned_more_often_does_not_decide() -> None:
    points, dense = ball(20_000), ball(200_000)
    often = np.concatenate([points, dense[dense[:, 0] > 0.5]])
    shape = shape_of(often, often)
    assert np.abs(shape.missing).max() < 0.03


def test_both_sides_of_a_plate_are_facets_of_their_own() -> None:
    x, y = np.random.default_rng(2).uniform(0.0, 1.0, (2, 4_000))
    z = np.where(np.arange(4_000) % 2, 0.01, -0.01)
    normals = np.column_stack([np.zeros((4_000, 2)), np.sign(z)])
    shape = shape_of(np.column_stack([x, y, z]), normals, 0.25)
    assert set(shape.patches.normals[:, 2]) == {-1.0, 1.0}
