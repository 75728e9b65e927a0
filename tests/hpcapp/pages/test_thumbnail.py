"""The picture of a cloud: what is near covers what is behind it, and no gaps are left."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hpcapp.geometry.points import ByteArray, FloatArray, PointCloud
from hpcapp.pages.thumbnail import draw_points, write_thumbnail

RED, BLUE = (200, 10, 10), (10, 10, 200)


def make_plates(origin: FloatArray) -> PointCloud:
    """Return a red plate before a larger blue one, as seen from where y is least."""
    across = np.linspace(-1, 1, 101)
    x, z = (axis.ravel() for axis in np.meshgrid(across, across))
    near = np.stack([0.5 * x, np.full(x.shape, -1.0), 0.5 * z], axis=1)
    far = np.stack([x, np.ones(x.shape), z], axis=1)
    colours = np.repeat(np.array([RED, BLUE], np.uint8), len(x), axis=0)
    return PointCloud(np.vstack([near, far]), colours=colours, origin=origin)


def is_of(pixel: ByteArray, colour: tuple[int, int, int]) -> bool:
    """Say whether a pixel has a colour, perhaps in a weaker light."""
    light = pixel.astype(float).sum() / sum(colour)
    return bool(0.5 < light < 1.01 and np.abs(pixel - light * np.array(colour)).max() < 6)


def test_a_plate_hides_what_is_behind_it(tmp_path: Path) -> None:
    origin = np.array([5e5, 4e6, 0.0])
    write_thumbnail(tmp_path / "a.png", make_plates(origin), origin + np.array([0.0, -50.0, 0.0]))
    with Image.open(tmp_path / "a.png") as image:
        pixels = np.asarray(image)
    height, width = pixels.shape[:2]
    assert max(height, width) <= 512
    assert is_of(pixels[height // 2, width // 2], RED)
    assert is_of(pixels[height // 2, width // 10], BLUE)
    assert is_of(pixels[height // 10, width // 2], BLUE)
    assert tuple(pixels[0, 0]) == (255, 255, 255)


def test_from_behind_the_other_plate_is_seen() -> None:
    cloud = make_plates(np.zeros(3))
    pixels = draw_points(cloud, np.array([0.0, 50.0, 0.0]))
    red, _, blue = np.moveaxis(pixels.astype(int), 2, 0)
    assert (red > blue + 50).mean() < 0.001


def test_without_colours_what_is_near_is_dark() -> None:
    cloud = PointCloud(make_plates(np.zeros(3)).positions)
    pixels = draw_points(cloud, np.array([0.0, -50.0, 0.0]))
    height, width = pixels.shape[:2]
    middle, side = pixels[height // 2, width // 2], pixels[height // 2, width // 10]
    assert middle[0] == middle[1] == middle[2] < side[0]


def test_a_point_far_away_does_not_shrink_the_others() -> None:
    plates = make_plates(np.zeros(3)).positions
    cloud = PointCloud(np.vstack([plates, [[1e6, 1e6, 1e6], [np.nan, 0, 0]]]))
    drawn = (draw_points(cloud) < 255).any(axis=2)
    assert drawn.mean() > 0.2


def test_clouds_of_few_points_are_drawn() -> None:
    for positions in (np.zeros((0, 3)), np.zeros((1, 3)), np.full((2, 3), np.nan)):
        assert draw_points(PointCloud(positions)).shape[2] == 3


def test_points_are_seen_from_where_the_user_says() -> None:
    cloud = make_plates(np.zeros(3))  # red at y = -1, blue at y = 1
    for azimuth, expected in ((-90.0, RED), (90.0, BLUE)):
        pixels = draw_points(cloud, eye=(azimuth, 0.0), size=64)
        assert max(pixels.shape[:2]) <= 64
        assert is_of(pixels[pixels.shape[0] // 2, pixels.shape[1] // 2], expected)
    above = draw_points(cloud, eye=(0.0, 90.0), up="y", size=64)  # from where y is largest
    assert is_of(above[above.shape[0] // 2, above.shape[1] // 2], BLUE)


def test_a_picture_of_one_point_has_it() -> None:
    drawn = (draw_points(PointCloud(np.full((1, 3), 7.0)), size=16) < 255).any(axis=2)
    assert drawn.any()
    assert max(drawn.shape) <= 16


def test_points_of_a_surface_leave_no_gaps_whatever_their_number() -> None:
    rng = np.random.default_rng(1)
    for points in (2_000, 50_000):
        sheet = PointCloud(np.column_stack([rng.random((points, 2)), np.zeros(points)]))
        pixels = draw_points(sheet, eye=(0.0, 90.0), size=300)
        inner = (pixels[30:-30, 30:-30] < 250).any(axis=2)
        assert inner.mean() > 0.97


def test_a_lone_point_is_a_disc() -> None:
    pair = PointCloud(np.array([[0.0, 0, 0], [0, 0, 1]]))
    drawn = draw_points(pair, eye=(0.0, 0.0), size=400)[..., 0] < 240
    rows, columns = np.nonzero(drawn[: len(drawn) // 4])
    height, width = np.ptp(rows) + 1, np.ptp(columns) + 1
    assert abs(height - width) <= 1
    assert len(rows) == pytest.approx(np.pi / 4 * height * width, rel=0.15)


def test_normals_shade_points() -> None:
    rng = np.random.default_rng(2)
    ball = rng.normal(size=(20_000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    pixels = draw_points(PointCloud(ball, ball), eye=(0.0, 0.0), size=100).astype(int)
    assert pixels[30, 35, 0] > pixels[75, 75, 0] + 30  # the lamp is above and to the left
