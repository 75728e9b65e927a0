"""Pixels tell that a camera was at zero, and nothing else does."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.applications.surface.normals.stand import has_pixels
from hpcapp.geometry.points import FloatArray


def _depth_image(axes: list[int]) -> FloatArray:
    """What a camera of 160 x 120 pixels sees of a wavy wall."""
    columns, rows = (axis.ravel() for axis in np.meshgrid(np.arange(160.0), np.arange(120.0)))
    across = np.stack([columns - 79.5, rows - 59.5, np.full(len(rows), 150.0)], axis=1) / 150.0
    depth = 2.0 + 0.3 * np.sin(0.05 * columns) + 0.2 * np.cos(0.07 * rows)
    depth += np.random.default_rng(0).normal(0.0, 0.004, len(depth))
    image: FloatArray = (across * depth[:, None])[:, axes]
    return image.astype(np.float32).astype(np.float64)


@pytest.mark.parametrize("axes", [[0, 1, 2], [2, 0, 1]])
@pytest.mark.parametrize("every", [1, 3])
def test_a_depth_image_shows_its_pixels(axes: list[int], every: int) -> None:
    image = _depth_image(axes)
    for some in (image, -image, 1000.0 * image):
        assert has_pixels(some[::every])
    shuffled = np.random.default_rng(1).permutation(image)
    assert has_pixels(shuffled[:3_000])


def test_whole_millimetres_hide_no_pixels() -> None:
    assert has_pixels(np.rint(1000.0 * _depth_image([0, 1, 2])))


def test_a_wall_behind_hides_no_pixels() -> None:
    """Most columns are as even in space as in the image; the others are in the image alone."""
    columns, rows = (axis.ravel() for axis in np.meshgrid(np.arange(160.0), np.arange(120.0)))
    depth = np.where(np.hypot(columns - 80.0, rows - 60.0) < 40.0, 1.1 + 0.001 * columns, 1.5)
    across = np.stack([columns - 79.5, rows - 59.5, np.full(len(rows), 150.0)], axis=1) / 150.0
    assert has_pixels(np.rint(1000.0 * across * depth[:, None]))


def test_what_was_moved_away_from_its_camera_shows_none() -> None:
    image = _depth_image([0, 1, 2])
    assert not has_pixels(image + np.array([0.1, 0.0, 0.0]))
    assert not has_pixels(image - np.array([0.0, 0.0, 2.0]))  # the camera is among the points


def test_points_on_a_lattice_in_space_are_no_pixels() -> None:
    steps = np.arange(80.0)
    x, y = (axis.ravel() for axis in np.meshgrid(steps, steps))
    for height in (0.0, 1.0):
        relief = 150.0 + height * np.sin(0.3 * x) * np.cos(0.2 * y)
        assert not has_pixels(np.stack([x - 40.0, y - 40.0, relief], axis=1))


def test_scattered_points_over_zero_are_no_pixels() -> None:
    random = np.random.default_rng(2)
    ground = random.uniform(-50.0, 50.0, (9_000, 3))
    ground[:, 2] = 150.0 + 3.0 * np.sin(0.1 * ground[:, 0])
    assert not has_pixels(ground)
