"""How fine the far field is, on clouds whose folds are known, and what stays of an earlier job."""

import numpy as np
import pytest

from hpcapp.applications.surface.cloud.measure import measure_points
from hpcapp.applications.surface.hierarchical.coarse import anchor_quadrics, choose_nodes
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.kernels.types.field import FieldLevel

POINTS = 40_000
BOX = np.full(3, -1.0), np.full(3, 1.0)
STEP = 3.0 / 128  # of the coarser field


def sphere(radius: float, points: int = POINTS) -> tuple[FloatArray, FloatArray]:
    """Points spread evenly over a sphere, and its normals."""
    z = 1.0 - 2.0 * (np.arange(points) + 0.5) / points
    turn = np.arange(points) * np.pi * (3.0 - np.sqrt(5.0))
    across = np.sqrt(1.0 - z * z)
    normals = np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1)
    return radius * normals, normals


def shell(thickness: float, points: int = POINTS) -> tuple[FloatArray, FloatArray]:
    """A hollow ball: the inner side looks to its middle."""
    outer, normals = sphere(1.0, points)
    inner, inwards = sphere(1.0 - thickness, points)
    return np.concatenate([outer, inner]), np.concatenate([normals, -inwards])


def nodes(points: tuple[FloatArray, FloatArray], noise: float = 0.0) -> int:
    """Choose for cells that are smaller than the coarser field's step."""
    return choose_nodes(BOX, 0.5 * STEP, noise, measure_points(PointCloud(*points)).measured)


@pytest.mark.parametrize("points", [POINTS, 20 * POINTS])
def test_a_ball_asks_for_no_fine_far_field(points: int) -> None:
    assert nodes(sphere(1.0, points)) == 128


@pytest.mark.parametrize("points", [POINTS, 10 * POINTS])
@pytest.mark.parametrize("steps", [0.5, 1.0])
def test_sheets_back_to_back_ask_for_a_fine_one(steps: float, points: int) -> None:
    assert nodes(shell(steps * STEP, points)) == 256


def test_sheets_far_apart_ask_for_none() -> None:
    assert nodes(shell(10.0 * STEP)) == 128


def test_noise_that_hides_folds_asks_for_none() -> None:
    assert nodes(shell(STEP), noise=STEP) == 128


@pytest.mark.parametrize("off", [2.0**-12, 2.0**-4])
def test_what_is_hardly_another_is_as_it_was(off: float) -> None:
    """Each vertex by itself; a vertex that is new, or not there any more, changes no other."""
    random = np.random.default_rng(4)

    def level(keys: list[int]) -> FieldLevel:
        coefficients = random.normal(size=(len(keys), 10)).astype(np.float32)
        trust = random.uniform(size=len(keys)).astype(np.float32)
        return FieldLevel(np.array(keys), coefficients, trust)

    known = level([2, 3, 5, 8])
    now = level([3, 4, 5, 8])
    now.coefficients[[0, 2, 3]] = known.coefficients[1:] + np.float32(2.0**-12)
    now.trust[[0, 2, 3]] = known.trust[1:]
    now.coefficients[2, 7] = known.coefficients[2, 7] + np.float32(off)
    found = anchor_quadrics(now, known)
    is_near = off < 2.0**-8
    np.testing.assert_array_equal(found.keys, now.keys)
    np.testing.assert_array_equal(found.coefficients[[0, 3]], known.coefficients[[1, 3]])
    np.testing.assert_array_equal(found.coefficients[1], now.coefficients[1])
    np.testing.assert_array_equal(
        found.coefficients[2], known.coefficients[2] if is_near else now.coefficients[2]
    )


def test_a_sample_too_small_to_tell_is_taken_for_folded() -> None:
    assert nodes(sphere(1.0, 80 * POINTS)) == 256
