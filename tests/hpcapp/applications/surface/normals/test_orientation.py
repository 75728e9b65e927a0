"""Patches find their side: that of free space, of scanners, of a camera, or up."""

from __future__ import annotations

import numpy as np

from hpcapp.applications.surface.cloud.spacing import estimate_spacing
from hpcapp.applications.surface.normals.estimation import estimate_normals
from hpcapp.applications.surface.normals.orientation import orient_patches
from hpcapp.applications.surface.normals.patches import find_patches, merge_patches, turn_points
from hpcapp.applications.surface.types.points import FloatArray

FAR = np.full(3, 1e9)


def _orient(
    positions: FloatArray,
    zero: FloatArray = FAR,
    scanners: FloatArray | None = None,
    is_flown: bool = False,
) -> FloatArray:
    every, low = np.ones(len(positions), np.bool_), positions.min(axis=0)
    spacing = estimate_spacing(positions)
    vectors = estimate_normals(positions, every, low, spacing)
    found = find_patches(positions, vectors, every, low, spacing)
    sides = orient_patches(*found, spacing, zero, scanners, is_flown=is_flown)
    return turn_points(positions, vectors, low, spacing, sides)[0].astype(np.float64)


def _sheet() -> FloatArray:
    random = np.random.default_rng(0)
    sheet = random.uniform(-1.0, 1.0, (6_000, 3))
    sheet[:, 2] = 0.1 * np.sin(3.0 * sheet[:, 0])
    return sheet


def test_ground_faces_up() -> None:
    assert (_orient(_sheet())[:, 2] > 0.0).all()


def _forest() -> FloatArray:
    """Ground under crowns that leave no view of it."""
    random = np.random.default_rng(4)
    ground = random.uniform(-10.0, 10.0, (9_000, 3))
    ground[:, 2] = 0.3 * np.sin(0.5 * ground[:, 0])
    crowns = random.uniform(-10.0, 10.0, (16_000, 3))
    crowns[:, 2] = 3.0 + np.abs(np.sin(1.5 * crowns[:, 0]) * np.sin(1.5 * crowns[:, 1]))
    return np.concatenate([ground, crowns])


def test_what_was_flown_over_faces_up_whatever_hides_it() -> None:
    normals = _orient(_forest(), is_flown=True)
    assert (normals[:9_000, 2] > 0.0).mean() > 0.99
    assert (normals[9_000:, 2] > 0.0).mean() > 0.99


def test_returns_say_nothing_of_what_is_as_high_as_wide() -> None:
    random = np.random.default_rng(5)
    ball = random.normal(size=(8_000, 3))
    ball /= np.linalg.norm(ball, axis=1)[:, None]
    normals = _orient(ball, is_flown=True)
    assert (np.einsum("ij,ij->i", normals, ball) > 0.0).mean() > 0.99


def test_a_depth_image_faces_its_camera() -> None:
    sheet = _sheet() + np.array([0.0, 0.0, 4.0])
    assert (_orient(sheet, np.zeros(3))[:, 2] < 0.0).all()


def test_scanners_are_believed_if_they_could_see_it() -> None:
    sheet = _sheet()
    below, behind = np.array([[0.0, 0.0, -3.0]]), np.array([[0.0, 900.0, 0.0]])
    assert (_orient(sheet, FAR, below)[:, 2] < 0.0).all()
    assert (_orient(sheet, FAR, behind)[:, 2] > 0.0).all()


def test_a_room_with_something_in_it_is_seen_from_inside() -> None:
    random = np.random.default_rng(3)
    walls = random.uniform(-1.0, 1.0, (14_000, 3))
    axes, rows = random.integers(0, 3, len(walls)), np.arange(len(walls))
    walls[rows, axes] = np.sign(walls[rows, axes])
    box = random.uniform(-1.0, 1.0, (5_000, 3))
    axes, rows = random.integers(0, 3, len(box)), np.arange(len(box))
    box[rows, axes] = np.sign(box[rows, axes])
    furniture = 0.25 * box + np.array([0.0, 0.0, -0.6])
    normals = _orient(np.concatenate([walls, furniture]))
    inwards = -np.einsum("ij,ij->i", normals[: len(walls)], walls)
    assert (inwards > 0.0).mean() > 0.98
    outwards = np.einsum("ij,ij->i", normals[len(walls) :], box)
    assert (outwards > 0.0).mean() > 0.95


def test_patches_of_regions_are_those_of_the_whole() -> None:
    positions = _sheet()
    low, spacing = positions.min(axis=0), estimate_spacing(positions)
    every = np.ones(len(positions), np.bool_)
    vectors = estimate_normals(positions, every, low, spacing)
    whole, links = merge_patches([find_patches(positions, vectors, every, low, spacing)])
    left = positions[:, 0] < 0.1
    parts = [find_patches(positions, vectors, some, low, spacing) for some in (left, ~left)]
    patches, others = merge_patches(parts)
    assert patches.centres.tobytes() == whole.centres.tobytes()
    assert patches.normals.tobytes() == whole.normals.tobytes()
    assert others.first.tolist() == links.first.tolist()
    assert others.second.tolist() == links.second.tolist()
    assert others.contacts.tolist() == links.contacts.tolist()
