"""What is seen from a viewpoint is what nothing lies in front of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from directions import random_directions

from hpcapp.applications.surface.normals.evidence.inside import TIGHT, find_inside
from hpcapp.applications.surface.normals.evidence.seen_sides import Views
from hpcapp.applications.surface.normals.evidence.visibility import look, surround
from hpcapp.applications.surface.normals.patches import Patches
from hpcapp.geometry.points import BoolArray, FloatArray, Int8Array

SPACING = 0.02


def _patches(centres: FloatArray, normals: FloatArray) -> Patches:
    count = len(centres)
    ones = np.ones(count, np.int64)
    return Patches(np.arange(count), 0 * ones, 16 * ones, centres, normals, np.zeros(count))


def _ball(count: int = 3_000) -> Patches:
    arms = random_directions(count, 0)
    return _patches(arms, arms)


def _look_from(
    patches: Patches, place: list[float], spacing: float = SPACING
) -> tuple[Int8Array, BoolArray]:
    cosines, is_seen = look(patches, np.array([place]), spacing)
    return cosines[0], is_seen[0]


def _look_around(patches: Patches) -> Views:
    return Views.of(patches, surround(patches, 60)[2], 60, SPACING)


def test_half_of_a_ball_is_seen() -> None:
    ball = _ball()
    cosines, is_seen = _look_from(ball, [0.0, 0.0, 50.0])
    up = ball.centres[:, 2]
    assert np.allclose(cosines[cosines > 0] / 127.0, up[cosines > 0], atol=0.05)
    assert is_seen[up > 0.4].mean() > 0.3  # others in their pixel bend away from the nearest
    assert is_seen[up < -0.4].mean() < 0.1


@pytest.mark.parametrize("spacing", [SPACING, 1e-7])
def test_pixels_are_numbered_however_far_the_viewpoint_is(spacing: float) -> None:
    ball = _ball()
    _, is_seen = _look_from(ball, [0.0, 0.0, 1e13], spacing)
    assert is_seen[np.argmax(ball.centres[:, 2])]
    assert not is_seen[ball.centres[:, 2] < -0.9].any()


def test_all_of_a_ball_is_seen_from_within() -> None:
    _, is_seen = _look_from(_ball(), [0.1, 0.0, -0.2])
    assert is_seen.all()


def test_the_outside_is_seen_from_all_around() -> None:
    ball = _ball()
    views = _look_around(ball)
    assert (views.front > 5.0 * views.back).mean() > 0.97
    (places,) = find_inside(ball, SPACING, TIGHT)
    views = Views.inside(ball, places, SPACING)
    assert (views.back > 5.0 * views.front).all()


def test_both_sides_of_a_plate_are_told_apart() -> None:
    random = np.random.default_rng(1)
    flat = random.uniform(-1.0, 1.0, (4_000, 3)) * (1.0, 1.0, 0.0)
    signs = np.where(np.arange(len(flat)) % 2 == 0, 1.0, -1.0)
    flat[:, 2] = 0.02 * signs
    plate = _patches(flat, np.tile([0.0, 0.0, 1.0], (len(flat), 1)))
    views = _look_around(plate)
    assert ((views.front > views.back) == (signs > 0.0)).mean() > 0.97


@pytest.mark.parametrize("size", [1e-30, 1.0, 1e33])
def test_who_stands_on_a_patch_sees_what_there_is_to_see(size: float) -> None:
    one = np.ones(1, np.int64)
    patches = Patches(one, 0 * one, one, size * np.ones((1, 3)), np.eye(3)[:1], size * np.ones(1))
    cosines, is_seen = _look_from(patches, 3 * [size], size)
    assert cosines.tolist() == [0]
    assert is_seen.tolist() == [False]


def test_a_plane_across_an_edge_counts_where_it_is_seen_steeply() -> None:
    """However much it leaves, it is no more than 45 degrees off."""
    ball = _ball()
    bent = replace(ball, noise=np.where(np.arange(len(ball)) % 2 == 0, 0.0, 10.0 * SPACING))
    cosines, is_seen = _look_from(bent, [0.0, 0.0, 50.0])
    is_bent = bent.noise > 0.0
    usual, _ = _look_from(ball, [0.0, 0.0, 50.0])
    lost = (usual != 0) & (cosines == 0)
    assert (lost & is_bent & (np.abs(usual) < 0.7 * 127.0)).any()
    assert not (lost & ((np.abs(usual) > 0.72 * 127.0) | ~is_bent)).any()
    assert is_seen[cosines != 0].all()
