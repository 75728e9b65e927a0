"""How fine the far field is, on clouds whose folds are known."""

import numpy as np
import pytest

from hpcapp.applications.surface.cloud.measure import measure_points
from hpcapp.applications.surface.hierarchical.coarse import choose_nodes
from hpcapp.geometry.points import FloatArray, PointCloud

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


def test_a_sample_too_small_to_tell_is_taken_for_folded() -> None:
    assert nodes(sphere(1.0, 80 * POINTS)) == 256
