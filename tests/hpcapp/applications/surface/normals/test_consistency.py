"""Wrong normals are turned round; thin plates and creases keep theirs."""

from __future__ import annotations

import numpy as np
import pytest
from directions import random_directions

from hpcapp.applications.surface.cloud.spacing import estimate_spacing
from hpcapp.applications.surface.normals.consistency import find_flipped
from hpcapp.geometry.points import FloatArray

Oriented = tuple[FloatArray, FloatArray]


def sphere(count: int) -> Oriented:
    normals = random_directions(count, 0)
    return normals.copy(), normals


def plate(count: int, gap: float) -> Oriented:
    """Two sheets, `gap` apart, that look away from each other."""
    random = np.random.default_rng(1)
    up = np.where(random.random(count) < 0.5, 1.0, -1.0)
    points = random.uniform(-1.0, 1.0, (count, 3))
    points[:, 2] = 0.5 * gap * up
    return points, np.stack([0.0 * up, 0.0 * up, up], axis=1)


def box(count: int) -> Oriented:
    random = np.random.default_rng(2)
    points = random.uniform(-1.0, 1.0, (count, 3))
    axis, side = random.integers(0, 3, count), random.choice([-1.0, 1.0], count)
    normals = np.zeros((count, 3))
    normals[np.arange(count), axis] = side
    points[np.arange(count), axis] = side
    return points, normals


def mend(points: FloatArray, normals: FloatArray) -> tuple[FloatArray, int]:
    turned = find_flipped(points, normals, points.min(axis=0), estimate_spacing(points))
    return np.where(turned[:, None], -normals, normals), int(np.count_nonzero(turned))


CLOUDS = {
    "sphere": sphere(20_000),
    "sparse sphere": sphere(1_000),
    "box": box(20_000),
    "plate": plate(20_000, 0.02),
    "plate thinner than the spacing": plate(3_000, 0.03),
}


@pytest.mark.parametrize("name", [*CLOUDS, "sheets that cannot be told apart"])
def test_right_normals_are_left_alone(name: str) -> None:
    points, normals = CLOUDS.get(name) or plate(3_000, 1e-4)
    assert mend(points, normals)[1] == 0


@pytest.mark.parametrize("name", CLOUDS)
def test_one_wrong_normal_in_twenty_is_mended(name: str) -> None:
    points, normals = CLOUDS[name]
    wrong = np.random.default_rng(3).random(len(points)) < 0.05
    given = np.where(wrong[:, None], -normals, normals)
    mended, flipped = mend(points, given)
    right = (mended == normals).all(axis=1)
    assert right[~wrong].all()
    assert right[wrong].mean() > 0.97
    assert flipped == np.count_nonzero((mended != given).any(axis=1))


def test_an_occluded_side_is_not_outvoted() -> None:
    """One sheet of a plate holds ten times the other's points."""
    points, normals = plate(6_000, 0.03)
    keep = (normals[:, 2] > 0.0) | (np.random.default_rng(4).random(len(points)) < 0.1)
    assert mend(points[keep], normals[keep])[1] == 0


def test_noise_wider_than_the_spacing_is_no_obstacle() -> None:
    points, normals = sphere(30_000)
    points = points * (1.0 + 0.02 * np.random.default_rng(5).normal(size=(len(points), 1)))
    given = normals.copy()
    given[::20] *= -1.0
    mended, _ = mend(points, given)
    right = (mended == normals).all(axis=1)
    assert right[np.arange(len(points)) % 20 > 0].all()
    assert right[::20].mean() > 0.9


def test_a_handful_of_points_is_left_alone() -> None:
    points, normals = sphere(7)
    assert not find_flipped(points, normals, points.min(axis=0), 1.0).any()
