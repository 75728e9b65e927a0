import numpy as np
import pytest

from hpccomponent.surface.blending import NODES
from hpccomponent.surface.far_field import FarField
from hpccomponent.surface.field import BRICK, Field, Grid, evaluate_bricks
from hpccomponent.surface.lattice import OCTANTS, pack_places, unpack_keys

GRID = Grid(np.array([-0.31, 0.12, 1.07]), 0.05, (4, 3, 4))
CELL_SIZES = [0.4, 0.13, 0.05, 0.008]  # wider than a brick, to finer than the grid


@pytest.fixture(params=CELL_SIZES)
def field(request):
    """Random quadrics and trust on a lattice with holes, over a random far field."""
    rng = np.random.default_rng(11)
    cell_size = request.param
    extent = int(1.7 / cell_size) + 2
    places = rng.integers(-1, extent, (2000 if extent < 100 else 60_000, 3))
    keys = np.unique(pack_places(places))
    coefficients = rng.normal(size=(len(keys), 10))
    trust = rng.uniform(0, 1, len(keys))
    far = FarField(rng.normal(size=(32, 32, 32)).astype(np.float32), GRID.origin - 0.3, 0.08)
    return Field(GRID.origin - 0.07, cell_size, keys, coefficients, trust, far)


def plain_value(field, vertices, position):
    """The definition, corner by corner."""
    coordinates = (position - field.origin) / field.cell_size
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
        c = field.channels()[:, row]
        sums += weight * np.array([basis @ c[:10], 1.0, c[11]])
    places = (position - field.far.origin) / field.far.step
    low = np.floor(places).astype(int)
    far = sum(
        np.prod(np.where(o, places - low, 1 - (places - low))) * field.far.values[tuple(low + o)]
        for o in OCTANTS
    )
    far /= field.cell_size
    if sums[1] == 0:
        return far
    return sums[2] * sums[0] / sums[1] + (1 - sums[2]) * far


def test_values_are_what_the_definition_says(field):
    places = np.array([[1, 1, 1], [2, 1, 2]])
    values = evaluate_bricks(field, GRID, places)
    vertices = {tuple(p): i for i, p in enumerate(unpack_keys(field.keys).tolist())}
    rng = np.random.default_rng(0)
    for brick, *node in zip(rng.integers(0, 2, 60), *rng.integers(0, NODES, (3, 60)), strict=True):
        position = GRID.origin + GRID.step * (BRICK * places[brick] + node)
        expected = plain_value(field, vertices, position)
        assert values[(brick, *node)] == pytest.approx(expected, rel=1e-5, abs=1e-5)


def test_bricks_agree_bit_for_bit_on_what_they_share(field):
    values = evaluate_bricks(field, GRID, np.array([[1, 1, 1], [2, 1, 1], [1, 2, 1], [1, 1, 2]]))
    assert np.array_equal(values[0, -1], values[1, 0])
    assert np.array_equal(values[0, :, -1], values[2, :, 0])
    assert np.array_equal(values[0, :, :, -1], values[3, :, :, 0])


def test_a_brick_does_not_depend_on_its_batch(field):
    places = np.stack(np.meshgrid(*[np.arange(3)] * 3), axis=-1).reshape(-1, 3)
    whole = evaluate_bricks(field, GRID, places)
    assert np.array_equal(evaluate_bricks(field, GRID, places[13:14]), whole[13:14])
    assert np.array_equal(evaluate_bricks(field, GRID, places[::-1]), whole[::-1])


def test_the_outermost_nodes_are_outside_and_no_node_is_zero(field):
    field.coefficients[:] = 0.0
    field.trust[:] = 0.0
    field.far.values[:] = -1.0
    places = np.stack(np.meshgrid(*[np.arange(n) for n in GRID.bricks], indexing="ij"), axis=-1)
    values = evaluate_bricks(field, GRID, places.reshape(-1, 3)).reshape(*GRID.bricks, *[NODES] * 3)
    assert (values[0, :, :, 0] > 0).all()
    assert (values[-1, :, :, -1] > 0).all()
    assert (values[:, :, 0, :, :, 0] > 0).all()
    assert (values[1:-1, 1:-1, 1:-1, 1:-1, 1:-1, 1:-1] < 0).all()
    field.far.values[:] = 0.0
    assert (evaluate_bricks(field, GRID, np.array([[1, 1, 1]])) > 0).all()
