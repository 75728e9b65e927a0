from __future__ import annotations

import numpy as np
import pytest
from fixture_types import BrickFunction, BrickValues
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hpcapp.applications.surface.stitching.topology import check_mesh, signed_volume
from hpcapp.geometry.lattice import pack_places, unpack_keys
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.kernels.portable.surface.balance import balance_vertices
from hpcapp.kernels.portable.surface.bricks import grow_bricks, seed_bricks
from hpcapp.kernels.portable.surface.marching_cubes import extract_surface
from hpcapp.kernels.types.grid import BRICK, OPEN, OWN, BrickKinds, Grid

GRID = Grid(np.array([-1.0, -1.0, -1.0]), 1 / 16, (4, 4, 4))


def cut_bricks(nodes: NDArray[np.float32]) -> tuple[IntArray, NDArray[np.float32]]:
    """Cut an array of node values into its bricks."""
    bricks = tuple((n - 1) // BRICK for n in nodes.shape)
    places = np.stack(np.meshgrid(*map(np.arange, bricks), indexing="ij"), axis=-1).reshape(-1, 3)
    windows = np.lib.stride_tricks.sliding_window_view(nodes, (BRICK + 1,) * 3)
    return places, windows[tuple((BRICK * places).T)]


def extract(
    grid: Grid, places: IntArray, values: NDArray[np.float32], *_: BoolArray | IntArray
) -> Mesh:
    """Extract the surface of whole bricks as a mesh."""
    found = extract_surface(grid, places, values)
    assert found.vertex_counts.sum() == len(found.vertices)
    assert found.face_counts.sum() == len(found.faces)
    return Mesh(found.vertices, found.faces)


def grow(evaluate: BrickFunction, seeds: IntArray) -> Mesh:
    """Grow from some bricks wherever the surface leads."""
    kinds = np.full(GRID.bricks, OPEN, np.uint8)
    kinds[tuple(unpack_keys(seeds).T)] = OWN
    return extract(GRID, *grow_bricks(evaluate, BrickKinds(np.zeros(3, int), kinds), GRID.bricks))


def assert_manifold(mesh: Mesh) -> None:
    found = check_mesh(mesh)
    assert found.watertight
    assert found.oriented


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.1, 0.3, 0.5, 0.8]))
def test_random_signs_give_a_closed_manifold_whatever_they_are(seed: int, share: float) -> None:
    """Each example holds 4,096 cells, most of them of the rare cases."""
    rng = np.random.default_rng(seed)
    nodes = rng.uniform(0.01, 1.0, (17, 17, 17)).astype(np.float32)
    nodes[1:-1, 1:-1, 1:-1] *= np.where(rng.random((15, 15, 15)) < share, -1, 1)
    assert_manifold(extract(Grid(np.zeros(3), 0.5, (2, 2, 2)), *cut_bricks(nodes)))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_smooth_functions_give_a_closed_manifold_over_bricks_that_grew(
    brick_values: BrickValues, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    waves, phases, level = rng.normal(0, 5, (6, 3)), rng.uniform(0, 6.3, 6), rng.uniform(-1, 1)

    def function(points: FloatArray) -> FloatArray:
        values: FloatArray = np.sin(points @ waves.T + phases).sum(axis=-1) - level
        return values

    evaluate = brick_values(function, GRID)
    seeds = pack_places(rng.integers(0, 4, (3, 3)))
    mesh = grow(evaluate, np.unique(seeds))
    if len(mesh.faces):
        assert_manifold(mesh)


@pytest.fixture
def sphere(brick_values: BrickValues) -> Mesh:
    evaluate = brick_values(lambda p: np.linalg.norm(p, axis=-1) - 0.7, GRID)
    seeds = seed_bricks(GRID, np.array([[0.7, 0.0, 0.0]]))
    return grow(evaluate, seeds)


def test_a_sphere_is_one_closed_piece_seen_from_outside(sphere: Mesh) -> None:
    found = check_mesh(sphere)
    assert found.watertight
    assert found.outward
    assert (found.components, found.genus) == (1, 0)


def test_vertices_lie_on_the_sphere_and_inside_their_edges(sphere: Mesh) -> None:
    radii = np.linalg.norm(sphere.vertices, axis=1)
    # A straight line along an edge errs by up to h^2 / (8 R), and clamping by 0.002 h.
    assert np.abs(radii - 0.7).max() < GRID.step**2 / (8 * 0.7) + 0.002 * GRID.step
    assert np.abs(radii - 0.7).mean() < 0.1 * GRID.step**2 / (8 * 0.7)
    along = ((sphere.vertices - GRID.origin) / GRID.step) % 1.0
    off_lattice = (along > 1e-9) & (along < 1 - 1e-9)
    assert (off_lattice.sum(axis=1) == 1).all()
    assert (np.abs(along - 0.5)[off_lattice] <= 0.498 + 1e-9).all()


def test_the_volume_of_a_sphere_comes_out_a_little_low(sphere: Mesh) -> None:
    true = 4 / 3 * np.pi * 0.7**3
    assert 0.99 * true < signed_volume(sphere) < true


def test_no_face_has_zero_area_even_where_nodes_touch_the_surface(
    brick_values: BrickValues,
) -> None:
    """The plane x = 0 passes exactly through nodes, which count as outside."""
    evaluate = brick_values(lambda p: p[..., 0], GRID)
    seeds = seed_bricks(GRID, np.array([[-0.01, 0.0, 0.0]]))
    mesh = grow(evaluate, seeds)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 1e-7
    assert_manifold(mesh)


def test_a_field_without_inside_has_no_faces() -> None:
    mesh = extract(GRID, *cut_bricks(np.ones((33, 33, 33), np.float32)))
    assert mesh.vertices.shape == (0, 3)
    assert mesh.faces.shape == (0, 3)


def test_balanced_faces_miss_the_surface_by_half_and_keep_its_volume(sphere: Mesh) -> None:
    exact = sphere.vertices * (0.7 / np.linalg.norm(sphere.vertices, axis=1, keepdims=True))
    balanced = Mesh(balance_vertices(exact, sphere.faces, GRID.step), sphere.faces)
    ball = 4 / 3 * np.pi * 0.7**3
    before, after = (signed_volume(m) - ball for m in (Mesh(exact, sphere.faces), balanced))
    assert before < 0
    assert abs(after) < 0.2 * abs(before)
    errors = [
        np.abs(np.linalg.norm(v[sphere.faces].mean(axis=1), axis=1) - 0.7).mean()
        for v in (exact, balanced.vertices)
    ]
    assert errors[1] < 0.5 * errors[0]
    shifts = np.linalg.norm(balanced.vertices - exact, axis=1)
    assert shifts.max() < 0.25 * np.sqrt(3) * GRID.step


def test_faces_that_would_turn_over_stay_where_they_are() -> None:
    """A needle of a tetrahedron, whose tip would sink through its base."""
    base = np.array([[1.0, 0, 0], [-0.5, 0.8, 0], [-0.5, -0.8, 0]])
    vertices = np.concatenate([base, [[0.0, 0.0, 1e-3]]])
    faces = np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3], [2, 1, 0]])
    balanced = balance_vertices(vertices, faces, 1.0)

    def normals(places: FloatArray) -> FloatArray:
        a, b, c = (places[faces[:, k]] for k in range(3))
        return np.cross(b - a, c - a)

    assert ((normals(vertices) * normals(balanced)).sum(axis=1) > 0).all()


def test_a_plane_is_balanced_already() -> None:
    places = np.stack(np.meshgrid(*[np.arange(4.0)] * 2, [0.0]), axis=-1).reshape(-1, 3)
    corners = np.array([[i, i + 1, i + 5, i, i + 5, i + 4] for i in (0, 1, 2, 4, 5, 6, 8, 9, 10)])
    assert np.array_equal(balance_vertices(places, corners.reshape(-1, 3), 1.0), places)


def test_faces_without_a_neighbour_are_left_out_of_the_rim_only(
    brick_values: BrickValues,
) -> None:
    """The sphere cut in two: the rim ends open, and what is taken must be whole."""
    evaluate = brick_values(lambda p: np.linalg.norm(p, axis=-1) - 0.7, GRID)
    places = np.stack(np.meshgrid(*[np.arange(4)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    half = places[places[:, 0] < 3]
    found = extract_surface(GRID, half, evaluate(half), half[:, 0] < 2)
    whole = extract_surface(GRID, places, evaluate(places))
    kept = np.cumsum(whole.face_counts)[len(half[half[:, 0] < 2]) - 1]
    assert np.array_equal(found.faces[:kept], whole.faces[:kept])
    assert len(found.faces) < np.cumsum(whole.face_counts)[len(half) - 1]
    with pytest.raises(ValueError, match="is missing"):
        extract_surface(GRID, half, evaluate(half))
