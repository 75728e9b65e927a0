"""A picture of a point cloud: discs as large as the gaps between points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.points import ByteArray, FloatArray, PointCloud
from hpcapp.pages.drawing.camera import (
    SAMPLES,
    Camera,
    Screen,
    aim,
    look_along,
    turn_upright,
)
from hpcapp.pages.drawing.depth_buffer import DepthBuffer
from hpcapp.pages.drawing.light import GREY, light_normals
from hpcapp.pages.drawing.paint import paint
from hpcapp.pages.drawing.scale_bar import add_scale_bar
from hpcapp.pages.drawing.shadow import cast_shadow
from hpcapp.pages.png import write_png

IntArray = NDArray[np.int64]

_SIDE = 512  # pixels of the picture
_OBLIQUE = (-122.0, 25.0)  # azimuth and elevation, if no scanner is known
_TRIMMED = 0.002  # share of the points on each side that may lie outside of the picture
_MARGIN = 0.04  # around the others, in shares of their longer side
_POINTS_PER_CELL = 4.0  # of a square, whose disc has 0.8 of its side as radius
_WIDEST = 0.02  # a disc, in shares of the picture
_ROWS = 500_000  # points that are worked on at once
_NEAR, _FAR = 0.25, 0.84  # greys


def write_thumbnail(
    path: Path, cloud: PointCloud, scanner: FloatArray | None = None, unit: str | None = None
) -> None:
    """Draw a cloud into a PNG file, which appears whole or not at all.

    The points are seen from the scanner (3,), in the input's coordinates; the unit is for the scale
    bar. Raise OutputError where the file cannot be written.
    """
    write_png(path, draw_points(cloud, scanner, unit=unit))


def draw_points(
    cloud: PointCloud,
    scanner: FloatArray | None = None,
    *,
    eye: tuple[float, float] | None = None,
    size: int = _SIDE,
    up: str = "z",
    unit: str | None = None,
) -> NDArray[np.uint8]:
    """Draw finite points in their colours, else by normals, else by depth: what is near is dark.

    They are seen from the scanner (3,), in the input's coordinates, or the eye's azimuth and
    elevation in degrees, else from above and aside. The picture (h, w, 3) has at most so many
    pixels along the longer side, and is white where nothing is; the unit is for the scale bar.
    """
    is_finite = np.isfinite(cloud.positions).all(axis=1)
    if not is_finite.any():
        return np.full((size, size, 3), 255, np.uint8)
    if not is_finite.all():
        cloud = cloud.take(np.flatnonzero(is_finite))
    if eye is None:
        eye = _OBLIQUE if scanner is None else _find_eye(cloud, scanner, up)
    axes = look_along(*eye, up)
    # A few points far away must not make all others one pixel.
    ends = [np.quantile(cloud.positions @ axis, (_TRIMMED, 1.0 - _TRIMMED)) for axis in axes]
    low, high = np.array(ends).T
    sides = (high - low)[:2]
    sides = sides + 2.0 * _MARGIN * sides.max() if sides.any() else np.ones(2)
    width, height = np.maximum(np.ceil(size * sides / sides.max() - 1e-9), 1).astype(int).tolist()
    camera = aim(axes, low, high, width, height, fill=1.0 / (1.0 + 2.0 * _MARGIN))
    discs = _Discs(camera, cloud)

    def draw(below: Camera, buffer: DepthBuffer) -> None:
        for begin in range(0, len(cloud), _ROWS):
            screen = below.project(cloud.positions[begin : begin + _ROWS])
            buffer.draw_discs(screen, np.arange(len(screen)), 1.5)

    trimmed = [np.quantile(axis, (_TRIMMED, 1.0 - _TRIMMED)) for axis in cloud.positions.T]
    shadow = cast_shadow(camera, up, np.array(trimmed).T, draw)
    return add_scale_bar(paint(camera, discs, discs.nearness, shadow), camera.pixels_per_unit, unit)


def _find_eye(cloud: PointCloud, scanner: FloatArray, up: str) -> tuple[float, float]:
    """Return azimuth and elevation of a scanner, as seen from the middle of the points."""
    x, y, z = turn_upright(scanner - cloud.origin - np.median(cloud.positions, axis=0), up)
    if not (x or y or z):
        return _OBLIQUE
    return float(np.degrees(np.arctan2(y, x))), float(np.degrees(np.arctan2(z, np.hypot(x, y))))


class _Discs:
    """Points on the screen, each with a radius that closes the gap to its neighbours."""

    def __init__(self, camera: Camera, cloud: PointCloud) -> None:
        self._screen = camera.project(cloud.positions)
        self._levels, self._radii = _fit_radii(self._screen, camera)
        self._colours: ByteArray | None = cloud.colours
        self._normals = None if cloud.normals is None else cloud.normals.astype(np.float32)
        self._axes = camera.axes.astype(np.float32)
        depth = self._screen[:, 2]
        self.nearness = float(depth.min()) - 1.0 - 2.0 * max(self._radii), float(depth.max())
        self._far, self._near = np.quantile(depth, (0.01, 0.99))

    def enter(self, buffer: DepthBuffer) -> None:
        """Draw the points that reach into the band."""
        rows = self._screen[:, 1]
        for level, radius in enumerate(self._radii):
            is_near = (rows > buffer.rows[0] - radius - 1) & (rows < buffer.rows[1] + radius + 1)
            numbers = np.flatnonzero(is_near & (self._levels == level))
            buffer.draw_discs(self._screen, numbers, radius)

    def shade(self, item: IntArray, column: IntArray, row: IntArray) -> NDArray[np.float32]:
        """Return the shades of points."""
        del column, row
        shades: NDArray[np.float32]
        if self._colours is not None:
            shades = self._colours[item].astype(np.float32) / 255.0
        elif self._normals is not None:
            shades = np.full((len(item), 3), GREY, np.float32)
        else:
            near = (self._screen[item, 2] - self._far) / max(self._near - self._far, 1e-30)
            greys = _FAR + (_NEAR - _FAR) * np.clip(near, 0.0, 1.0)
            return np.repeat(greys[:, None], 3, axis=1).astype(np.float32)
        if self._normals is None:
            return shades
        normals = self._normals[item] @ self._axes.T
        normals *= np.where(normals[:, 2:] < 0.0, -1.0, 1.0).astype(np.float32)
        return shades * light_normals(normals, is_coloured=self._colours is not None)[:, None]


def _fit_radii(screen: Screen, camera: Camera) -> tuple[NDArray[np.uint8], list[float]]:
    """Return for each point the level of its disc, and the radius of each level in samples.

    The picture is cut into squares, then into ones of double side, and so on: a point has the
    level of the smallest square around it that holds enough points, but at most twice the radius
    of most points, so that stray ones are no balloons.
    """
    columns, rows = SAMPLES * camera.width, SAMPLES * camera.height
    column, row = (
        np.clip(screen[:, k], -1, most).astype(np.int16) for k, most in enumerate((columns, rows))
    )
    is_in = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    widest = max(2.0, _WIDEST * SAMPLES * max(camera.width, camera.height))
    levels = np.full(len(screen), 255, np.uint8)
    radii: list[float] = []
    while True:
        level = len(radii)
        side = 2.0 ** (0.5 * level)
        across = int(columns / side) + 2
        cell = (row / np.float32(side)).astype(np.int32)
        cell *= across
        cell += (column / np.float32(side)).astype(np.int32)
        np.maximum(cell, 0, out=cell)
        is_full = np.bincount(cell[is_in], minlength=int(cell.max()) + 1) >= _POINTS_PER_CELL
        levels[(levels == 255) & is_full[cell]] = level
        radii.append(0.8 * side)
        if side >= widest or (levels != 255).all():
            break
    middle = int(np.median(np.minimum(levels, len(radii) - 1)))
    most = min(len(radii) - 1, middle + 2)
    return np.minimum(levels, most).astype(np.uint8), radii[: most + 1]
