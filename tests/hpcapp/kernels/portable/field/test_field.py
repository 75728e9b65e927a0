from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hpcapp.geometry.lattice import OCTANTS, pack_places, unpack_keys
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.kernels.portable.field.field import (
    HULL_REACH,
    blend_quadrics,
    evaluate_bricks,
    interpolate_far,
    needed_layers,
)
from hpcapp.kernels.types.field import FarField, Field, FieldLevel
from hpcapp.kernels.types.grid import BRICK, NODES, Grid

GRID = Grid(np.array([-0.31, 0.12, 1.07]), 0.05, (4, 3, 4))
CELL_SIZES = [0.4, 0.13, 0.05, 0.008]  # wider than a brick, to finer than the grid


@pytest.fixture(params=CELL_SIZES)
def field(request: pytest.FixtureRequest) -> Field:
    """Random quadrics and trust on two lattices with holes, over a random far field."""
    rng = np.random.default_rng(11)
    cell_size = request.param
    levels = tuple(random_level(rng, cell_size * scale) for scale in (1.0, 2.0))
    far = FarField(rng.normal(size=(32, 32, 32)).astype(np.float32), GRID.origin - 0.3, 0.08)
    return Field(GRID.origin - 0.07, cell_size, levels, far)


def random_level(rng: np.random.Generator, cell_size: float) -> FieldLevel:
    extent = int(1.7 / cell_size) + 2
    places = rng.integers(-1, extent, (2000 if extent < 100 else 60_000, 3))
    keys = np.unique(pack_places(places))
    coefficients = rng.normal(size=(len(keys), 10)).astype(np.float32)
    return FieldLevel(keys, coefficients, rng.uniform(0, 1, len(keys)).astype(np.float32))


def plain_value(
    field: Field, vertices: list[dict[tuple[int, int, int], int]], position: FloatArray
) -> float:
    """The definition, level by level and corner by corner."""
    places = (position - field.far.origin) / field.far.step
    low = np.floor(places).astype(int)
    value = sum(
        np.prod(np.where(o, places - low, 1 - (places - low))) * field.far.values[tuple(low + o)]
        for o in OCTANTS
    )
    value /= field.cell_size
    for depth in reversed(range(len(field.levels))):
        quadric, presence, trust = plain_sums(field, depth, vertices[depth], position)
        if presence:
            value = trust * 2**depth * quadric / presence + (1 - trust) * value
    values: float = value
    return values


def plain_sums(
    field: Field, depth: int, vertices: dict[tuple[int, int, int], int], position: FloatArray
) -> FloatArray:
    """Weighted sums over the eight corners around a place."""
    coordinates = (position - field.origin) / (field.cell_size * 2**depth)
    cell = np.floor(coordinates)
    sums = np.zeros(3)
    for octant in OCTANTS:
        row = vertices.get(tuple((cell + octant).astype(int).tolist()))
        if row is None:
            continue
        x, y, z = coordinates - cell - octant
        t = np.where(octant, coordinates - cell, 1 - (coordinates - cell))
        weight = np.prod(t * t * (3 - 2 * t))
        basis = np.array([1, x, y, z, x * x, y * y, z * z, x * y, y * z, z * x])
        c = field.levels[depth].channels()[:, row]
        sums += weight * np.array([basis @ c[:10], 1.0, c[11]])
    return sums


def test_values_are_what_the_definition_says(field: Field) -> None:
    places = np.array([[1, 1, 1], [2, 1, 2]])
    values = evaluate_bricks(field, GRID, places)
    vertices = [
        {tuple(p): i for i, p in enumerate(unpack_keys(level.keys).tolist())}
        for level in field.levels
    ]
    rng = np.random.default_rng(0)
    for brick, *node in zip(rng.integers(0, 2, 60), *rng.integers(0, NODES, (3, 60)), strict=True):
        position = GRID.origin + GRID.step * (BRICK * places[brick] + node)
        expected = plain_value(field, vertices, position)
        assert values[(brick, *node)] == pytest.approx(expected, rel=1e-5, abs=1e-5)


def test_bricks_agree_bit_for_bit_on_what_they_share(field: Field) -> None:
    values = evaluate_bricks(field, GRID, np.array([[1, 1, 1], [2, 1, 1], [1, 2, 1], [1, 1, 2]]))
    assert np.array_equal(values[0, -1], values[1, 0])
    assert np.array_equal(values[0, :, -1], values[2, :, 0])
    assert np.array_equal(values[0, :, :, -1], values[3, :, :, 0])


def test_a_brick_does_not_depend_on_its_batch(field: Field) -> None:
    places = np.stack(np.meshgrid(*[np.arange(3)] * 3), axis=-1).reshape(-1, 3)
    whole = evaluate_bricks(field, GRID, places)
    assert np.array_equal(evaluate_bricks(field, GRID, places[13:14]), whole[13:14])
    assert np.array_equal(evaluate_bricks(field, GRID, places[::-1]), whole[::-1])


def test_the_outermost_nodes_are_outside_and_no_node_is_zero(field: Field) -> None:
    for level in field.levels:
        level.trust[:] = 0.0
    field.far.values[:] = -1.0
    places = np.stack(np.meshgrid(*[np.arange(n) for n in GRID.bricks], indexing="ij"), axis=-1)
    values = evaluate_bricks(field, GRID, places.reshape(-1, 3)).reshape(*GRID.bricks, *[NODES] * 3)
    assert (values[0, :, :, 0] > 0).all()
    assert (values[-1, :, :, -1] > 0).all()
    assert (values[:, :, 0, :, :, 0] > 0).all()
    assert (values[1:-1, 1:-1, 1:-1, 1:-1, 1:-1, 1:-1] < 0).all()
    field.far.values[:] = 0.0
    assert (evaluate_bricks(field, GRID, np.array([[1, 1, 1]])) > 0).all()


def test_beyond_a_plane_of_the_hull_all_is_outside(field: Field) -> None:
    places = np.array([[1, 1, 1], [2, 1, 2]])
    middle = GRID.origin + 0.5 * BRICK * GRID.step * np.array(GRID.bricks)
    normal = np.array([0.6, 0.0, -0.8])
    hull = np.array([[*normal, normal @ middle]])
    cut = replace(field, far=replace(field.far, hull=hull))
    ticks = np.stack(np.meshgrid(*[np.arange(NODES)] * 3, indexing="ij"), axis=-1)
    nodes = GRID.origin + GRID.step * (BRICK * places[:, None, None, None] + ticks)
    beyond = (nodes - middle) @ normal / field.cell_size
    before, after = (evaluate_bricks(some, GRID, places) for some in (field, cut))
    deep = beyond < -HULL_REACH * GRID.step / field.cell_size
    expected = np.where(deep, before, np.maximum(before, beyond))
    np.testing.assert_allclose(after, expected, 1e-5, 1e-5)


def level_of_height(height: float, cells: int) -> FieldLevel:
    """One constant, at every vertex of a dense lattice."""
    places = np.stack(np.meshgrid(*[np.arange(-2, cells)] * 3, indexing="ij"), axis=-1)
    keys = np.unique(pack_places(places.reshape(-1, 3)))
    coefficients = np.zeros((len(keys), 10), np.float32)
    coefficients[:, 0] = height
    return FieldLevel(keys, coefficients, np.ones(len(keys), np.float32))


def test_coarse_levels_fill_where_the_fine_one_is_not_trusted() -> None:
    far = FarField(np.full((4, 4, 4), 0.5, np.float32), GRID.origin, 1.0)
    fine, coarse = level_of_height(3.0, 14), level_of_height(-2.0, 8)
    field = Field(GRID.origin, 0.1, (fine, coarse), far)
    place = np.array([[1, 1, 1]])
    assert evaluate_bricks(field, GRID, place) == pytest.approx(3.0)
    fine.trust[:] = 0.25
    assert evaluate_bricks(field, GRID, place) == pytest.approx(0.25 * 3.0 - 0.75 * 4.0)
    coarse.trust[:] = 0.5
    expected = 0.25 * 3.0 + 0.75 * (0.5 * -4.0 + 0.5 * 5.0)
    assert evaluate_bricks(field, GRID, place) == pytest.approx(expected)


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
