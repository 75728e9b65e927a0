"""Samples of scans: what is odd about a file decides no scale."""

from __future__ import annotations

import numpy as np
import pytest

from hpcapp.alignment.sample import sample_scan, thin
from hpcapp.geometry.points import FloatArray


@pytest.fixture
def floor() -> FloatArray:
    rng = np.random.default_rng(0)
    return np.column_stack([rng.uniform(0, 9, (5000, 2)), rng.normal(0, 0.01, 5000)])


def test_a_stray_at_the_origin_of_a_map_makes_no_box(floor: FloatArray) -> None:
    far = floor + np.array([5e5, 5e6, 300.0])
    sample = sample_scan(np.concatenate([far, np.zeros((3, 3))]))
    assert sample.extent == pytest.approx(sample_scan(floor).extent, rel=1e-6)
    assert len(sample.positions) == len(floor)


def test_points_that_a_file_has_five_times_lie_as_far_apart(floor: FloatArray) -> None:
    often = sample_scan(np.tile(floor, (5, 1)))
    assert often.spacing == sample_scan(floor).spacing


def test_a_wall_weighs_as_much_as_a_floor_ten_times_its_size(floor: FloatArray) -> None:
    wall = floor[:, [2, 0, 1]][floor[:, 1] < 0.9]
    cells = thin(np.concatenate([floor, wall]), 0.25)
    is_wall = np.abs(cells.normals[:, 0]) > 0.9
    is_floor = np.abs(cells.normals[:, 2]) > 0.9
    share = cells.weights[is_wall].sum() / cells.weights[is_floor].sum()
    assert share > 3 * is_wall.sum() / is_floor.sum()
