from __future__ import annotations

import numpy as np
import pytest
from directions import random_directions

from hpcapp.applications.surface.field import hull as hulls
from hpcapp.geometry.points import FloatArray

SIZE = 0.1


def find_hull(positions: FloatArray, normals: FloatArray, size: float) -> FloatArray:
    return hulls.find_hull(positions, normals, size, -normals.mean(axis=0))


def dome(lowest: float) -> tuple[FloatArray, FloatArray]:
    """Cells of a unit ball that lies on a table at this height."""
    normals = random_directions(6000, 0)
    normals = normals[normals[:, 2] > lowest]
    return normals, normals


def hills(steepness: float) -> tuple[FloatArray, FloatArray]:
    """Cells of a square terrain."""
    x, y = np.random.default_rng(1).uniform(-1.0, 1.0, (2, 4000))
    slope = steepness * np.cos(5.0 * x)
    positions = np.column_stack([x, y, steepness * np.sin(5.0 * x) / 5.0])
    normals = np.column_stack([-slope, np.zeros(len(x)), np.ones(len(x))])
    return positions, normals / np.linalg.norm(normals, axis=1)[:, None]


@pytest.mark.parametrize("turn", [np.eye(3), np.linalg.qr(np.full((3, 3), 0.4) + np.eye(3))[0]])
def test_what_stood_on_a_table_is_closed_a_cell_below_its_rim(turn: FloatArray) -> None:
    positions, normals = dome(-0.4)
    hull = find_hull(positions @ turn.T, normals @ turn.T, SIZE)
    assert len(hull)
    down = turn @ [0.0, 0.0, -1.0]
    assert (hull[:, :3] @ down > 0.99).all()
    np.testing.assert_allclose(hull[:, 3], 0.4 + SIZE, atol=0.03)


def test_a_surface_seen_from_all_sides_is_not_cut() -> None:
    positions, normals = dome(-2.0)
    assert not len(find_hull(positions, normals, SIZE))


def test_a_small_hole_and_one_of_few_cells_are_left_to_the_field() -> None:
    assert not len(find_hull(*dome(-0.8), SIZE))
    assert not len(find_hull(*dome(-0.4), 0.25))


def test_a_hole_aside_is_not_where_the_object_stood() -> None:
    positions, normals = dome(-0.4)
    kept = positions[:, 0] < 0.85
    hull = find_hull(positions[kept], normals[kept], SIZE)
    assert len(hull)
    assert (hull[:, 2] < -0.9).all()


@pytest.mark.parametrize("steepness", [0.1, 0.5, 1.0])
def test_a_terrain_is_not_cut_below(steepness: float) -> None:
    positions, normals = hills(steepness)
    assert not len(find_hull(positions, normals, SIZE))


def test_a_room_seen_from_inside_is_not_cut() -> None:
    positions, normals = dome(-0.4)
    assert not len(find_hull(positions, -normals, SIZE))


def test_cells_in_a_plane_have_no_hull() -> None:
    positions = np.zeros((50, 3))
    positions[:, :2] = np.random.default_rng(2).normal(size=(50, 2))
    assert find_hull(positions, np.tile([0.0, 0.0, 1.0], (50, 1)), SIZE).shape == (0, 4)


def test_the_corners_normals_decide_with_a_margin() -> None:
    """A rim that looks away from the table by 10 degrees is cut there; by 20 it is no object's."""
    positions, normals = dome(-0.4)
    for angle, is_cut in ((10.0, True), (20.0, False)):
        tilted = normals.copy()
        tilted[:, 2] = np.maximum(tilted[:, 2], np.sin(np.deg2rad(angle)))
        tilted[:, :2] *= (np.sqrt(1 - tilted[:, 2] ** 2) / np.linalg.norm(tilted[:, :2], axis=1))[
            :, None
        ]
        assert bool(len(find_hull(positions, tilted, SIZE))) == is_cut
