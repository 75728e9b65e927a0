"""Where bricks of different strides meet the surface is closed, whatever the strides and signs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fixture_types import BrickFunction, BrickValues
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hpcapp.applications.surface.stitching.topology import check_mesh, signed_volume
from hpcapp.geometry.lattice import pack_places
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import Float32Array, FloatArray, IntArray
from hpcapp.kernels.portable.field.strides import fill_missing, line_shifts
from hpcapp.kernels.portable.surface.balance import balance_vertices
from hpcapp.kernels.portable.surface.bricks import grow_bricks
from hpcapp.kernels.portable.surface.marching_cubes import extract_surface
from hpcapp.kernels.types.brick_mesh import BrickMesh
from hpcapp.kernels.types.grid import (
    BRICK,
    FOREIGN,
    MOST_SHIFT,
    OWN,
    BrickKinds,
    BrickStrides,
    Grid,
)

Bricks = tuple[int, int, int]


def places_of(bricks: Bricks) -> IntArray:
    return np.stack(np.meshgrid(*map(np.arange, bricks), indexing="ij"), axis=-1).reshape(-1, 3)


def random_strides(rng: np.random.Generator, bricks: Bricks) -> BrickStrides:
    """Return strides of all bricks, of which some are more common than others."""
    keys = pack_places(places_of(bricks))
    shares = rng.dirichlet([0.7] * (MOST_SHIFT + 1))
    exponents = rng.choice(MOST_SHIFT + 1, len(keys), p=shares).astype(np.uint8)
    return BrickStrides(keys, exponents)


def extract(grid: Grid, nodes: Float32Array) -> BrickMesh:
    """Extract the surface from an array of all nodes of the finest lattice."""
    places = places_of(grid.bricks)
    windows = np.lib.stride_tricks.sliding_window_view(nodes, (BRICK + 1,) * 3)
    values = fill_missing(windows[tuple((BRICK * places).T)], line_shifts(grid, places))
    return extract_surface(grid, places, values)


def assert_manifold(mesh: BrickMesh) -> None:
    found = check_mesh(Mesh(mesh.vertices, mesh.faces))
    assert found.watertight or not len(mesh.faces)
    assert found.oriented


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.05, 0.3, 0.5, 0.8]))
def test_random_signs_give_a_closed_manifold_whatever_the_strides(seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    bricks = (2, 3, 2)
    side = tuple(BRICK * n + 1 for n in bricks)
    nodes = rng.uniform(0.01, 1.0, side).astype(np.float32)
    inner = nodes[1:-1, 1:-1, 1:-1]
    inner *= np.where(rng.random(inner.shape) < share, -1, 1)
    assert_manifold(extract(Grid(np.zeros(3), 0.5, bricks, random_strides(rng, bricks)), nodes))


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_smooth_functions_give_a_closed_manifold_whatever_the_strides(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bricks = (3, 2, 3)
    points = np.stack(np.meshgrid(*[np.arange(BRICK * n + 1) for n in bricks], indexing="ij"), -1)
    waves = rng.normal(0.0, 2.0 / rng.choice([2.0, 4.0, 8.0, 16.0]), (6, 3))
    level, phases = rng.uniform(-1.0, 1.0), rng.uniform(0.0, 6.3, 6)
    nodes = (np.sin(points @ waves.T + phases).sum(axis=-1) - level).astype(np.float32)
    for axis in range(3):
        outer = np.moveaxis(nodes, axis, 0)
        outer[[0, -1]] = np.abs(outer[[0, -1]])
    nodes[nodes == 0.0] = 1e-30
    assert_manifold(extract(Grid(np.zeros(3), 0.5, bricks, random_strides(rng, bricks)), nodes))


def test_a_node_that_only_a_neighbour_across_an_edge_has_is_closed_too() -> None:
    """Around an edge of bricks three are one cell; a node of the fourth, on the edge, is inside."""
    keys = pack_places(places_of((2, 2, 1)))
    strides = BrickStrides(keys, np.array([0, 3, 3, 3], np.uint8))
    nodes = np.ones((17, 17, 9), np.float32)
    nodes[8, 8, 5] = -1.0
    mesh = extract(Grid(np.zeros(3), 1.0, (2, 2, 1), strides), nodes)
    assert_manifold(mesh)
    assert mesh.face_counts.tolist()[-1] == 0  # its loop has two vertices
    assert len(mesh.vertices) == 4
    np.testing.assert_allclose(signed_volume(Mesh(mesh.vertices, mesh.faces)), 1 / 24)


def grow(evaluate: BrickFunction, grid: Grid) -> BrickMesh:
    """Grow from all bricks, of a function that is given at the nodes of the finest lattice."""
    kinds = BrickKinds(np.zeros(3, np.int64), np.full(grid.bricks, OWN, np.uint8))

    def at_nodes(places: IntArray) -> Float32Array:
        return fill_missing(evaluate(places), line_shifts(grid, places))

    return extract_surface(grid, *grow_bricks(at_nodes, kinds, grid.bricks, grid.strides)[:3])


@pytest.fixture
def grid() -> Grid:
    grid = Grid(np.array([-1.0, -1.0, -1.0]), 1 / 32, (8, 8, 8))
    return replace(grid, strides=random_strides(np.random.default_rng(7), grid.bricks))


def distance(points: FloatArray) -> FloatArray:
    lengths: FloatArray = np.linalg.norm(points, axis=-1) - 0.7
    return lengths


def test_a_sphere_lies_where_it_does_to_each_cells_size(
    brick_values: BrickValues, grid: Grid
) -> None:
    mesh = grow(brick_values(distance, grid), grid)
    assert_manifold(mesh)
    assert grid.strides is not None
    # A straight line along an edge errs by up to h^2 / (8 R), and clamping by 0.002 h.
    size = grid.step * 2.0 ** np.repeat(grid.strides.at(mesh.bricks), mesh.vertex_counts)
    assert (np.abs(distance(mesh.vertices)) < size**2 / (8 * 0.7) + 0.002 * size).all()
    ball = 4 / 3 * np.pi * 0.7**3
    flat = signed_volume(Mesh(mesh.vertices, mesh.faces))
    assert 0.95 * ball < flat < ball
    exponents = np.repeat(grid.strides.at(mesh.bricks), mesh.face_counts)
    balanced = balance_vertices(mesh.vertices, mesh.faces, grid.step, exponents)
    assert abs(signed_volume(Mesh(balanced, mesh.faces)) - ball) < 0.3 * abs(flat - ball)


@pytest.mark.parametrize("shift", range(MOST_SHIFT + 1))
def test_one_stride_everywhere_is_a_coarser_grid(brick_values: BrickValues, shift: int) -> None:
    fine = Grid(np.array([-1.0, -1.0, -1.0]), 1 / 32, (8, 8, 8))
    keys = pack_places(places_of(fine.bricks))
    strides = BrickStrides(keys, np.full(len(keys), shift, np.uint8))
    mesh = grow(brick_values(distance, fine), replace(fine, strides=strides))
    bricks = fine.bricks[0] >> shift
    coarse = Grid(fine.origin, fine.step * 2**shift, (bricks, bricks, bricks))
    kinds = BrickKinds(np.zeros(3, np.int64), np.full(coarse.bricks, OWN, np.uint8))
    grown = grow_bricks(brick_values(distance, coarse), kinds, coarse.bricks)
    wanted = extract_surface(coarse, *grown[:3])
    assert len(mesh.faces) == len(wanted.faces)
    assert len(mesh.vertices) == len(wanted.vertices)
    if shift < 2:  # lines have four nodes in a brick
        areas = [signed_volume(Mesh(m.vertices, m.faces)) for m in (mesh, wanted)]
        np.testing.assert_allclose(areas[0], areas[1], rtol=1e-4)


def test_strides_of_one_are_no_strides(brick_values: BrickValues) -> None:
    plain = Grid(np.array([-1.0, -1.0, -1.0]), 1 / 16, (4, 4, 4))
    keys = pack_places(places_of(plain.bricks))
    ones = replace(plain, strides=BrickStrides(keys, np.zeros(len(keys), np.uint8)))
    kinds = BrickKinds(np.zeros(3, np.int64), np.full(plain.bricks, OWN, np.uint8))
    wanted = extract_surface(
        plain, *grow_bricks(brick_values(distance, plain), kinds, plain.bricks)[:3]
    )
    found = grow(brick_values(distance, ones), ones)
    for name in ("bricks", "vertex_counts", "face_counts", "vertices", "faces"):
        np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name))


def test_a_rim_is_whole_seven_faces_deep(brick_values: BrickValues, grid: Grid) -> None:
    """What a tile takes has all faces around it that its vertices' places depend on."""
    evaluate = brick_values(distance, grid)
    whole = grow(evaluate, grid)
    kinds = np.full(grid.bricks, FOREIGN, np.uint8)
    kinds[:3] = OWN

    def at_nodes(places: IntArray) -> NDArray[np.float32]:
        return fill_missing(evaluate(places), line_shifts(grid, places))

    given = BrickKinds(np.zeros(3, np.int64), kinds)
    mesh = extract_surface(grid, *grow_bricks(at_nodes, given, grid.bricks, grid.strides)[:3])
    assert len(mesh.faces) < len(whole.faces)
    assert grid.strides is not None

    def balance(of: BrickMesh) -> FloatArray:
        assert grid.strides is not None
        exponents = np.repeat(grid.strides.at(of.bricks), of.face_counts)
        return balance_vertices(of.vertices, of.faces, grid.step, exponents)

    own = np.repeat(mesh.taken, mesh.vertex_counts)
    same = np.repeat(np.isin(whole.bricks, mesh.bricks[mesh.taken]), whole.vertex_counts)
    np.testing.assert_array_equal(balance(mesh)[own], balance(whole)[same])
