from __future__ import annotations

import numpy as np
import pytest

from hpccomponent.surface.kernels.portable.blending import (
    blend_quadrics,
    interpolate_far,
    needed_layers,
)
from hpccomponent.surface.types.grid import NODES
from hpccomponent.surface.types.points import FloatArray, IntArray

RNG = np.random.default_rng(8)


def rows_of_nodes(spacing: float, bricks: int = 3) -> tuple[IntArray, FloatArray]:
    """Return the layers below some evenly spaced nodes and their heights above these."""
    starts = RNG.uniform(0, 20, (3, bricks, 1))
    coordinates = starts + spacing * np.arange(NODES)
    lower = np.floor(coordinates)
    return lower.astype(np.int64), coordinates - lower


@pytest.mark.parametrize("spacing", [0.05, 0.7, 1.0, 2.6, 40.0])
def test_every_node_finds_its_two_layers(spacing: float) -> None:
    lower, _ = rows_of_nodes(spacing)
    layers, index = needed_layers(lower)
    assert layers.shape[2] <= 2 * NODES
    assert np.array_equal(np.take_along_axis(layers, index, axis=2), lower)
    assert np.array_equal(np.take_along_axis(layers, index + 1, axis=2), lower + 1)


def test_weights_add_up_to_one_where_no_vertex_is_missing() -> None:
    lower, local = rows_of_nodes(0.4)
    layers, index = needed_layers(lower)
    channels = np.zeros((12, 2))
    channels[10:, 0] = 1.0
    rows = np.zeros((3, *[layers.shape[2]] * 3), np.int64)
    _, presence, trust = blend_quadrics(channels, rows, index, local)
    np.testing.assert_allclose(presence, 1.0, rtol=1e-14)
    np.testing.assert_allclose(trust, 1.0, rtol=1e-14)


def test_vertices_that_share_one_function_give_it_back() -> None:
    """A plane, the same in the frame of every vertex but for its height above it."""
    lower, local = rows_of_nodes(0.3, bricks=1)
    layers, index = needed_layers(lower)
    corners = np.stack(np.meshgrid(*layers[:, 0], indexing="ij"), axis=-1).reshape(-1, 3)
    normal = np.array([0.6, -0.48, 0.64])
    channels = np.zeros((12, len(corners)))
    channels[0] = corners @ normal - 3.0
    channels[1:4] = normal[:, None]
    channels[10] = 1.0
    rows = np.arange(len(corners)).reshape(1, *[layers.shape[2]] * 3)
    quadric, _, _ = blend_quadrics(channels, rows, index, local)
    coordinates = np.meshgrid(*(lower + local)[:, 0], indexing="ij")
    expected = sum(n * c for n, c in zip(normal, coordinates, strict=True)) - 3.0
    np.testing.assert_allclose(quadric[0], expected, atol=1e-12)


def test_the_far_field_is_interpolated_linearly() -> None:
    lower, local = rows_of_nodes(0.35)
    x, y, z = np.indices((32, 32, 32), dtype=np.float32)
    values = interpolate_far(x - 2 * y + 3 * z, lower, local)
    places = lower + local
    for brick in range(3):
        px, py, pz = np.meshgrid(*places[:, brick], indexing="ij")
        np.testing.assert_allclose(values[brick], px - 2 * py + 3 * pz, atol=1e-10)


def test_beyond_the_far_field_its_border_goes_on() -> None:
    lower = np.full((3, 1, NODES), 100)
    values = interpolate_far(np.full((8, 8, 8), 2.0, np.float32), lower, np.zeros(lower.shape))
    assert (values == 2.0).all()
