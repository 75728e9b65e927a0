"""Photographs of known paint on the mesh of the things that they show."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from painted_scene import (
    BALLS,
    cast,
    find_things,
    make_mesh,
    make_shots,
    paint,
    tell_things,
    to_srgb,
    write_shots,
)

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.io.cameras.lens import Lens
from hpcapp.io.cameras.poses import Camera
from hpcapp.texture.atlas import unwrap
from hpcapp.texture.photos.exposure import Exposures
from hpcapp.texture.photos.folder import find_photos
from hpcapp.texture.photos.painting import Painted
from hpcapp.texture.photos.painting import paint as paint_by
from hpcapp.texture.photos.view import Looks, View
from hpcapp.texture.request import Photo
from hpcapp.texture.texels import Texels, cover

PIXELS, SIZE = 320, (240, 180)
SHOTS = make_shots(8, SIZE)


class Made(NamedTuple):
    mesh: Mesh
    places: FloatArray
    photos: Sequence[Photo]
    painted: Painted


class Compared(NamedTuple):
    """Of all texels on the mesh: where they are, on what, and what they should and do show."""

    on: FloatArray
    things: IntArray
    truth: FloatArray
    shown: FloatArray
    is_seen: BoolArray


def compare(made: Made, painted: Painted) -> Compared:
    parts = list(cover(made.places, made.mesh.faces, PIXELS))
    at = np.concatenate([part.blend(made.mesh.vertices, made.mesh.faces) for part in parts])
    cells = np.concatenate([part.cells for part in parts])
    on, things = find_things(at)
    shown = painted.colours[cells].astype(float)
    return Compared(on, things, to_srgb(paint(on, things)), shown, painted.is_seen[cells])


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    folder = tmp_path_factory.mktemp("scene")
    cameras = write_shots(folder / "images", SHOTS)
    photos = find_photos(str(folder / "images"), [str(cameras)])
    mesh, _ = make_mesh(32)
    atlas = unwrap(mesh, PIXELS)
    assert mesh.normals is not None
    cut = Mesh(mesh.vertices[atlas.sources], atlas.faces, normals=mesh.normals[atlas.sources])
    painted = paint_by(cut, atlas.places, PIXELS, photos, lambda _: None)
    return Made(cut, atlas.places, photos, painted)


def test_texels_have_the_paint_of_the_things(made: Made) -> None:
    """Exposures that differ by 1.5 move colours by 25 of 255."""
    found = compare(made, made.painted)
    off = np.abs(found.shown - found.truth).max(axis=1)[found.is_seen]
    assert np.median(off) < 1.5
    assert np.quantile(off, 0.97) < 8.0
    assert made.painted.photos == len(SHOTS)


def test_nothing_is_painted_through_what_is_in_front(made: Made) -> None:
    """The balls hide the ground and each other; the ground hides nothing."""
    found = compare(made, made.painted)
    told = tell_things(found.shown)
    is_ball = (told > 0) & (found.shown.max(axis=1) > 30.0)  # the ground ends before black
    assert not (is_ball & (told != found.things) & found.is_seen).any()


def test_what_a_camera_sees_is_seen(made: Made) -> None:
    found = compare(made, made.painted)
    is_visible = np.zeros(len(found.on), bool)
    for shot in SHOTS:
        arms = found.on - shot.place
        lengths = np.linalg.norm(arms, axis=1)
        far, _ = cast(np.broadcast_to(shot.place, arms.shape), arms / lengths[:, None])
        is_visible |= far > lengths - 1e-3
    assert not (found.is_seen & ~is_visible).any()
    assert (found.is_seen | ~is_visible).mean() > 0.93  # the others are seen from the side alone
    under = found.things == 1
    under &= found.on[:, 2] < BALLS[0, 2] - 0.9 * BALLS[0, 3]
    assert not found.is_seen[under].any()


def test_no_seam_is_left_where_the_photographs_change(made: Made) -> None:
    """Texels side by side differ as the truth does: exposures alone are steps of up to 25."""
    off = np.full((PIXELS * PIXELS, 3), np.nan)
    found = compare(made, made.painted)
    cells = np.concatenate([part.cells for part in cover(made.places, made.mesh.faces, PIXELS)])
    off[cells[found.is_seen]] = (found.shown - found.truth)[found.is_seen]
    steps = np.abs(np.diff(off.reshape(PIXELS, PIXELS, 3), axis=1)).max(axis=2)
    assert np.nanquantile(steps, 0.95) < 4.0


def test_the_order_of_the_photographs_changes_nothing_that_is_seen(made: Made) -> None:
    again = paint_by(made.mesh, made.places, PIXELS, made.photos[::-1], lambda _: None)
    assert (again.is_seen == made.painted.is_seen).all()
    assert np.abs(again.colours.astype(int) - made.painted.colours).max() <= 1


def test_what_nobody_sees_takes_the_nearest_colour(made: Made) -> None:
    find = made.painted.find_nearest(made.mesh, made.places)
    below = np.array([[0.0, 0.0, BALLS[0, 2] - BALLS[0, 3]], [1.9, 1.9, 0.0]])
    assert tell_things(find(below).astype(float)).tolist() in ([0, 0], [1, 0])


def test_a_photograph_that_cannot_be_read_is_left_out(
    made: Made, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    whole = made.photos[0].path.read_bytes()
    (tmp_path / "cut.png").write_bytes(whole[: len(whole) // 2])
    photos = [replace(made.photos[0], path=tmp_path / "cut.png"), made.photos[1]]
    painted = paint_by(made.mesh, made.places, PIXELS, photos, lambda _: None)
    assert painted.photos == 1
    assert "cut.png: cannot be read, and is left out" in caplog.text


def look_at_wall(slope: float, front: float | None) -> float:
    """Return which share of a wall behind a front at that distance is seen from 10 away.

    The wall turns from the camera by the slope: its depth for each unit across.
    """
    wall = np.array([[-1, -1, 10 - slope], [1, -1, 10 + slope], [1, 1, 10 + slope],
                     [-1, 1, 10 - slope]], float)  # fmt: skip
    vertices, faces = wall, np.array([[0, 2, 1], [0, 3, 2]])
    if front is not None:
        vertices = np.concatenate([wall, [[-9, -9, front], [9, -9, front], [0, 9, front]]])
        faces = np.concatenate([faces, [[4, 6, 5]]])
    normal = np.cross(wall[2] - wall[0], wall[1] - wall[0])
    normals = np.tile(normal / np.linalg.norm(normal), (len(vertices), 1))
    lens = Lens((1600.0, 1600.0), (4000.0, 4000.0))
    view = View(Mesh(vertices, faces, normals=normals), Camera(np.zeros(3), np.eye(3)), lens)
    weights = np.random.default_rng(0).dirichlet([1, 1, 1], 2000)
    own = np.flatnonzero(view.faces < 2)
    texels = Texels(np.arange(2000), np.resize(own, 2000), weights)
    return len(view.look(texels).rows) / 2000


@pytest.mark.parametrize("slope", [0.0, 1.0, 4.0])
def test_a_wall_does_not_hide_itself(slope: float) -> None:
    """At up to 76 degrees, with no other tolerance than its slope from sample to sample."""
    assert look_at_wall(slope, None) > 0.97


@pytest.mark.parametrize(("slope", "front"), [(0.0, 9.97), (0.0, 5.0), (1.0, 8.9), (4.0, 5.9)])
def test_what_is_before_a_wall_hides_it(slope: float, front: float) -> None:
    assert look_at_wall(slope, front) == 0.0


def test_a_floor_that_goes_on_behind_the_camera_is_seen() -> None:
    floor = np.array([[-9, 4, -9], [9, 4, -9], [9, 4, 9], [-9, 4, 9]], float)
    normals = np.tile([0.0, -1.0, 0.0], (4, 1))
    mesh = Mesh(floor, np.array([[0, 1, 2], [0, 2, 3]]), normals=normals)
    view = View(mesh, Camera(np.zeros(3), np.eye(3)), Lens((1000.0, 1000.0), (300.0, 300.0)))
    assert view.faces.tolist() == [0, 1]
    weights = np.array([[0.1, 0.3, 0.6], [0.0, 0.5, 0.5], [0.6, 0.2, 0.2]])  # at z 7.2, 9, -1.8
    looks = view.look(Texels(np.arange(3), np.ones(3, int), weights))
    assert looks.rows.tolist() == [0, 1]


def look_straight(at: FloatArray, lens: Lens, turn: float = 0.0, step: float = 0.0) -> Looks:
    """Return how places (n, 2) across and down on a wall 10 away are seen.

    The wall turns from the camera by some degrees; to the right of the middle is another one,
    nearer by the step.
    """
    slope = np.tan(np.radians(turn))
    wall = np.array([[x, y, 10.0 + slope * x] for x, y in [(-9, -9), (9, -9), (9, 9), (-9, 9)]])
    vertices, faces = wall, np.array([[0, 2, 1], [0, 3, 2]])
    if step:
        vertices = np.concatenate([wall, wall * (1, 1, 0) + (9.0, 0.0, 10.0 - step)])
        faces = np.concatenate([faces, faces + 4])
    normal = np.array([slope, 0.0, -1.0]) / np.hypot(slope, 1.0)
    mesh = Mesh(vertices, faces, normals=np.tile(normal, (len(vertices), 1)))
    view = View(mesh, Camera(np.zeros(3), np.eye(3)), lens)
    # weights of the corners 0, 2 and 1 of the first face, on which x is above y
    x, y = (at.T + 9.0) / 18.0
    weights = np.stack([1.0 - x, y, x - y], axis=1)
    return view.look(Texels(np.arange(len(at)), np.zeros(len(at), int), weights))


WIDE = Lens((1000.0, 1000.0), (1000.0, 1000.0))


def test_a_photograph_counts_less_at_its_border() -> None:
    """In its outer 3 %, of the score of the middle."""
    pixels = np.array([500.0, 965.0, 985.0, 993.0])
    at = np.stack([(pixels - 500.0) / 100.0, np.full(4, -0.1)], axis=1)
    looks = look_straight(at, WIDE)
    straight = looks.scores * (1.0 + (at**2).sum(axis=1) / 100.0) ** 2  # without angle and distance
    assert straight / straight[0] == pytest.approx([1.0, 1.0, 0.5, 7 / 30], rel=0.02)
    assert not len(look_straight(np.array([[5.02, -0.1]]), WIDE).rows)


@pytest.mark.parametrize(("degrees", "is_seen"), [(0, True), (79, True), (81, False)])
def test_what_is_seen_from_the_side_alone_is_left_out(degrees: float, is_seen: bool) -> None:
    looks = look_straight(np.array([[0.0, -0.1]]), WIDE, turn=degrees)
    assert bool(len(looks.rows)) is is_seen
    if is_seen:
        assert looks.scores[0] == pytest.approx(1e4 * np.cos(np.radians(degrees)) ** 2, rel=0.01)


@pytest.mark.parametrize("step", [0.1, 1.0])
def test_a_photograph_counts_less_before_an_edge(step: float) -> None:
    """From a step of 2 % of the distance on, up to 7 samples beside it."""
    pixels = 500.0 - np.array([12.0, 5.0, 1.0])
    at = np.stack([(pixels - 500.0) / 100.0, np.full(3, -2.0)], axis=1)
    looks = look_straight(at, WIDE, step=step)
    scores = np.zeros(3)
    scores[looks.rows] = looks.scores
    assert scores[0] == pytest.approx(1e4, rel=0.1)
    if step > 0.2:
        assert 0.2 < scores[1] / scores[0] < 0.8
        assert scores[2] == 0.0
    else:
        assert scores[1:] == pytest.approx(scores[0], rel=0.1)


@pytest.mark.parametrize("ratio", [1.0, 1.5, 3.0])
def test_exposures_are_those_of_the_light(ratio: float) -> None:
    rng = np.random.default_rng(4)
    light = rng.uniform(0.05, 0.3, (5000, 3))
    gains = np.array([1.0, ratio, ratio**0.5])
    colours = [np.rint(to_srgb(gain * light)).astype(np.uint8) for gain in gains]
    exposures = Exposures(4)
    one = np.zeros(5000, int)
    for number in (1, 2):
        exposures.add(one, np.full(5000, number), colours[0], colours[number])
    solved = exposures.solve()
    assert solved[0] / solved[1] == pytest.approx(np.full(3, ratio), rel=0.01)
    assert solved[0] / solved[2] == pytest.approx(np.full(3, ratio**0.5), rel=0.01)
    assert solved[:3].prod(axis=0) == pytest.approx(np.ones(3), rel=0.01)
    assert solved[3].tolist() == [1.0, 1.0, 1.0]
