"""Every native kernel gives what its numpy version gives."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from both_builds import assert_alike
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from hpcapp.geometry import lattice
from hpcapp.geometry.points import IntArray
from hpcapp.kernels import portable
from hpcapp.kernels.portable.field.strides import fill_missing, line_shifts
from hpcapp.kernels.portable.quadrics.hermite import fit_vertices
from hpcapp.kernels.portable.surface.bricks import grow_bricks
from hpcapp.kernels.portable.surface.marching_cubes import extract_surface
from hpcapp.kernels.types import grid as grid_types
from hpcapp.kernels.types.brick_mesh import BrickMesh, Survey
from hpcapp.kernels.types.field import PIECES, FarField, Features, Field
from hpcapp.kernels.types.grid import Grid

coordinates = arrays.arrays(
    np.int64, st.tuples(st.integers(1, 60), st.just(3)), elements=st.integers(-40, 40)
)


@given(coordinates, st.integers(-2, 1), st.integers(0, 3))
@settings(deadline=None, max_examples=40)
def test_sets_of_places(native: ModuleType, places: IntArray, low: int, width: int) -> None:
    keys = lattice.unique_keys(lattice.pack_places(places))
    spread = native.spread_keys(keys, low, low + width)
    np.testing.assert_array_equal(spread, lattice.spread_keys(keys, low, low + width))
    assert_alike(native, "parent_keys", keys)
    np.testing.assert_array_equal(native.unite_keys(keys, spread), lattice.unite_keys(keys, spread))
    for wanted in (spread, np.ascontiguousarray(spread[::-1])):
        expected = lattice.find_keys(keys, wanted)
        for threads in (1, 3):
            np.testing.assert_array_equal(native.find_keys(keys, wanted, threads), expected)


@given(coordinates)
@settings(deadline=None, max_examples=60)
def test_cells_that_touch(native: ModuleType, places: IntArray) -> None:
    keys = lattice.unique_keys(lattice.pack_places(places // 4))
    assert_alike(native, "label_cells", keys)


@given(coordinates, st.integers(0, 4))
@settings(deadline=None, max_examples=40)
def test_ancestors(native: ModuleType, places: IntArray, depth: int) -> None:
    keys = lattice.unique_keys(lattice.pack_places(places))
    above = lattice.unique_keys(lattice.pack_places(lattice.unpack_keys(keys) >> depth))[::2].copy()
    assert_alike(native, "mark_ancestors", keys, depth, above)


@given(st.integers(0, 2**32), st.floats(0.05, 3.0), st.floats(0.01, 9.0), st.integers(2, 60))
@settings(deadline=None, max_examples=40)
def test_looking_near(
    native: ModuleType, seed: int, size: float, reach: float, one_in: int
) -> None:
    random = np.random.default_rng(seed)
    keys = lattice.unique_keys(lattice.pack_places(random.integers(-9, 20, size=(400, 3))))
    kinds = (random.integers(0, one_in, size=(6, 4, 5)) == 0).astype(np.uint8)
    origin, corner = random.normal(size=(2, 3))
    edge = 1.25
    found = assert_alike(native, "look_near", keys, origin, size, kinds, corner, edge, reach)
    # The distance along the axis where it is largest, to the nearest brick that is wanted.
    middles = origin + size * (lattice.unpack_keys(keys) + 0.5)
    low = corner + edge * np.argwhere(kinds)
    beside = np.maximum(low - middles[:, None], middles[:, None] - low - edge)
    away = beside.max(axis=2).min(axis=1, initial=np.inf)
    assert found[away < reach - 1e-9].all()
    assert not found[away > reach + 1e-9].any()


@given(
    st.integers(0, 2**32), st.integers(1, 300), st.lists(st.integers(1, 13), min_size=3, max_size=3)
)
@settings(deadline=None, max_examples=60)
def test_rims(native: ModuleType, seed: int, one_in: int, sides: list[int]) -> None:
    random = np.random.default_rng(seed)
    bricks = random.integers(0, one_in, size=sides) == 0
    cells = (1 << random.integers(0, 4, size=sides)).astype(np.uint8)
    for case in ((bricks, None), (bricks, cells), (bricks, cells.clip(2))):
        assert_alike(native, "mark_rim", *case)


sides = st.lists(st.integers(0, 5), min_size=3, max_size=3).map(np.array)


@given(coordinates, coordinates, sides, sides)
@settings(deadline=None, max_examples=60)
def test_boxes_around_cells(
    native: ModuleType,
    places: IntArray,
    others: IntArray,
    low: IntArray,
    high: IntArray,
) -> None:
    keys, cells = (lattice.unique_keys(lattice.pack_places(each // 2)) for each in (places, others))
    found = assert_alike(native, "mark_near", keys, cells, low, high)
    off = lattice.unpack_keys(keys)[:, None] - lattice.unpack_keys(cells)
    boxed = np.any(np.all((off >= -low) & (off <= high), axis=2), axis=1)
    np.testing.assert_array_equal(found, boxed)


@given(st.integers(0, 2**32), st.integers(1, 300), st.floats(0.01, 10.0))
@settings(deadline=None, max_examples=30)
def test_sorting_points(native: ModuleType, seed: int, points: int, size: float) -> None:
    random = np.random.default_rng(seed)
    positions, normals = random.normal(size=(2, points, 3))
    origin = random.normal(size=3)
    rows = assert_alike(native, "sort_points", positions, origin, size)[2]
    assert_alike(native, "gather_points", positions, normals, rows, origin, size)
    packed = assert_alike(native, "pack_records", positions, normals, origin, size)
    keys, counts, records = packed
    bounds = assert_alike(native, "bound_records", records)
    layout = bounds[0], np.array([int(span).bit_length() for span in bounds[1] - bounds[0]])
    folded = assert_alike(native, "fold_records", records, *layout)
    # The blocks from the last to the first.
    starts = len(records) - np.cumsum(counts)
    unfolded = np.zeros((2, *records.shape), np.float32)
    native.unfold_records(folded, *layout, counts, starts, unfolded[0])
    portable.unfold_records(folded, *layout, counts, starts, unfolded[1])
    turned = np.concatenate(np.split(records, np.cumsum(counts)[:-1])[::-1])
    assert unfolded[0].tobytes() == unfolded[1].tobytes() == turned.tobytes()
    places = records, counts, lattice.unpack_keys(keys) * size + origin, size
    assert_alike(native, "unpack_records", *places)
    assert_alike(native, "unpack_within", *places, *np.quantile(positions, [0.2, 0.9], axis=0))
    chosen = keys[::2].copy(), (keys[::2] % 3).astype(np.uint8)
    for lattice_of in ((origin, 0.3 * size, 0), (origin + 0.3 * size, 0.5 * size, 1)):
        sorted_by_cell = assert_alike(native, "sort_packed", *places, *lattice_of, *chosen)
        assert_alike(native, "count_packed", *places, *lattice_of[:2])
        assert_alike(native, "place_packed", *sorted_by_cell[2:4], *places[2:], *lattice_of[:2])
    for one_in in (1, 3):
        assert_alike(native, "count_boxes", positions, origin, size, one_in)
        assert_alike(native, "sample_boxes", positions, origin, size, one_in)


@given(st.integers(0, 2**32), st.lists(st.integers(0, 9), min_size=1, max_size=30))
@settings(deadline=None, max_examples=30)
def test_moments_of_points(native: ModuleType, seed: int, counts: list[int]) -> None:
    random = np.random.default_rng(seed)
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    local = random.uniform(-0.5, 0.5, size=(offsets[-1], 3))
    normals = random.normal(size=(offsets[-1], 3))
    assert_alike(native, "accumulate_moments", local, normals, offsets)
    weights = random.uniform(size=offsets[-1])
    assert_alike(native, "accumulate_moments", local, normals, offsets, weights)


@pytest.mark.parametrize("depth", [0, 1])
def test_distances_from_a_blend(native: ModuleType, cloud: Any, depth: int) -> None:
    random = np.random.default_rng(depth)
    above = lattice.unique_keys(lattice.pack_places(lattice.unpack_keys(cloud.cells) >> depth))
    corners = lattice.spread_keys(above, 0, 1)[3:]  # some cells lack one
    coefficients = random.normal(size=(len(corners), 10)).astype(np.float32)
    variances = random.uniform(size=len(corners)).astype(np.float32)
    level = cloud.local, cloud.offsets, cloud.cells, depth, corners, coefficients, variances
    found = native.rate_points(*level)
    np.testing.assert_allclose(found, portable.rate_points(*level), rtol=1e-9, atol=1e-12)
    assert (found == 0.0).any()


def test_moments_of_cells(native: ModuleType, cloud: Any) -> None:
    parents, merged = native.merge_cells(cloud.cells, cloud.moments)
    keys, expected = portable.merge_cells(cloud.cells, cloud.moments)
    np.testing.assert_array_equal(parents, keys)
    np.testing.assert_allclose(merged, expected, rtol=1e-12, atol=1e-12)
    around = native.corner_moments(cloud.touched, cloud.cells, cloud.moments, 1)
    wanted = portable.corner_moments(cloud.touched, cloud.cells, cloud.moments)
    np.testing.assert_allclose(around, wanted, rtol=1e-12, atol=1e-11)


@pytest.mark.parametrize(("lam", "most_noise"), [(0.01, 0.0), (1.0, 0.01)])
def test_fits(native: ModuleType, cloud: Any, lam: float, most_noise: float) -> None:
    random = np.random.default_rng(3)
    around = portable.corner_moments(cloud.touched, cloud.cells, cloud.moments)
    # Priors of every quality: near fits, moved by the noise and by much more.
    prior = fit_vertices(around, np.zeros((len(around), 10)), 0.3, 0.3)
    prior += random.uniform(0.0, 0.3, size=(len(around), 1)) * random.normal(size=prior.shape)
    noise = (most_noise * random.uniform(size=len(around))).astype(np.float32)
    points = (cloud.touched, cloud.cells, cloud.moments, prior.astype(np.float32), noise)
    slopes = np.linspace(0.5 * lam, lam, len(noise), dtype=np.float32)
    weights = (slopes, 0.3, 9.0)
    found, counts, variances, misfits = native.fit_corners(*points, *weights, 1)
    expected, wanted_counts, wanted_variances, wanted = portable.fit_corners(*points, *weights)
    np.testing.assert_allclose(misfits, wanted, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(counts, wanted_counts)
    assert 0 < np.isnan(variances).sum() < len(variances)
    np.testing.assert_allclose(variances, wanted_variances, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)
    expected = expected.astype(np.float64)
    residuals = native.evaluate_residuals(around, expected)
    summed = portable.evaluate_residuals(around, expected)
    np.testing.assert_allclose(residuals, summed, rtol=1e-9, atol=1e-9)


def test_priors(native: ModuleType, cloud: Any) -> None:
    random = np.random.default_rng(5)
    vertices = lattice.spread_keys(cloud.cells, -1, 2)
    parents = portable.parent_keys(vertices)
    coefficients = random.normal(size=(len(parents), 10)).astype(np.float32)
    values = random.uniform(size=(len(parents), 3)).astype(np.float32)
    found = native.inherit_level(vertices, parents, coefficients, values, 1)
    expected = portable.inherit_level(vertices, parents, coefficients, values)
    for mean, wanted in zip(found, expected, strict=True):
        np.testing.assert_allclose(mean, wanted, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("smoothing", [1.0, 2.5])
@pytest.mark.parametrize("held", [[[0, 32], [0, 32]], [[5, 28], [3, 27]]])
def test_integrated_normals(native: ModuleType, cloud: Any, smoothing: float, held: Any) -> None:
    places = cloud.positions * 8.0 + 16.0
    samples = (places, cloud.normals, smoothing, np.array(held), 32)
    found = native.integrate_normals(*samples, 1)
    expected = portable.integrate_normals(*samples)
    np.testing.assert_allclose(found, expected, atol=3e-6 * np.abs(expected).max())


def test_sampled_grid(native: ModuleType, cloud: Any) -> None:
    values = np.random.default_rng(4).normal(size=(16, 16, 16)).astype(np.float32)
    places = (cloud.positions + 1.5) * 5.0
    samples = native.sample_grid(values, places)
    np.testing.assert_allclose(samples, portable.sample_grid(values, places), 1e-12, 1e-12)
    corners = (values, cloud.touched, np.array([1.0, 3.0, 5.0]), 0.7)
    wanted = portable.sample_corners(*corners)
    np.testing.assert_allclose(native.sample_corners(*corners), wanted, 1e-12, 1e-12)


def test_bricks(native: ModuleType, any_ball: tuple[Field, Grid]) -> None:
    function, grid = any_ball
    places = np.stack(np.meshgrid(*map(np.arange, grid.bricks), indexing="ij"), axis=-1)
    places = np.ascontiguousarray(places.reshape(-1, 3))[::3]
    places = np.ascontiguousarray(places)
    found = native.evaluate_bricks(function, grid, places, 1)
    expected = portable.evaluate_bricks(function, grid, places)
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6)
    assert ((found < 0) == (expected < 0)).all()


def test_bricks_with_edges(native: ModuleType, any_ball: tuple[Field, Grid]) -> None:
    function, grid = any_ball
    rng = np.random.default_rng(8)
    keys = function.levels[0].keys[::3].copy()
    pieces = rng.normal(size=(len(keys), PIECES, 10)).astype(np.float32)
    joints = (np.arange(len(keys)) % 4).astype(np.uint8)
    every = [Features(keys, pieces, joints)]
    for level in function.levels[1:]:
        some = level.keys[::2].copy()
        more = rng.normal(size=(len(some), PIECES, 10)).astype(np.float32)
        every.append(Features(some, more, (np.arange(len(some)) % 4).astype(np.uint8)))
    edged = replace(function, features=tuple(every))
    places = np.array([[1, 1, 1], [0, 1, 1], [1, 0, 0]])
    found = native.evaluate_bricks(edged, grid, places, 1)
    expected = portable.evaluate_bricks(edged, grid, places)
    np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5)
    plain = native.evaluate_bricks(function, grid, places, 1)
    assert np.abs(found - plain).max() > 0.1
    finest = native.evaluate_bricks(replace(function, features=tuple(every[:1])), grid, places, 1)
    assert len(every) == 1 or np.abs(found - finest).max() > 0.1


@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_joined_quadrics(native: ModuleType, noise: float) -> None:
    """Around the edges of a box whose sides are some cells long."""
    rng = np.random.default_rng(6)
    positions = rng.uniform(-1.0, 1.0, size=(5000, 3))
    rows, axis = np.arange(5000), rng.integers(0, 3, 5000)
    sign = rng.choice([-1.0, 1.0], 5000)
    positions[rows, axis] = sign + np.sqrt(noise) * rng.normal(size=5000)
    normals = np.zeros((5000, 3))
    normals[rows, axis] = sign
    of_cells, offsets, order = portable.sort_points(positions, np.full(3, 0.01), 0.12)
    local, turned = portable.gather_points(positions, normals, order, np.full(3, 0.01), 0.12)
    vertices = lattice.spread_keys(of_cells, 0, 1)[::7].copy()
    given = vertices, of_cells, offsets, local, turned, noise / 0.12**2
    pieces, joints = native.fit_features(*given, 1)
    expected, expected_joints = portable.fit_features(*given)
    same = joints == expected_joints
    assert same.mean() > 0.99  # a point midway may fall to either piece
    assert (joints < 255).mean() > 0.2
    off = np.abs(pieces[same] - expected[same]).max(axis=(1, 2))[joints[same] < 255]
    assert np.quantile(off, 0.97) < 1e-5


def test_surface(native: ModuleType, any_ball: tuple[Field, Grid]) -> None:
    function, grid = any_ball
    normals = np.random.default_rng(2).normal(size=(20, 3))
    surface_points = 0.8 * normals / np.linalg.norm(normals, axis=1, keepdims=True)
    seeds = native.seed_bricks(grid, surface_points)
    np.testing.assert_array_equal(seeds, portable.seed_bricks(grid, surface_points))

    def evaluate(places: IntArray) -> Any:
        places = np.ascontiguousarray(places)
        return native.evaluate_bricks(function, grid, places, 1)

    whole = np.full(grid.bricks, grid_types.OPEN, np.uint8)
    whole[tuple(lattice.unpack_keys(seeds).T)] = grid_types.OWN
    half = whole.copy()  # of which the other belongs to another tile
    half[grid.bricks[0] // 2 :] = grid_types.FOREIGN
    half[-2:] = grid_types.OUT
    half[:, :1] = grid_types.BESIDE
    for kinds in (grid_types.BrickKinds(np.zeros(3, np.int64), k) for k in (half, whole)):
        places, values, taken, exits = grow_bricks(evaluate, kinds, grid.bricks)
        expected = extract_surface(grid, places, values, taken)
        found = native.grow_surface(function, grid, kinds)
        assert isinstance(found, BrickMesh)
        np.testing.assert_array_equal(found.exits, exits)
        for name in ("bricks", "taken", "vertex_counts", "face_counts", "vertices", "faces"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert len(expected.faces)
    radius = np.linalg.norm(expected.vertices, axis=1)
    assert np.abs(radius - 0.8).max() < 0.05 * max(function.cell_size, grid.step)
    balanced = native.balance_vertices(expected.vertices, expected.faces, grid.step)
    wanted = portable.balance_vertices(expected.vertices, expected.faces, grid.step)
    np.testing.assert_allclose(balanced, wanted, rtol=1e-12, atol=1e-14)


def random_strides(random: np.random.Generator, grid: Grid) -> grid_types.BrickStrides:
    """Return strides of most bricks of a grid; those of the others are a brick."""
    places = np.stack(np.meshgrid(*map(np.arange, grid.bricks), indexing="ij"), axis=-1)
    keys = lattice.pack_places(places.reshape(-1, 3))
    keys = keys[random.random(len(keys)) < 0.8]
    return grid_types.BrickStrides(keys, random.integers(0, 4, len(keys)).astype(np.uint8))


@pytest.mark.parametrize("seed", range(6))
def test_surface_where_strides_differ(native: ModuleType, seed: int) -> None:
    """Of noise at several scales, so that cells of all kinds come up."""
    random = np.random.default_rng(seed)
    step = (0.7, 1.6, 4.0)[seed % 3]
    side = int(32 / step) + 4
    noise = random.normal(0.3, 1.0, (side, side, side)).astype(np.float32)
    hull = np.array([[0.6, 0.0, -0.8, 9.0], [0.0, -1.0, 0.0, -6.0]])
    function = Field(np.zeros(3), 1.0, (), FarField(noise, np.full(3, -step), step, hull))
    grid = Grid(np.zeros(3), 1.0, (4, 3, 3))
    grid = replace(grid, strides=random_strides(random, grid))
    places = np.stack(np.meshgrid(*map(np.arange, grid.bricks), indexing="ij"), axis=-1)
    places = np.ascontiguousarray(places.reshape(-1, 3))
    values = native.evaluate_bricks(function, grid, places, 1)
    np.testing.assert_allclose(values, portable.evaluate_bricks(function, grid, places), 1e-5, 1e-5)
    whole = np.full(grid.bricks, grid_types.OWN, np.uint8)
    kinds = [grid_types.BESIDE, grid_types.FOREIGN, grid_types.OPEN, grid_types.OWN]
    part = random.choice(kinds, grid.bricks, p=[0.1, 0.4, 0.2, 0.3]).astype(np.uint8)

    def evaluate(places: IntArray) -> Any:
        return native.evaluate_bricks(function, grid, np.ascontiguousarray(places), 1)

    for given_kinds in (grid_types.BrickKinds(np.zeros(3, np.int64), k) for k in (part, whole)):
        grown = grow_bricks(evaluate, given_kinds, grid.bricks, grid.strides)
        expected = extract_surface(grid, *grown[:3])
        for threads in (1, 3):
            found = native.grow_surface(function, grid, given_kinds, threads)
            np.testing.assert_array_equal(found.exits, grown[3])
            for name in ("bricks", "taken", "vertex_counts", "face_counts", "vertices", "faces"):
                np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))
    assert grid.strides is not None
    exponents = np.repeat(grid.strides.at(expected.bricks), expected.face_counts)
    of_mesh = expected.vertices, expected.faces, grid.step, exponents
    balanced = native.balance_vertices(*of_mesh)
    np.testing.assert_allclose(balanced, portable.balance_vertices(*of_mesh), 1e-9, 1e-9)


@pytest.mark.parametrize("cell_size", [0.05, 0.21])
def test_nodes_far_apart_have_the_values_of_near_ones(
    native: ModuleType, any_ball: tuple[Field, Grid], cell_size: float
) -> None:
    """Whatever the strides around a brick are, bit for bit."""
    function, grid = any_ball
    function = replace(function, cell_size=cell_size)
    places = np.stack(np.meshgrid(*map(np.arange, grid.bricks), indexing="ij"), axis=-1)
    places = np.ascontiguousarray(places.reshape(-1, 3))
    every = native.evaluate_bricks(function, grid, places, 1)
    strides = random_strides(np.random.default_rng(3), grid)
    some = native.evaluate_bricks(function, replace(grid, strides=strides), places, 1)
    shifts = line_shifts(replace(grid, strides=strides), places)
    np.testing.assert_array_equal(some, fill_missing(every, shifts))


@given(st.integers(0, 2**32))
@settings(deadline=None, max_examples=40)
def test_balancing_what_folds(native: ModuleType, seed: int) -> None:
    """Faces between vertices at random, many of which would turn over."""
    random = np.random.default_rng(seed)
    vertices, faces = random.normal(size=(9, 3)), random.integers(0, 9, size=(12, 3))
    wanted = portable.balance_vertices(vertices, faces, 1.0)
    nudged = portable.balance_vertices(vertices * (1.0 + 1e-13), faces, 1.0)
    assume(np.allclose(wanted, nudged, rtol=1e-9, atol=1e-9))  # nothing hangs on a rounding
    found = native.balance_vertices(vertices, faces, 1.0)
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-9)


@given(
    arrays.arrays(np.int64, st.tuples(st.integers(1, 40), st.just(3)), elements=st.integers(0, 12))
)
@settings(deadline=None, max_examples=60)
def test_connectivity(native: ModuleType, faces: IntArray) -> None:
    assert_alike(native, "label_components", faces, 13)
    found = native.survey_mesh(faces, 13)
    assert isinstance(found, Survey)
    wanted = portable.survey_mesh(faces, 13)
    for name in ("boundary", "overfull", "degenerate", "misoriented", "fans"):
        assert getattr(found, name) == getattr(wanted, name), name
    np.testing.assert_array_equal(found.edges_of, wanted.edges_of)
    vertices = np.random.default_rng(0).normal(size=(13, 3))
    volume = native.signed_volume(vertices, faces, vertices[0])
    assert volume == pytest.approx(portable.signed_volume(vertices, faces, vertices[0]))
