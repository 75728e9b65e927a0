"""Estimated normals are those of the surface, and a region's are those of the whole."""

from __future__ import annotations

import numpy as np
import pytest
from directions import random_directions

from hpcapp.applications.surface.cloud.spacing import estimate_spacing
from hpcapp.applications.surface.normals.estimation import MARGIN, estimate_normals, keep_directions
from hpcapp.geometry.points import Float32Array, FloatArray


def _estimate(positions: FloatArray) -> Float32Array:
    every = np.ones(len(positions), np.bool_)
    return estimate_normals(positions, every, positions.min(axis=0), estimate_spacing(positions))


def _angles(vectors: Float32Array, truth: FloatArray) -> FloatArray:
    """Return the angles between two directions up to their signs, in degrees."""
    units = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    cosines = np.abs(np.einsum("ij,ij->i", units, truth))
    angles: FloatArray = np.degrees(np.arccos(np.minimum(cosines, 1.0)))
    return angles


@pytest.mark.parametrize(("noise", "most"), [(0.0, 1.5), (0.01, 6.0), (0.03, 12.0)])
def test_a_sphere_has_its_radii_as_normals(noise: float, most: float) -> None:
    truth = random_directions(8_000, 0)
    radii = 1.0 + noise * np.random.default_rng(1).normal(size=(len(truth), 1))
    vectors = _estimate(truth * radii)
    assert _angles(vectors, truth).mean() < most
    if noise:
        assert np.median(np.linalg.norm(vectors, axis=1)) == pytest.approx(noise, rel=0.25)


def _wall(thickness: float, noise: float) -> FloatArray:
    """Both sides of a wall: 2 points in a square of edge 1, of which one is on each."""
    random = np.random.default_rng(4)
    sides = thickness * random.choice([-0.5, 0.5], size=8_000)
    sides += noise * random.normal(size=len(sides))
    return np.column_stack([random.uniform(0.0, np.sqrt(4_000.0), size=(8_000, 2)), sides])


@pytest.mark.parametrize("thickness", [0.9, 1.2, 1.5])
def test_the_sides_of_a_thin_wall_are_no_noise(thickness: float) -> None:
    vectors = _estimate(_wall(thickness, 0.05))
    assert np.mean(np.linalg.norm(vectors, axis=1) < 0.1) > 0.85
    assert np.mean(_angles(vectors, np.broadcast_to([0.0, 0.0, 1.0], vectors.shape)) < 5.0) > 0.85


@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("angle", [30.0, 40.0, 50.0])
def test_points_at_an_acute_edge_have_the_plane_of_their_side(angle: float, noise: float) -> None:
    random = np.random.default_rng(6)
    inwards, along = random.uniform(0.0, [[20.0], [200.0]], (2, 8_000))  # one point per area of 1
    sides, half = random.choice([-1.0, 1.0], 8_000), np.radians(angle / 2.0)
    truth = np.column_stack([np.full(8_000, -np.sin(half)), 0.0 * along, sides * np.cos(half)])
    edge = np.column_stack([inwards * np.cos(half), along, sides * inwards * np.sin(half)])
    angles = _angles(_estimate(edge + noise * random.normal(size=(8_000, 1)) * truth), truth)
    assert np.mean(angles[inwards < 4.0] > 10.0) < 0.14


def test_a_noisy_sheet_is_no_wall() -> None:
    """The points of one spread as those of two do, but not around two planes."""
    lengths = np.linalg.norm(_estimate(_wall(0.0, 0.7)), axis=1)
    assert np.mean(lengths < 0.25) < 0.005


def test_faces_of_a_box_are_flat_up_to_their_edges() -> None:
    random = np.random.default_rng(2)
    positions = random.uniform(-1.0, 1.0, (20_000, 3))
    axes = random.integers(0, 3, len(positions))
    rows = np.arange(len(positions))
    positions[rows, axes] = np.sign(positions[rows, axes])
    truth = np.eye(3)[axes]
    wrong = _angles(_estimate(positions), truth) > 10.0
    others = np.sort(np.abs(positions), axis=1)[:, 1]  # 1 at an edge
    assert np.mean(wrong) < 0.08
    assert not np.any(wrong & (others < 0.92))


def test_a_region_has_the_normals_of_the_whole() -> None:
    positions = np.concatenate(
        [random_directions(6_000, 0), np.repeat(random_directions(20, 5) * 0.5, 60, axis=0)]
    )
    spacing, low = estimate_spacing(positions), positions.min(axis=0)
    whole = estimate_normals(positions, np.ones(len(positions), np.bool_), low, spacing)
    own = positions[:, 2] > 0.8
    near = np.flatnonzero(positions[:, 2] > 0.8 - MARGIN * spacing)
    part = estimate_normals(positions[near], own[near], low, spacing)
    assert part.tobytes() == whole[own].tobytes()


def test_points_far_from_all_others_have_some_normal() -> None:
    positions = np.concatenate([random_directions(2_000, 0), [[90.0, 0.0, 0.0], [0.0, 90.0, 0.0]]])
    vectors = estimate_normals(
        positions, np.ones(len(positions), np.bool_), positions.min(axis=0), 0.05
    )
    assert np.isfinite(vectors).all()
    assert (np.linalg.norm(vectors, axis=1) > 0.0).all()


def test_known_directions_stay() -> None:
    truth = random_directions(2_000, 0)
    vectors = _estimate(truth)
    kept = keep_directions(vectors, -truth)
    assert np.linalg.norm(kept, axis=1) == pytest.approx(np.linalg.norm(vectors, axis=1), rel=1e-5)
    assert _angles(kept, truth).max() < 0.1
