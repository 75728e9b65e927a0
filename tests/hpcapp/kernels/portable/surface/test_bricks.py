from __future__ import annotations

import numpy as np
import pytest
from fixture_types import BrickFunction, BrickValues
from numpy.typing import NDArray

from hpcapp.geometry.lattice import pack_places, unpack_keys
from hpcapp.geometry.points import BoolArray, IntArray
from hpcapp.kernels.portable.surface.bricks import grow_bricks, seed_bricks
from hpcapp.kernels.types.grid import BESIDE, FOREIGN, OPEN, OUT, OWN, BrickKinds, Grid

GRID = Grid(np.zeros(3), 0.125, (6, 6, 5))  # bricks of unit edge


@pytest.fixture
def sphere(
    brick_values: BrickValues,
) -> BrickFunction:
    centre, radius = np.array([2.9, 3.1, 2.4]), 1.9
    return brick_values(lambda p: np.linalg.norm(p - centre, axis=-1) - radius, GRID)


def open_kinds(seeds: IntArray) -> BrickKinds:
    """Let everything be taken, from some seeds on."""
    kinds = np.full(GRID.bricks, OPEN, np.uint8)
    kinds[tuple(unpack_keys(seeds).T)] = OWN
    return BrickKinds(np.zeros(3, np.int64), kinds)


def all_places() -> IntArray:
    return np.stack(np.meshgrid(*map(np.arange, GRID.bricks), indexing="ij"), axis=-1).reshape(
        -1, 3
    )


def crossed(values: NDArray[np.float32]) -> BoolArray:
    inside = (values < 0).reshape(len(values), -1)
    return np.logical_and(inside.any(axis=1), ~inside.all(axis=1))


def test_a_brick_that_holds_a_point_is_seeded() -> None:
    points = np.array([[0.5, 0.5, 0.5], [0.9, 0.1, 0.2], [5.5, 5.9, 4.1]])
    assert np.array_equal(seed_bricks(GRID, points), pack_places(np.array([[0, 0, 0], [5, 5, 4]])))


def test_one_seed_finds_every_brick_that_the_surface_crosses(
    sphere: BrickFunction,
) -> None:
    seed = seed_bricks(GRID, np.array([[2.9, 3.1, 4.3]]))
    places, values, taken, exits = grow_bricks(sphere, open_kinds(seed), GRID.bricks)
    assert taken.all()
    assert not len(exits)
    everywhere = all_places()
    expected = everywhere[crossed(sphere(everywhere))]
    found = {tuple(p) for p in places[crossed(values)].tolist()}
    assert found == {tuple(p) for p in expected.tolist()}
    assert np.array_equal(values, sphere(places))
    assert (np.diff(pack_places(places)) > 0).all()


def test_the_result_does_not_depend_on_the_seeds(
    sphere: BrickFunction,
) -> None:
    seeds = [seed_bricks(GRID, np.array([point])) for point in ([2.9, 3.1, 4.3], [1.01, 3.1, 2.4])]
    found: list[tuple[NDArray[np.generic], ...]] = [
        grow_bricks(sphere, open_kinds(seed), GRID.bricks) for seed in seeds
    ]
    assert all(np.array_equal(a, b) for a, b in zip(*found, strict=True))


def test_a_seed_away_from_the_surface_stays_alone(
    sphere: BrickFunction,
) -> None:
    seed = seed_bricks(GRID, np.array([[2.9, 3.1, 2.4]]))
    places, *_ = grow_bricks(sphere, open_kinds(seed), GRID.bricks)
    assert len(places) == 1


def test_growth_ends_at_the_grid(
    brick_values: BrickValues,
) -> None:
    """A function that is negative everywhere is closed by the outermost nodes."""
    evaluate = brick_values(lambda p: -np.ones(p.shape[:-1]), GRID)
    seeds = pack_places(np.array([[0, 0, 0]]))
    places, *_ = grow_bricks(evaluate, open_kinds(seeds), GRID.bricks)
    inner = np.prod(np.array(GRID.bricks) - 2)
    assert len(places) == np.prod(GRID.bricks) - inner
    assert (places >= 0).all()
    assert (places < GRID.bricks).all()


def test_a_tile_takes_what_is_open_and_leaves_the_rest_to_its_rim(
    sphere: BrickFunction,
) -> None:
    """Everything beyond x = 3 belongs to others; a layer before it has no points."""
    seed = seed_bricks(GRID, np.array([[1.01, 3.1, 2.4]]))
    kinds = open_kinds(seed)
    kinds.kinds[2] = BESIDE
    kinds.kinds[3:] = FOREIGN
    kinds.kinds[5:] = OUT
    places, values, taken, exits = grow_bricks(sphere, kinds, GRID.bricks)
    everywhere = all_places()
    surface = everywhere[crossed(sphere(everywhere))]
    expected = {tuple(p) for p in surface[surface[:, 0] < 2].tolist()}
    assert {tuple(p) for p in places[taken].tolist()} == expected
    assert {tuple(p) for p in places[~taken].tolist()} == {
        tuple(p) for p in surface[surface[:, 0] == 2].tolist()
    }
    assert set(unpack_keys(exits)[:, 0].tolist()) == {2}
    assert np.array_equal(values, sphere(places))
