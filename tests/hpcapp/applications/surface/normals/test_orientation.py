"""Patches find their side: that of free space, of scanners, of a camera, or up."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from directions import random_directions

from hpcapp.applications.surface.cloud.spacing import estimate_spacing
from hpcapp.applications.surface.normals.estimation import estimate_normals
from hpcapp.applications.surface.normals.evidence.linked import LinkedPatches
from hpcapp.applications.surface.normals.orientation import SURE, orient_patches
from hpcapp.applications.surface.normals.patches import find_patches, merge_patches, turn_points
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.geometry.points import FloatArray

FAR = np.full(3, 1e9)
FLOWN = Sensor("above")


def _orient(
    positions: FloatArray, zero: FloatArray = FAR, sensor: Sensor | None = None
) -> FloatArray:
    every, low = np.ones(len(positions), np.bool_), positions.min(axis=0)
    spacing = estimate_spacing(positions)
    vectors = estimate_normals(positions, every, low, spacing)
    found = find_patches(positions, vectors, every, low, spacing)
    sides = orient_patches(*found, spacing, zero, sensor or Sensor()).sides
    assert np.isfinite(sides.values).all()
    return turn_points(positions, vectors, low, spacing, sides)[0].astype(np.float64)


def _on_box(random: np.random.Generator, count: int) -> FloatArray:
    """Points on a cube of edge 2, as many per area everywhere."""
    box = random.uniform(-1.0, 1.0, (count, 3))
    axes, rows = random.integers(0, 3, count), np.arange(count)
    box[rows, axes] = np.sign(box[rows, axes])
    return box


def _share_outwards(normals: FloatArray, arms: FloatArray) -> float:
    return float((np.einsum("ij,ij->i", normals, arms) > 0.0).mean())


def _sheet() -> FloatArray:
    random = np.random.default_rng(0)
    sheet = random.uniform(-1.0, 1.0, (6_000, 3))
    sheet[:, 2] = 0.1 * np.sin(3.0 * sheet[:, 0])
    return sheet


def test_evidence_may_reach_a_few_patches_alone() -> None:
    """Fans of an echo sounder, each in a plane that is parallel to the view from above."""
    random = np.random.default_rng(0)
    along, across = (axis.ravel() for axis in np.mgrid[0:12, 0:12:0.05])
    bottom = 0.3 * np.sin(across) + random.normal(0.0, 0.02, len(along))
    fans = np.stack([along, across, bottom], axis=1)
    fans[along == 11.0, 0] += random.normal(0.0, 0.3, int((along == 11.0).sum()))
    assert np.linalg.norm(_orient(fans), axis=1) == pytest.approx(1.0, abs=1e-6)


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
    normals = _orient(_forest(), sensor=FLOWN)
    assert (normals[:9_000, 2] > 0.0).mean() > 0.99
    assert (normals[9_000:, 2] > 0.0).mean() > 0.99


def test_returns_say_nothing_of_what_is_as_high_as_wide() -> None:
    ball = random_directions(8_000, 5)
    assert _share_outwards(_orient(ball, sensor=FLOWN), ball) > 0.99


def test_what_lies_over_its_zero_needs_more_than_that_to_face_it() -> None:
    """Photogrammetry in local axes: x and y around 0, z the altitude."""
    sheet = _sheet() + np.array([0.0, 0.0, 4.0])
    assert (_orient(sheet, np.zeros(3))[:, 2] > 0.0).all()


def test_scanners_of_a_file_are_believed_if_they_could_see_it() -> None:
    sheet = _sheet()
    below, behind = np.array([[0.0, 0.0, -3.0]]), np.array([[0.0, 900.0, 0.0]])
    zero = np.array([0.5, 0.0, 0.0])
    assert (_orient(sheet, zero, Sensor("places", below - zero))[:, 2] < 0.0).all()
    assert (_orient(sheet, zero, Sensor("places", behind - zero))[:, 2] > 0.0).all()


@pytest.mark.parametrize("kind", ["above", "below"])
def test_what_the_user_says_wins(kind: Literal["above", "below"]) -> None:
    up = _orient(_sheet(), sensor=Sensor(kind, is_told=True))[:, 2]
    assert ((up > 0.0) == (kind == "above")).all()
    ball = random_directions(8_000, 5)
    normals = _orient(ball, sensor=Sensor(kind, is_told=True))
    caps = np.abs(ball[:, 2]) > 0.5  # what lies flat alone was seen
    assert ((normals[caps, 2] > 0.0) == (kind == "above")).mean() > 0.99


def test_who_was_inside_saw_the_inside() -> None:
    ball = random_directions(8_000, 7)
    assert _share_outwards(_orient(ball, sensor=Sensor("inside", is_told=True)), ball) < 0.01


def test_an_object_that_stood_on_a_table_faces_outwards() -> None:
    random = np.random.default_rng(8)
    ball = random_directions(12_000, random)
    dome = ball[ball[:, 2] > -0.3]
    bumpy = dome * (1.0 + 0.1 * np.sin(6.0 * dome[:, :1]) * np.sin(6.0 * dome[:, 1:2]))
    assert _share_outwards(_orient(bumpy, FAR), dome) > 0.99


def test_cavities_face_inwards_and_what_lies_in_them_outwards() -> None:
    random = np.random.default_rng(9)
    shells = [random_directions(count, random) for count in (16_000, 6_000, 1_500)]
    normals = _orient(np.concatenate([shells[0], 0.6 * shells[1], 0.3 * shells[2]]))
    outer, cavity, core = np.split(normals, [16_000, 22_000])
    assert _share_outwards(outer, shells[0]) > 0.99
    assert _share_outwards(cavity, shells[1]) < 0.01
    assert _share_outwards(core, shells[2]) > 0.99


def test_a_box_is_a_room_if_a_tripod_stood_in_it() -> None:
    random = np.random.default_rng(10)
    even = _on_box(random, 16_000)
    assert _share_outwards(_orient(even), even) > 0.99
    stand, half = np.array([1.2, -0.6, -0.2]), np.array([3.0, 2.0, 1.0])
    rays = random_directions(16_000, random)
    far = np.where(rays > 0.0, half - stand, half + stand) / np.maximum(np.abs(rays), 1e-9)
    room = stand + rays * far.min(axis=1)[:, None]
    room += random.normal(scale=0.001, size=room.shape)
    assert _share_outwards(_orient(room), room - stand) < 0.01


def test_a_corner_faces_what_stands_in_it() -> None:
    random = np.random.default_rng(12)
    walls = random.uniform(0.0, 1.0, (12_000, 3))
    walls[np.arange(len(walls)), random.integers(0, 3, len(walls))] = 0.0
    box = _on_box(random, 5_000)
    box = box[box[:, 2] > -1.0]
    seat = 0.15 * box + np.array([0.4, 0.4, 0.16])
    for axes in ([0, 1, 2], [1, 2, 0]):
        normals = _orient(np.concatenate([walls, seat])[:, axes])
        assert (normals[: len(walls)].sum(axis=1) > 0.5).mean() > 0.9
        assert _share_outwards(normals[len(walls) :], box[:, axes]) > 0.9


@pytest.mark.parametrize("thick", [0.8, 1.1, 1.6])
def test_the_sides_of_a_thin_wall_are_linked_as_two(thick: float) -> None:
    random = np.random.default_rng(8)
    sides = random.choice([-1.0, 1.0], 8_000)
    wall = np.column_stack([random.uniform(0.0, 8_000**0.5, (8_000, 2)), 0.5 * thick * sides])
    wall[:, 2] += 0.05 * random.normal(size=len(wall))
    every, low = np.ones(len(wall), np.bool_), wall.min(axis=0)
    patches, links = find_patches(wall, estimate_normals(wall, every, low, 1.0), every, low, 1.0)
    outwards = np.sign(patches.centres[:, 2] * patches.normals[:, 2])
    assert LinkedPatches(patches, links).share_broken(outwards) < 0.05


def test_a_side_that_nobody_knows_is_unsure_and_named() -> None:
    sheet = _sheet()[:, [0, 2, 1]] + np.array([7.0, 0.0, 0.0])  # is y up, or down?
    every, low, spacing = np.ones(len(sheet), np.bool_), sheet.min(axis=0), estimate_spacing(sheet)
    vectors = estimate_normals(sheet, every, low, spacing)
    found = find_patches(sheet, vectors, every, low, spacing)
    oriented = orient_patches(*found, spacing, FAR, Sensor())
    assert (np.abs(oriented.sides.values) < SURE).mean() > 0.9
    assert oriented.doubt is not None
    np.testing.assert_allclose(oriented.doubt.middle, [7.0, 0.0, 0.0], atol=0.2)
    assert oriented.doubt.rival is not None
    names = {oriented.doubt.reading.name, oriented.doubt.rival.name}
    assert names == {"+y", "-y"}


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
    assert others.arms.tolist() == links.arms.tolist()
