"""Where scans were taken from, and what they have looked through."""

from __future__ import annotations

import numpy as np
import pytest
from stands import scan_stands

from hpcapp.alignment.sample import sample_scan, thin
from hpcapp.alignment.viewpoint import View, find_eye, see_scan
from hpcapp.geometry.points import FloatArray

UP = np.array([0.0, 0.0, 1.0])


def scan_ball(distance: float, shift: FloatArray) -> FloatArray:
    """Return a range image of a unit ball, from above at a distance of its centre."""
    rng = np.random.default_rng(0)
    rows, columns = np.mgrid[-1:1:90j, -1:1:90j] / distance
    rays = np.column_stack([rows.ravel(), columns.ravel(), np.full(rows.size, -1.0)])
    rays[:, :2] += rng.uniform(-0.005, 0.005, (len(rays), 2)) / distance
    # Where each ray meets the ball: |distance * up + t * ray| = 1, the nearer one.
    square, half = (rays**2).sum(axis=1), -distance
    root = half**2 - square * (distance**2 - 1)
    met = root > 0
    along = (-half - np.sqrt(root[met])) / square[met]
    return np.asarray(shift + [0.0, 0.0, distance] + along[:, None] * rays[met])


def test_a_tripod_stands_at_the_origin_of_its_scan() -> None:
    for points, _ in scan_stands():
        sample = sample_scan(points)
        eye = find_eye(sample)
        assert eye is not None
        np.testing.assert_allclose(eye, -sample.centre)


def test_a_camera_outside_is_found_by_the_way_that_it_looked() -> None:
    sample = sample_scan(scan_ball(3.0, np.array([9.0, 50.0, 3.0])))
    eye = find_eye(sample)
    assert eye is not None
    assert eye @ UP > 0.95 * np.linalg.norm(eye)


def test_from_very_far_front_and_back_look_alike() -> None:
    sample = sample_scan(scan_ball(100.0, np.array([900.0, 50.0, 3.0])))
    assert find_eye(sample) is None


def test_points_that_are_even_on_the_surface_tell_no_viewpoint() -> None:
    rng = np.random.default_rng(0)
    plane = np.column_stack([rng.uniform(0, 9, (6000, 2)), rng.normal(0, 0.01, 6000)])
    sample = sample_scan(plane + np.array([900.0, 0.0, 0.0]))
    assert find_eye(sample) is None


def test_what_the_file_says_is_believed() -> None:
    sample = see_scan(scan_ball(3.0, np.zeros(3)), np.array([0.0, 0.0, 7.0]))
    assert sample.eye is not None
    np.testing.assert_allclose(sample.eye + sample.centre, [0.0, 0.0, 7.0])


@pytest.mark.parametrize(("height", "beyond", "before"), [(0.5, 5.0, -5.0), (-0.5, -5.0, 5.0)])
def test_a_view_ends_at_what_it_sees(height: float, beyond: float, before: float) -> None:
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(-3, 3, (20_000, 2)), np.zeros(20_000)])
    view = View.of(thin(floor, 0.1), np.array([0.0, 0.0, 4.0]))
    covered, far, near = view.compare(np.array([[0.0, 0.0, height], [40.0, 0.0, height]]))
    assert covered.tolist() == [True, False]
    np.testing.assert_allclose([far[0], near[0]], [beyond, before], atol=2.0)
