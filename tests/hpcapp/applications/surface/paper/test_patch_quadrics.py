from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from directions import random_directions
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hpcapp.applications.surface.paper import patch_quadrics
from hpcapp.applications.surface.paper.patch_quadrics import (
    evaluate_quadrics,
    fit_patches,
    gradient_quadrics,
)
from hpcapp.geometry.points import FloatArray, IntArray
from hpccomponent.errors import InputError

Shape = Callable[[np.random.Generator], tuple[FloatArray, FloatArray]]

CENTER, SCALE = np.array([3.0, -1.0, 2.0]), 1.7
TILT = Rotation.from_rotvec([0.4, -0.7, 0.2]).as_matrix()


def sphere(rng: np.random.Generator, n: int = 200) -> tuple[FloatArray, FloatArray]:
    normals = random_directions(n, rng)
    return 1.2 * normals, normals


def ellipsoid(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    on_sphere, _ = sphere(rng)
    positions = on_sphere * (1.3, 0.8, 1.0)
    normals = positions / np.square([1.3, 0.8, 1.0])
    return positions, normals / np.linalg.norm(normals, axis=1, keepdims=True)


def cylinder(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    angle, height = rng.uniform(0.0, 2.0 * np.pi, 200), rng.uniform(-1.0, 1.0, 200)
    normals = np.stack([np.cos(angle), np.sin(angle), np.zeros(200)], axis=1)
    return normals + np.outer(height, [0.0, 0.0, 1.0]), normals


def saddle(rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    x, y = rng.uniform(-1.0, 1.0, (2, 200))
    normals = np.stack([-y, -x, np.ones(200)], axis=1)
    return np.stack([x, y, x * y], axis=1), normals / np.linalg.norm(normals, axis=1)[:, None]


def plane(rng: np.random.Generator, n: int = 200) -> tuple[FloatArray, FloatArray]:
    x, y = rng.uniform(-1.0, 1.0, (2, n))
    return np.stack([x, y, np.full(n, 0.3)], axis=1), np.tile([0.0, 0.0, 1.0], (n, 1))


def fit_one(
    positions: FloatArray,
    normals: FloatArray,
    norm: str = "consistent",
    center: FloatArray = CENTER,
    scale: float = SCALE,
) -> FloatArray:
    offsets = np.array([0, len(positions)])
    (c,) = fit_patches(positions, normals, offsets, center[None], np.array([scale]), norm)
    values: FloatArray = c
    return values


def first_order_distances(
    c: FloatArray, positions: FloatArray, center: FloatArray = CENTER, scale: float = SCALE
) -> FloatArray:
    local = (positions - center) / scale
    steepness = np.linalg.norm(gradient_quadrics(c, local), axis=1)
    values: FloatArray = scale * evaluate_quadrics(c, local) / steepness
    return values


def normals_of(c: FloatArray, positions: FloatArray) -> FloatArray:
    gradients = gradient_quadrics(c, (positions - CENTER) / SCALE)
    values: FloatArray = gradients / np.linalg.norm(gradients, axis=1, keepdims=True)
    return values


@pytest.mark.parametrize("norm", ["consistent", "printed"])
@pytest.mark.parametrize("shape", [sphere, ellipsoid, cylinder, saddle, plane])
def test_points_on_a_quadric_are_fitted_exactly(shape: Shape, norm: str) -> None:
    positions, normals = shape(np.random.default_rng(5))
    positions, normals = positions @ TILT.T + CENTER, normals @ TILT.T
    c = fit_one(positions, normals, norm)
    assert np.abs(first_order_distances(c, positions)).max() < 1e-9
    assert np.abs(normals_of(c, positions) - normals).max() < 1e-7


@pytest.mark.parametrize("shape", [sphere, ellipsoid, cylinder])
def test_values_are_negative_inside_for_outward_normals_and_positive_for_inward(
    shape: Shape,
) -> None:
    positions, normals = shape(np.random.default_rng(6))
    inside = np.zeros((1, 3))
    assert evaluate_quadrics(fit_one(positions, normals), (inside - CENTER) / SCALE)[0] < 0.0
    assert evaluate_quadrics(fit_one(positions, -normals), (inside - CENTER) / SCALE)[0] > 0.0


def test_the_gradient_is_the_derivative_of_the_values() -> None:
    rng = np.random.default_rng(7)
    c, local, step = rng.normal(size=(50, 10)), rng.normal(size=(50, 3)), 1e-5
    slopes = [
        (evaluate_quadrics(c, local + d) - evaluate_quadrics(c, local - d)) / (2.0 * step)
        for d in step * np.eye(3)
    ]
    assert np.allclose(np.stack(slopes, axis=1), gradient_quadrics(c, local), atol=1e-8)


@pytest.mark.parametrize("norm", ["consistent", "printed"])
@pytest.mark.parametrize("n", [200, 4])
def test_coefficients_obey_their_constraint(norm: str, n: int) -> None:
    positions, normals = sphere(np.random.default_rng(8), n)
    squares = fit_one(positions + 0.2, normals, norm) ** 2
    if norm == "consistent":
        # A linear or mixed coefficient stands in the symmetric matrix as two halves.
        squares[[1, 2, 3, 7, 8, 9]] /= 2.0
    assert squares.sum() == pytest.approx(1.0)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=30, deadline=None)
def test_the_fit_turns_and_moves_with_the_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions, normals = ellipsoid(rng)
    positions = positions[positions[:, 0] > 0.0] + 0.05 * rng.normal(size=3)
    normals = normals[: len(positions)]
    positions += 0.02 * rng.normal(size=positions.shape)
    turn, shift = Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3)
    there = fit_one(positions, normals, center=np.zeros(3))
    here = fit_one(positions @ turn.T + shift, normals @ turn.T, center=shift)

    probes = rng.normal(size=(20, 3))
    turned = evaluate_quadrics(here, probes @ turn.T)
    assert np.abs(turned - evaluate_quadrics(there, probes)).max() < 1e-8


def test_the_printed_norm_does_not_turn_with_the_points() -> None:
    rng = np.random.default_rng(9)
    positions, normals = ellipsoid(rng)
    positions += 0.1 * rng.normal(size=positions.shape)
    there = fit_one(positions, normals, "printed", np.zeros(3))
    here = fit_one(positions @ TILT.T, normals @ TILT.T, "printed", np.zeros(3))
    probes = rng.normal(size=(20, 3))
    difference = evaluate_quadrics(here, probes @ TILT.T) - evaluate_quadrics(there, probes)
    assert np.abs(difference).max() > 1e-4


@st.composite
def batches(draw: st.DrawFn) -> tuple[list[int], list[int], bool, int]:
    """Points of some patches, a few of them empty or degenerate, and where to cut the batch."""
    counts = draw(st.lists(st.integers(0, 300), min_size=1, max_size=12))
    cuts = draw(st.lists(st.integers(0, len(counts)), max_size=4).map(sorted))
    flat = draw(st.booleans())
    return counts, [0, *cuts, len(counts)], flat, draw(st.integers(0, 2**32 - 1))


@given(batches(), st.sampled_from(["consistent", "printed"]))
@settings(max_examples=60, deadline=None)
def test_a_patch_does_not_depend_on_its_batch_to_the_last_bit(
    batch: tuple[list[int], list[int], bool, int], norm: str
) -> None:
    counts, cuts, flat, seed = batch
    rng = np.random.default_rng(seed)
    offsets = np.concatenate([[0], np.cumsum(counts)])
    make = plane if flat else sphere
    positions, normals = make(rng, int(offsets[-1]))
    if not flat:
        positions += 0.1 * rng.normal(size=positions.shape)
    centers, scales = rng.normal(size=(len(counts), 3)), rng.uniform(0.5, 2.0, len(counts))
    whole = fit_patches(positions, normals, offsets, centers, scales, norm)

    parts = []
    for a, b in pairwise(cuts):
        points = slice(offsets[a], offsets[b])
        own = offsets[a : b + 1] - offsets[a]
        batch_of_points = positions[points], normals[points], own
        parts.append(fit_patches(*batch_of_points, centers[a:b], scales[a:b], norm))
    assert np.concatenate(parts).tobytes() == whole.tobytes()
    assert np.isfinite(whole).all()


@pytest.mark.parametrize("chunk", [1, 50, 500])
def test_how_many_points_are_summed_at_once_changes_no_bit(
    monkeypatch: pytest.MonkeyPatch, chunk: int
) -> None:
    rng = np.random.default_rng(14)
    offsets = np.array([0, 0, 120, 121, 121, 400, 440, 1000, 1000])
    positions, normals = sphere(rng, 1000)
    positions += 0.1 * rng.normal(size=positions.shape)
    batch = positions, normals, offsets, rng.normal(size=(8, 3)), np.ones(8)
    whole = fit_patches(*batch)
    monkeypatch.setattr(patch_quadrics, "CHUNK", chunk)
    assert fit_patches(*batch).tobytes() == whole.tobytes()


def test_an_empty_patch_gets_zeros_and_disturbs_no_other() -> None:
    positions, normals = sphere(np.random.default_rng(10))
    n = len(positions)
    offsets = np.array([0, 0, n, n])
    centers, scales = np.tile(CENTER, (3, 1)), np.full(3, SCALE)
    c = fit_patches(positions, normals, offsets, centers, scales)
    assert not c[[0, 2]].any()
    assert np.array_equal(c[1], fit_one(positions, normals))
    nothing = fit_patches(
        np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(2, int), centers[:1], scales[:1]
    )
    assert not nothing.any()


@pytest.mark.parametrize("n", [1, 2, 3, 9])
def test_few_points_get_the_plane_across_their_mean_normal(n: int) -> None:
    rng = np.random.default_rng(n)
    positions, normals = rng.normal(size=(n, 3)), np.tile(TILT[2], (n, 1))
    c = fit_one(positions, normals)
    assert not c[4:].any()
    assert np.allclose(normals_of(c, positions), normals)
    assert first_order_distances(c, positions.mean(axis=0)[None])[0] == pytest.approx(0.0)


def test_normals_that_cancel_out_leave_the_first_to_decide() -> None:
    normals = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    c = fit_one(np.zeros((2, 3)), normals)
    assert np.allclose(normals_of(c, np.zeros((1, 3))), [[0.0, 1.0, 0.0]])


@pytest.mark.parametrize(
    "positions",
    [np.zeros((20, 3)), np.outer(np.linspace(-1.0, 1.0, 20), [1.0, 2.0, 3.0])],
    ids=["one place", "one line"],
)
@pytest.mark.parametrize("normal", [[0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
def test_points_without_area_still_get_a_finite_quadric_through_them(
    positions: FloatArray, normal: list[float]
) -> None:
    c = fit_one(positions, np.tile(normal, (20, 1)))
    assert np.isfinite(c).all()
    assert c.any()
    assert np.abs(evaluate_quadrics(c, (positions - CENTER) / SCALE)).max() < 1e-6


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"positions": np.zeros((3, 2))}, "shapes"),
        ({"normals": np.zeros((2, 3))}, "shapes"),
        ({"offsets": np.array([0, 2])}, "offsets"),
        ({"offsets": np.array([1, 3])}, "offsets"),
        ({"positions": np.full((3, 3), np.inf)}, "infinite"),
        ({"scales": np.zeros(1)}, "scale"),
        ({"norm": "euclidean"}, "norm"),
    ],
)
def test_bad_batches_are_named(change: dict[str, FloatArray | IntArray | str], named: str) -> None:
    batch: dict[str, Any] = {
        "positions": np.zeros((3, 3)),
        "normals": np.zeros((3, 3)),
        "offsets": np.array([0, 3]),
        "centers": np.zeros((1, 3)),
        "scales": np.ones(1),
        "norm": "consistent",
    }
    with pytest.raises(InputError, match=named):
        fit_patches(*(batch | change).values())
