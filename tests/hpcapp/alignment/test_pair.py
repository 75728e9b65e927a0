"""Poses of pairs against their truth, and what tells that they are sure."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from stands import scan_stands, true_pose

from hpcapp.alignment.judge import Judge
from hpcapp.alignment.pair import SLIDES, align_pair
from hpcapp.alignment.pose import difference, make_pose, move, shift_pose
from hpcapp.alignment.refinement import refine
from hpcapp.alignment.viewpoint import see_scan
from hpcapp.geometry.points import FloatArray


def scan_pipe(start: float, rng: np.random.Generator) -> FloatArray:
    """Return points of a straight pipe that are seen from within."""
    angles, along = rng.uniform(0, 2 * np.pi, 6000), rng.uniform(-5, 5, 6000) + start
    points = np.column_stack([along, np.cos(angles), np.sin(angles)])
    points += rng.normal(0, 0.003, points.shape)
    return move(
        make_pose(Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3)), points
    )


@pytest.mark.slow
def test_a_pipe_that_fits_anywhere_is_never_sure() -> None:
    rng = np.random.default_rng(0)
    first, second = (see_scan(scan_pipe(start, rng)) for start in (0.0, 2.0))
    pair = align_pair(first, second)
    assert pair.verdict.worth > 0.5  # it fits well
    assert not pair.is_sure
    assert pair.slid_worth > SLIDES * 1.05 * pair.verdict.worth


def test_scans_that_are_registered_nearly_need_no_search() -> None:
    first, second = scan_stands()
    off = make_pose(Rotation.from_rotvec([0.01, 0.0, 0.02]).as_matrix(), np.full(3, 0.05))
    near = move(off @ true_pose(), second[0])
    pair = align_pair(see_scan(first[0]), see_scan(near), given=np.eye(4))
    placed = move(pair.pose, near)
    assert np.abs(placed - move(true_pose(), second[0])).max() < 0.02


@pytest.mark.parametrize("few", ["two places", "a speck"])
def test_what_shows_no_surface_beside_the_other_is_never_sure(few: str) -> None:
    rng = np.random.default_rng(0)
    room = see_scan(scan_stands()[0][0])
    places = rng.normal(0, 1e-4, (800, 3))
    if few == "two places":
        places[::2, 0] += 9.0
    for pair in (align_pair(room, see_scan(places)), align_pair(see_scan(places), room)):
        assert not pair.is_sure


def test_a_pose_farther_off_than_was_said_is_never_sure() -> None:
    first, second = (see_scan(points) for points, _ in scan_stands())
    pair = align_pair(first, second, near=1e-3, given=true_pose() @ shift_pose(np.full(3, 0.05)))
    assert pair.verdict.worth > 0.5
    assert not pair.is_sure


def test_what_a_scanner_has_looked_through_speaks_against_a_pose() -> None:
    fixed, moved = (see_scan(points) for points, _ in scan_stands())
    judge = Judge(fixed, moved, fixed.extent / 60)
    local = shift_pose(-fixed.centre) @ true_pose() @ shift_pose(moved.centre)
    right = judge.judge(local)
    aside = shift_pose(np.array([0.8, 0.8, 0.0])) @ local
    wrong = judge.judge(aside)
    assert right.through < 0.02
    assert wrong.through > 0.05
    assert wrong.worth < 0 < right.worth


def test_refinement_comes_back_from_some_edges_of_a_cell() -> None:
    fixed, moved = (see_scan(points) for points, _ in scan_stands())
    edge = fixed.extent / 60
    judge = Judge(fixed, moved, edge)
    local = shift_pose(-fixed.centre) @ true_pose() @ shift_pose(moved.centre)
    refined = refine(judge, shift_pose(np.full(3, edge)) @ local)
    assert difference(refined.pose, local, moved.positions) < 0.3 * edge
