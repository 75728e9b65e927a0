"""Poses of many scans from those of pairs."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from hpcapp.alignment.graph import Link, spread_errors
from hpcapp.alignment.judge import Verdict
from hpcapp.alignment.pair import PairPose
from hpcapp.alignment.pose import difference, invert, make_pose, step_pose
from hpcapp.geometry.points import FloatArray

PLACES = np.random.default_rng(9).uniform(-1, 1, (50, 3))


def make_link(fixed: int, moved: int, pose: FloatArray, *stiffness: float) -> Link:
    verdict = Verdict(1.0, 0.5, 0.0)
    pair = PairPose(pose, verdict, 0.0, 0.0, 0.01, np.diag(stiffness), pose[:3, 3])
    return Link(fixed, moved, pair)


def make_ring(rng: np.random.Generator, error: float) -> tuple[list[FloatArray], list[Link]]:
    """Return true poses of eight scans, and links round them with small errors."""
    turns = Rotation.random(8, random_state=rng).as_matrix()
    poses = [np.eye(4), *(make_pose(turn, rng.normal(size=3)) for turn in turns[1:])]
    links = []
    for fixed in range(8):
        moved = (fixed + 1) % 8
        pose = invert(poses[fixed]) @ poses[moved]
        off = step_pose(pose, rng.normal(0, error, 6), pose[:3, 3])
        links.append(make_link(fixed, moved, off, *np.full(6, error**-2)))
    return poses, links


def chain(links: list[Link]) -> list[FloatArray | None]:
    poses = [np.eye(4)]
    for link in links[:-1]:
        poses.append(poses[-1] @ link.pair.pose)
    return [*poses]


def test_what_a_ring_lacks_is_spread_over_it() -> None:
    ratios = []
    for seed in range(2):
        truth, links = make_ring(np.random.default_rng(seed), 0.01)
        before = chain(links)
        after = spread_errors(before, links)
        errors = [
            [
                np.inf if pose is None else difference(pose, true, PLACES)
                for pose, true in zip(poses, truth, strict=True)
            ]
            for poses in (before, after)
        ]
        ratios.append(np.sum(errors[1]) / np.sum(errors[0]))
    assert np.mean(ratios) < 0.8  # by theory about .7 for eight


def test_an_overlap_that_slides_does_not_pull_that_way() -> None:
    shifted = make_pose(np.eye(3), np.array([5.0, 0.0, 0.0]))
    firm = [
        make_link(0, 1, np.eye(4), *np.full(6, 1e4)),
        make_link(1, 2, np.eye(4), *np.full(6, 1e4)),
    ]
    slides = make_link(0, 2, shifted, 1e4, 1e4, 1e4, 1e-6, 1e4, 1e4)
    poses = spread_errors([np.eye(4)] * 3, [*firm, slides])
    for pose in poses:
        assert pose is not None
        assert difference(pose, np.eye(4), PLACES) < 0.01


def test_scans_that_nothing_connects_have_no_pose() -> None:
    links = [make_link(0, 1, np.eye(4), *np.ones(6))]
    assert spread_errors([np.eye(4), np.eye(4), None], links)[2] is None
