"""Shapes, their building blocks and their rays against what geometry says of them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import KDTree
from skimage.measure import marching_cubes

from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray
from hpcapp.lab.simulate import fields, outlines, reliefs, solids
from hpcapp.lab.simulate.implicit import ImplicitShape, Solid, diagonal_of
from hpcapp.lab.simulate.rays import closest_points, cross_rays, sample_lines, unit_vectors
from hpcapp.lab.simulate.shapes import SHAPES, find_shape
from hpccomponent.errors import UsageError

every_shape = pytest.mark.parametrize("shape", SHAPES.values(), ids=list(SHAPES))


def mesh_of(shape: Solid, cell: float) -> Mesh:
    """Marching cubes on a grid of that cell size, as a fraction of the diagonal."""
    low, high = shape.bounds
    step = cell * diagonal_of(shape)
    axes = [np.arange(a - 2.5 * step, b + 2.5 * step, step) for a, b in zip(low, high, strict=True)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    value = shape.value(grid.reshape(-1, 3)).reshape(grid.shape[:3])
    sides = (step,) * 3
    # scikit-image has no types
    vertices, faces, _, _ = marching_cubes(value, 0.0, spacing=sides)  # type: ignore[no-untyped-call]
    return Mesh(vertices + low - 2.5 * step, faces.astype(np.int64))


def points_around(shape: Solid, count: int = 2000, seed: int = 5) -> FloatArray:
    low, high = shape.bounds
    rng = np.random.default_rng(seed)
    return low + (high - low) * rng.uniform(-0.2, 1.2, (count, 3))


@every_shape
def test_its_surface_is_one_piece_of_the_genus_it_claims(shape: Solid) -> None:
    thin = shape.name in {"plate", "plates", "ring", "shaft", "fingers", "heatsink"}
    found = check_mesh(mesh_of(shape, 1 / 190 if thin else 1 / 70))
    assert found.watertight
    assert (found.components, found.genus) == (1, shape.genus)


@every_shape
def test_its_bounds_hold_the_surface_and_fit(shape: Solid) -> None:
    low, high = shape.bounds
    points = sample_lines(shape, 20_000, np.random.default_rng(1))
    slack = 1e-9 * diagonal_of(shape)
    assert (points >= low - slack).all()
    assert (points <= high + slack).all()
    fits = 0.01 * diagonal_of(shape)
    assert (points.min(axis=0) - low < fits).all()
    assert (high - points.max(axis=0) < fits).all()


@every_shape
def test_its_value_never_exceeds_the_distance_to_the_surface(shape: Solid) -> None:
    points = points_around(shape)
    surface = sample_lines(shape, 3000, np.random.default_rng(2))
    to_surface = np.linalg.norm(points[:, None] - surface[None, :500], axis=2).min(axis=1)
    assert (np.abs(shape.value(points)) <= to_surface + 1e-9).all()


@every_shape
def test_its_value_changes_no_faster_than_the_distance(shape: Solid) -> None:
    points = points_around(shape)
    step = 0.01 * diagonal_of(shape) * np.random.default_rng(3).standard_normal(points.shape)
    change = np.abs(shape.value(points + step) - shape.value(points))
    assert (change <= np.linalg.norm(step, axis=1) * (1 + 1e-9)).all()


@every_shape
def test_its_normals_are_the_direction_in_which_the_value_grows(shape: Solid) -> None:
    points = sample_lines(shape, 2000, np.random.default_rng(4))
    normals = shape.normal(points)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(1.0, abs=1e-12)
    step = 1e-6 * diagonal_of(shape)

    def slope(directions: FloatArray) -> FloatArray:
        ahead, behind = points + step * directions, points - step * directions
        return (shape.value(ahead) - shape.value(behind)) / (2 * step)

    along = slope(unit_vectors(np.cross(normals, [0.3, 0.5, 0.8])))
    assert (slope(normals) > 0.02).all()
    # Only where a step straddles a sharp edge may the value change along the surface.
    assert (np.abs(along) < 1e-4).mean() > 0.99


@every_shape
def test_lines_meet_its_surface_to_rounding(shape: Solid) -> None:
    points = sample_lines(shape, 3000, np.random.default_rng(6))
    assert len(points) > 100
    assert np.abs(shape.value(points)).max() < 1e-12 * diagonal_of(shape)


def test_every_name_is_found_and_a_wrong_one_explained() -> None:
    assert all(find_shape(name) is shape for name, shape in SHAPES.items())
    with pytest.raises(UsageError, match="choose one of sphere"):
        find_shape("teapot")


def test_rays_meet_a_sphere_where_the_quadratic_formula_says() -> None:
    sphere, rng = SHAPES["sphere"], np.random.default_rng(7)
    origins = 3.0 * unit_vectors(rng.standard_normal((500, 3)))
    directions = unit_vectors(0.6 * rng.standard_normal((500, 3)) - origins)
    half = np.einsum("ij,ij->i", origins, directions)
    under = half**2 - 8.0
    rays, distances = cross_rays(sphere, origins, directions, 7.0, first_only=True)
    clear = np.flatnonzero(under > 1e-2)
    assert set(clear) <= set(rays) <= set(np.flatnonzero(under > 0))
    assert distances == pytest.approx(-half[rays] - np.sqrt(under[rays]), abs=1e-11)


def test_a_line_through_a_torus_has_four_crossings_in_their_order() -> None:
    rays, distances = cross_rays(
        SHAPES["torus"], np.array([[-3.0, 0, 0]]), np.array([[1.0, 0, 0]]), 6.0, first_only=False
    )
    assert rays.tolist() == [0, 0, 0, 0]
    assert distances == pytest.approx([1.65, 2.35, 3.65, 4.35], abs=1e-11)


def test_rays_that_miss_return_nothing() -> None:
    rays, distances = cross_rays(
        SHAPES["sphere"], np.array([[-3.0, 2, 0]]), np.array([[1.0, 0, 0]]), 9.0, first_only=True
    )
    assert len(rays) == len(distances) == 0


def test_points_are_spread_by_area() -> None:
    # Archimedes: on a sphere, equal slabs hold equal areas.
    height = sample_lines(SHAPES["sphere"], 20_000, np.random.default_rng(8))[:, 2]
    share = np.histogram(height, bins=8, range=(-1, 1))[0] / len(height)
    assert share == pytest.approx(1 / 8, abs=0.01)


@pytest.mark.parametrize("name", ["torus", "ellipsoid", "knot", "bracket", "gear", "studded"])
def test_the_nearest_point_of_a_lifted_point_is_its_foot(name: str) -> None:
    shape, rng = SHAPES[name], np.random.default_rng(9)
    feet = sample_lines(shape, 1000, rng)
    height = 0.005 * diagonal_of(shape) * rng.random(len(feet))
    lifted = feet + height[:, None] * shape.normal(feet)
    found = closest_points(shape, lifted, rng.permutation(feet))
    away = np.linalg.norm(lifted - found, axis=1)
    assert np.abs(shape.value(found)).max() < 1e-11 * diagonal_of(shape)
    # A neighbouring face may be nearer than the foot, but nothing farther is ever returned.
    assert (away <= height + 1e-6 * diagonal_of(shape)).all()
    assert np.median(np.abs(away - height)) < 1e-8 * diagonal_of(shape)


def test_a_smooth_union_fills_the_joint_and_leaves_the_rest() -> None:
    parts = [
        solids.cone((0, 0, 0), (1, 0, 0), 0.2, 0.2),
        solids.cone((0, 0, 0), (0, 1, 0), 0.1, 0.1),
    ]
    sharp, smooth = fields.unite(*parts), fields.smooth_unite(0.1, *parts)
    points = np.random.default_rng(10).uniform(-0.5, 1.5, (3000, 3))
    difference = sharp.value(points) - smooth.value(points)
    assert difference.min() >= 0.0
    assert difference.max() <= 0.1 / 6 + 1e-12
    apart = np.abs(parts[0].value(points) - parts[1].value(points)) > 0.1
    assert (difference[apart] == 0.0).all()


def test_a_cone_is_the_hull_of_its_balls() -> None:
    hull = solids.cone((0, 0, 0), (0, 0, 2), 0.5, 0.1)
    points = np.random.default_rng(11).uniform(-1, 3, (400, 3))
    along = np.linspace(0, 1, 4001)[:, None]
    balls = np.concatenate([0 * along, 0 * along, 2 * along], axis=1)
    gap = np.linalg.norm(points[:, None] - balls[None], axis=2) - (0.5 - 0.4 * along[:, 0])
    assert hull.value(points) == pytest.approx(gap.min(axis=1), abs=1e-6)


def test_what_is_cut_away_is_outside() -> None:
    drilled = fields.cut(solids.box((0, 0, 0), (1, 1, 1)), solids.cylinder((0, 0, 0), 2, 0.5))
    shape = ImplicitShape("drilled", 1, (-np.ones(3), np.ones(3)), drilled)
    assert shape.value(np.array([[0.0, 0, 0], [0.75, 0, 0]])) == pytest.approx([0.5, -0.25])
    assert shape.normal(np.array([[0.5, 0, 0]]))[0] == pytest.approx([-1, 0, 0])


@pytest.mark.parametrize("name", ["bracket", "manifold", "flange", "boulder"])
def test_feet_beyond_edges_and_between_lumps_are_the_nearest_ones(name: str) -> None:
    shape, rng = SHAPES[name], np.random.default_rng(12)
    surface = sample_lines(shape, 200_000, rng)
    guesses = surface[:3000]
    spread = 0.004 * diagonal_of(shape)
    points = guesses + spread * rng.standard_normal(guesses.shape)
    away = np.linalg.norm(points - closest_points(shape, points, guesses), axis=1)
    # The sample is no nearer than the surface: what is farther away than it is not nearest.
    excess = away - KDTree(surface).query(points)[0]
    assert (excess < 1e-4 * diagonal_of(shape)).mean() > 0.995


def test_drawn_and_turned_outlines_have_exact_distances_inside_and_outside() -> None:
    square = outlines.polygon([(1.0, -0.5), (2.0, -0.5), (2.0, 0.5), (1.0, 0.5)])
    rng = np.random.default_rng(13)
    points = rng.uniform(-2.5, 2.5, (2000, 3))
    wanted = solids.box((1.5, 0.0, 0.0), (0.5, 0.5, 0.7))
    drawn = outlines.extrude(square, 0.7)
    assert drawn.value(points) == pytest.approx(wanted.value(points), abs=1e-12)
    assert np.allclose(drawn.gradient(points), wanted.gradient(points), atol=1e-9)
    wheel = fields.cut(
        solids.cylinder((0, 0, 0), 2, 2.0, 0.5), solids.cylinder((0, 0, 0), 2, 1.0, 0.5)
    )
    turned = outlines.revolve(square)
    # The cut is exact between its two walls.
    radius = np.hypot(points[:, 0], points[:, 1])
    between = (radius > 1.0) & (np.abs(points[:, 2]) < 0.5)
    assert turned.value(points[between]) == pytest.approx(wheel.value(points[between]), abs=1e-12)
    foot = points - turned.value(points)[:, None] * turned.gradient(points)
    assert np.abs(turned.value(foot)).max() < 1e-9


def test_a_polygon_with_notches_tells_inside_from_outside() -> None:
    notched = outlines.polygon([(0, 0), (4, 0), (4, 3), (3, 3), (3, 1), (1, 1), (1, 3), (0, 3)])
    inside = np.array([[0.5, 2.0], [2.0, 0.5], [3.5, 2.9]])
    outside = np.array([[2.0, 1.0 + 1e-9], [2.0, 2.0], [-1.0, 1.0], [5.0, 3.0], [2.0, 3.0]])
    assert (notched.value(inside) < 0.0).all()
    assert (notched.value(outside) > 0.0).all()
    assert notched.value(np.array([[5.0, 4.0]])) == pytest.approx(np.sqrt(2.0))


def test_a_relief_lies_where_its_height_says() -> None:
    relief = reliefs.lumps([(0.5, 0.03), (0.1, 0.004)], seed=1)
    lumpy = ImplicitShape(
        "lumpy", 0, (-1.1 * np.ones(3), 1.1 * np.ones(3)),
        reliefs.displace(solids.ellipsoid((1.0, 1.0, 1.0)), relief),
    )  # fmt: skip
    points = sample_lines(lumpy, 5000, np.random.default_rng(14))
    heights = np.linalg.norm(points, axis=1) - 1.0
    assert heights == pytest.approx(relief.height.value(points), abs=1e-11)
    assert 0.015 < np.abs(heights).max() <= relief.highest


@pytest.mark.parametrize("relief", [
    reliefs.lumps([(0.5, 0.03), (0.1, 0.004)], seed=1),
    reliefs.studs(1.0, 0.4, (40, 16), 0.01),
])  # fmt: skip
def test_a_relief_is_no_steeper_than_it_claims(relief: reliefs.Relief) -> None:
    torus, rng = SHAPES["torus"], np.random.default_rng(15)
    points = sample_lines(torus, 3000, rng)
    lift = (0.05 + relief.reach) * rng.uniform(-1.0, 1.0, len(points))
    points = points + lift[:, None] * torus.normal(points)
    points = points[np.abs(solids.torus(1.0, 0.4).value(points)) < relief.reach]
    slopes = relief.height.gradient(points)
    assert np.linalg.norm(slopes, axis=1).max() <= relief.steepest * (1 + 1e-12)
    assert np.abs(relief.height.value(points)).max() <= relief.highest
    step = 1e-6 * unit_vectors(rng.standard_normal(points.shape))
    change = relief.height.value(points + step) - relief.height.value(points - step)
    assert change == pytest.approx(2.0 * np.einsum("ij,ij->i", slopes, step), abs=1e-12)
