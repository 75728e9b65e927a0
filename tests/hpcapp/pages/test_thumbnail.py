"""The picture of a cloud, decoded by hand: what is near covers what is behind it."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface.types.points import FloatArray, PointCloud
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


def decode(path: Path) -> NDArray[np.uint8]:
    """Return the pixels of a PNG without filters, each chunk checked."""
    content = path.read_bytes()
    assert content.startswith(b"\x89PNG\r\n\x1a\n")
    chunks, at = {}, 8
    while at < len(content):
        (length,) = struct.unpack_from(">I", content, at)
        name, body = content[at + 4 : at + 8], content[at + 8 : at + 8 + length]
        (check,) = struct.unpack_from(">I", content, at + 8 + length)
        assert check == zlib.crc32(name + body)
        chunks[name] = body
        at += 12 + length
    width, height, depth, kind = struct.unpack_from(">2I2B", chunks[b"IHDR"])
    assert (depth, kind) == (8, 2)
    rows = np.frombuffer(zlib.decompress(chunks[b"IDAT"]), np.uint8).reshape(height, 3 * width + 1)
    assert not rows[:, 0].any()
    return rows[:, 1:].reshape(height, width, 3)


def test_a_plate_hides_what_is_behind_it(tmp_path: Path) -> None:
    origin = np.array([5e5, 4e6, 0.0])
    write_thumbnail(tmp_path / "a.png", make_plates(origin), origin + np.array([0.0, -50.0, 0.0]))
    pixels = decode(tmp_path / "a.png")
    height, width = pixels.shape[:2]
    assert max(height, width) <= 512
    assert tuple(pixels[height // 2, width // 2]) == RED
    assert tuple(pixels[height // 2, width // 10]) == BLUE
    assert tuple(pixels[height // 10, width // 2]) == BLUE
    assert tuple(pixels[0, 0]) == (255, 255, 255)


def test_from_behind_the_other_plate_is_seen() -> None:
    cloud = make_plates(np.zeros(3))
    pixels = draw_points(cloud, np.array([0.0, 50.0, 0.0]))
    assert not (pixels == RED).all(axis=2).any()


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
        assert tuple(pixels[pixels.shape[0] // 2, pixels.shape[1] // 2]) == expected
    above = draw_points(cloud, eye=(0.0, 90.0), up="y", size=64)  # from where y is largest
    assert tuple(above[above.shape[0] // 2, above.shape[1] // 2]) == BLUE


def test_a_picture_of_one_point_has_it() -> None:
    drawn = (draw_points(PointCloud(np.full((1, 3), 7.0)), size=16) < 255).any(axis=2)
    assert drawn.any()
    assert max(drawn.shape) <= 16
