"""Pictures: what must be covered, hidden or tinted."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import BoolArray, ByteArray
from hpcapp.pages.drawing import depth_buffer
from hpcapp.pages.png import write_png
from hpcapp.pages.render import render_mesh

SQUARE = np.array([[0.0, 0, 0], [0, 1, 0], [0, 1, 1], [0, 0, 1]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])  # anticlockwise as seen from +x


def is_background(picture: ByteArray) -> BoolArray:
    values: BoolArray = (picture == 255).all(axis=2)
    return values


def is_back(picture: ByteArray) -> BoolArray:
    red, green, blue = (picture[..., k].astype(int) for k in range(3))
    values: BoolArray = (red > 1.15 * blue) & (red < 1.5 * blue) & (green > 0.75 * red)
    return values


def test_a_square_covers_its_share_of_the_picture() -> None:
    picture = render_mesh(Mesh(SQUARE, FACES), azimuth=0, elevation=0, size=100)
    assert (~is_background(picture)).mean() == pytest.approx(0.92**2, abs=0.01)


def test_back_faces_are_tinted() -> None:
    behind = render_mesh(Mesh(SQUARE, FACES), azimuth=180, elevation=0, size=40)
    before = render_mesh(Mesh(SQUARE, FACES), azimuth=0, elevation=0, size=40)
    assert is_back(behind)[20, 20]
    assert not is_back(before).any()


def test_the_nearer_face_hides_the_farther_in_whichever_order() -> None:
    two = np.concatenate([SQUARE, SQUARE[::-1] - [1, 0, 0]])  # the farther one shows its back
    faces = np.concatenate([FACES, FACES + 4])
    single = render_mesh(Mesh(SQUARE, FACES), azimuth=0, elevation=0, size=40)
    for order in (faces, faces[::-1]):
        assert np.array_equal(render_mesh(Mesh(two, order), 0, 0, 40), single)


def test_an_empty_mesh_is_an_empty_picture() -> None:
    empty = Mesh(np.empty((0, 3)), np.empty((0, 3), dtype=np.int64))
    assert is_background(render_mesh(empty, size=16)).all()


def test_a_png_holds_the_rows_of_the_picture(tmp_path: Path) -> None:
    picture = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    write_png(tmp_path / "p.png", picture)
    content = (tmp_path / "p.png").read_bytes()
    assert content[:8] == b"\x89PNG\r\n\x1a\n"
    assert struct.unpack(">II", content[16:24]) == (7, 5)
    with Image.open(tmp_path / "p.png") as image:
        assert np.array_equal(np.asarray(image), picture)


def make_ball(rings: int) -> Mesh:
    """Return a ball of radius 1 on the ground, whose faces are as coarse as its rings are few."""
    turn, rise = np.meshgrid(
        np.linspace(0, 2 * np.pi, 2 * rings, endpoint=False), np.linspace(0, np.pi, rings + 1)
    )
    x, y, z = np.sin(rise) * np.cos(turn), np.sin(rise) * np.sin(turn), 1 + np.cos(rise)
    row, column = (axis.ravel() for axis in np.mgrid[0:rings, 0 : 2 * rings])
    right = (column + 1) % (2 * rings)
    a, b = row * 2 * rings + column, row * 2 * rings + right
    c, d = a + 2 * rings, b + 2 * rings
    faces = np.concatenate([np.stack([a, c, d], axis=1), np.stack([a, d, b], axis=1)])
    return Mesh(np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1), faces)


def test_a_ball_is_smooth_and_its_outline_too() -> None:
    picture = render_mesh(make_ball(40), azimuth=10, elevation=0, size=200).astype(int)
    middle = picture[100, 40:160, 0]  # without facets no two neighbours differ much
    assert np.abs(np.diff(middle)).max() <= 4
    assert len(np.unique(middle)) > 20
    rim = [row[np.argmax(row < 255)] for row in picture[30:170, :, 0]]
    assert max(rim) > 220  # pixels of which a share is covered
    assert min(rim) < 160


def test_the_edges_of_a_box_stay_sharp() -> None:
    corners = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(8, 3)
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))])
    picture = render_mesh(Mesh(corners.astype(float), faces), 45, 20, 200)
    top, left = picture[45, 90:110, 0].astype(int), picture[120, 60:80, 0].astype(int)
    assert np.ptp(top) <= 1
    assert np.ptp(left) <= 1
    assert abs(top[0] - left[0]) > 5


def test_the_ground_below_is_in_the_shadow_and_far_from_it_is_not() -> None:
    picture = render_mesh(make_ball(20), azimuth=0, elevation=30, size=200)
    below = picture[198, 100]  # the lower edge of the ball is above it
    assert (below < 250).all()
    assert is_background(picture)[:20, :20].all()
    from_the_ground = render_mesh(make_ball(20), azimuth=0, elevation=0, size=200)
    assert is_background(from_the_ground)[199].all()


def test_near_walls_of_a_room_are_left_out() -> None:
    room, thing = make_ball(30), make_ball(10)
    vertices = np.concatenate([3.0 * room.vertices, 0.8 * thing.vertices + [0.0, 0, 2]])
    faces = np.concatenate([room.faces[:, ::-1], thing.faces + len(room.vertices)])
    colours = np.full((len(vertices), 3), 200, np.uint8)
    colours[len(room.vertices) :] = (0, 0, 255)
    picture = render_mesh(Mesh(vertices, faces, colours=colours), 20, 20, 100)
    blue = picture[..., 2].astype(int) > 2 * picture[..., 1].astype(int)
    assert 0.02 < blue.mean() < 0.1  # the thing in the room
    assert not is_back(picture).any()


@pytest.mark.parametrize(("share", "is_room"), [(0.27, False), (0.53, True)])
def test_a_room_is_told_by_the_fronts_that_its_backs_hide(share: float, is_room: bool) -> None:
    before = SQUARE * [1, 1, share] + [1.0, 0, 0]  # a wall that shows its back
    mesh = Mesh(np.concatenate([SQUARE, before]), np.concatenate([FACES, FACES[:, ::-1] + 4]))
    backs = is_back(render_mesh(mesh, 0, 0, 100)).mean()
    assert backs == pytest.approx(0.0 if is_room else share * 0.92**2, abs=0.01)


@pytest.mark.parametrize("up", ["x", "y"])
def test_every_axis_can_point_up(up: str) -> None:
    ball = make_ball(16)
    turned = Mesh(np.roll(ball.vertices * [1, 1, 2], "xyz".index(up) - 2, axis=1), ball.faces)
    upright = Mesh(ball.vertices * [1, 1, 2], ball.faces)
    seen, expected = render_mesh(turned, 20, 25, 90, up), render_mesh(upright, 20, 25, 90)
    assert np.abs(seen.astype(int) - expected).max() <= 2


def test_colours_change_from_corner_to_corner() -> None:
    colours = np.array([[255, 0, 0], [255, 0, 0], [0, 0, 255], [0, 0, 255]], np.uint8)
    picture = render_mesh(Mesh(SQUARE, FACES, colours=colours), azimuth=0, elevation=0, size=60)
    column = picture[6:54, 30].astype(int)
    assert (column[:5, 2] > 2 * column[:5, 0]).all()  # blue above
    assert (column[-5:, 0] > 2 * column[-5:, 2]).all()  # red below
    assert (np.diff(column[:, 0]) >= 0).all()


def test_bands_leave_no_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = render_mesh(make_ball(30), size=150)
    monkeypatch.setattr(depth_buffer, "SAMPLES_PER_BAND", 450 * 30)
    assert np.array_equal(render_mesh(make_ball(30), size=150), whole)


def test_faces_far_smaller_and_far_larger_than_pixels_are_drawn() -> None:
    fine = make_ball(150)
    large = Mesh(SQUARE * 10 - [5.0, 5, 0], FACES)
    both = Mesh(
        np.concatenate([fine.vertices, large.vertices]),
        np.concatenate([fine.faces, large.faces + len(fine.vertices)]),
    )
    picture = render_mesh(both, 0, 0, 60)
    assert not is_background(picture)[6:54, 6:54].any()
