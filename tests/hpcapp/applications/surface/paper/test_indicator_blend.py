from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from hpcapp.applications.surface.paper.indicator_blend import (
    NodeGrid,
    extract_iso_surface,
    plan_grid,
    sample_indicator_blend,
    settle_zeros,
)
from hpcapp.applications.surface.paper.kdtree import TreePatches
from hpcapp.applications.surface.paper.patch_quadrics import evaluate_quadrics
from hpcapp.applications.surface.stitching.topology import check_mesh, signed_volume
from hpcapp.geometry.points import FloatArray
from hpccomponent.errors import JobError, UsageError


def boxes(low: list[list[float]], high: list[list[float]]) -> TreePatches:
    corners = np.array(low, float), np.array(high, float)
    return TreePatches(np.arange(len(low)), np.arange(len(low) + 1), *corners)


def positions_of(nodes: NodeGrid) -> FloatArray:
    values: FloatArray = nodes.low + nodes.step * np.stack(list(np.indices(nodes.shape)), axis=-1)
    return values


def ignore(done: int, total: int) -> None:
    pass


# Two cubes that share the face x = 2, and a third away from them.
PATCHES = boxes([[0, 0, 0], [2, 0, 0], [6, 2, 0]], [[2, 2, 2], [4, 2, 2], [8, 4, 2]])
QUADRICS = np.random.default_rng(11).normal(size=(3, 10))


def test_grid_has_its_cells_along_the_longest_side_and_a_margin() -> None:
    nodes = plan_grid(PATCHES, 16)
    assert nodes.step == 0.5
    assert nodes.shape == (16 + 5, 8 + 5, 4 + 5)
    assert nodes.low.tolist() == [-1.0, -1.0, -1.0]


def test_one_box_gives_its_quadric_and_several_their_mean() -> None:
    nodes = plan_grid(PATCHES, 16)
    values = sample_indicator_blend(PATCHES, QUADRICS, nodes, ignore)

    x = positions_of(nodes).reshape(-1, 3)
    expected, boxes_here = np.zeros(len(x)), np.zeros(len(x))
    for i in range(len(PATCHES)):
        inside = ((x >= PATCHES.box_low[i]) & (x <= PATCHES.box_high[i])).all(axis=1)
        local = (x[inside] - PATCHES.centers[i]) / PATCHES.scales[i]
        expected[inside] += evaluate_quadrics(QUADRICS[i], local)
        boxes_here[inside] += 1
    assert boxes_here.max() == 2
    assert not values.ravel()[boxes_here == 0].any()
    assert np.allclose(values.ravel(), expected / np.maximum(boxes_here, 1), atol=1e-6)


def test_faces_count_for_both_boxes_in_spite_of_rounding() -> None:
    third = 1.0 / 3.0
    patches = boxes(
        [[0.1, 0, 0], [0.1 + third, 0, 0]], [[0.1 + third, third, third], [1.1, third, third]]
    )
    constants = np.zeros((2, 10))
    constants[:, 0] = 1.0, 3.0
    nodes = plan_grid(patches, 30)
    values = sample_indicator_blend(patches, constants, nodes, ignore)
    assert values[12, 5, 5] == 2.0


def test_boxes_between_nodes_add_nothing() -> None:
    patches = boxes([[0, 0, 0], [0.1, 0.1, 0.1]], [[8, 8, 8], [0.2, 0.2, 0.2]])
    nodes = plan_grid(patches, 8)
    both = sample_indicator_blend(patches, np.ones((2, 10)), nodes, ignore)
    first = sample_indicator_blend(boxes([[0, 0, 0]], [[8, 8, 8]]), np.ones((1, 10)), nodes, ignore)
    assert np.array_equal(both, first)


def test_progress_ends_with_all_boxes() -> None:
    told = []
    nodes = plan_grid(PATCHES, 4)
    sample_indicator_blend(PATCHES, QUADRICS, nodes, lambda *counts: told.append(counts))
    assert told[-1] == (3, 3)


def test_settled_values_are_never_zero_and_keep_every_clear_sign() -> None:
    values = np.random.default_rng(12).normal(size=(20, 20, 20)).astype(np.float32)
    before = values.copy()
    values[:10] = 0.0
    settle_zeros(values)
    assert (values[:10] > 0.0).all()
    clear = np.abs(before[10:]) > 1e-3
    assert np.array_equal(values[10:][clear], before[10:][clear])
    assert np.abs(values).min() > 1e-6


def test_settled_zeros_everywhere_are_outside() -> None:
    values = np.zeros((3, 3, 3), np.float32)
    settle_zeros(values)
    assert (values > 0.0).all()


def test_a_settled_blend_has_no_open_edge() -> None:
    nodes = plan_grid(PATCHES, 24)
    values = sample_indicator_blend(PATCHES, QUADRICS, nodes, ignore)
    assert np.mean(values == 0.0) > 0.02
    settle_zeros(values)
    topology = check_mesh(extract_iso_surface(values, nodes))
    assert topology.boundary_edges == 0
    assert topology.outward


def test_what_cannot_be_sampled_is_named() -> None:
    with pytest.raises(UsageError, match="grid is 0"):
        plan_grid(PATCHES, 0)
    with pytest.raises(JobError, match="coincide"):
        plan_grid(boxes([[1, 1, 1]], [[1, 1, 1]]), 64)


NODES = NodeGrid(np.array([-1.3, -1.25, 4.0]), 0.05, (53, 52, 54))
CENTER, RADIUS = np.array([0.0, 0.0, 5.3]), 1.0


def sphere() -> NDArray[np.float32]:
    values: NDArray[np.float32] = np.linalg.norm(positions_of(NODES) - CENTER, axis=-1) - RADIUS
    return values.astype(np.float32)


def test_sphere_is_where_it_should_be_and_looks_outward() -> None:
    mesh = extract_iso_surface(sphere(), NODES, np.array([1e6, 0.0, 0.0]))
    radii = np.linalg.norm(mesh.vertices - CENTER, axis=1)
    assert np.abs(radii - RADIUS).max() < 0.02 * NODES.step
    # A polyhedron with its corners on the sphere is smaller than the ball, by little.
    ball = 4.0 / 3.0 * np.pi * RADIUS**3
    assert 0.99 * ball < signed_volume(mesh) < ball
    assert mesh.origin.tolist() == [1e6, 0.0, 0.0]


def test_sphere_is_watertight_and_in_one_piece() -> None:
    topology = check_mesh(extract_iso_surface(sphere(), NODES))
    assert topology.watertight
    assert topology.components == 1
    assert topology.genus == 0


@pytest.mark.parametrize("value", [1.0, -1.0, 0.0])
def test_one_sign_only_is_an_empty_surface(value: float) -> None:
    with pytest.raises(JobError, match="the surface is empty; use a finer grid"):
        extract_iso_surface(np.full(NODES.shape, value, np.float32), NODES)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_not_finite_are_not_meshed_silently(value: float) -> None:
    values = sphere()
    values[3, 4, 5] = value
    with pytest.raises(JobError, match="not finite"):
        extract_iso_surface(values, NODES)
