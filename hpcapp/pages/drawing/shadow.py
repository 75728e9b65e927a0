"""The soft shadow of things on the level ground below them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from hpcapp.geometry.axes import turn_up
from hpcapp.geometry.points import FloatArray
from hpcapp.pages.drawing.camera import SAMPLES, Camera, turn_upright
from hpcapp.pages.drawing.depth_buffer import DepthBuffer

_CELLS = 192  # along a side of the map of the ground
_MARGIN = 0.2  # on each side of what casts the shadow, in shares of its size
# Each shadow: its darkness, how far it is blurred and how high up its thing may be, in shares
_SHADOWS = ((0.30, 0.012, 0.05), (0.26, 0.06, 0.5))
_LOWEST = 3.0  # degrees above the ground, from where it is seen at all


class GroundShadow:
    """A map (c, c) of the ground at a level, and how dark it is, from 0 to 1.

    The map was drawn by the camera below; the other one sees it.
    """

    def __init__(self, camera: Camera, below: Camera, map_: FloatArray, level: float) -> None:
        # The ground's place is linear in column and row of a pixel.
        self._corner = _find_ground(camera, below, level, 0.0, 0.0)
        self._across = _find_ground(camera, below, level, 1.0, 0.0) - self._corner
        self._down = _find_ground(camera, below, level, 0.0, 1.0) - self._corner
        self._map = map_

    def darkness(self, rows: tuple[int, int], width: int) -> FloatArray:
        """Return how dark the ground is in some rows of pixels, shape (rows, width)."""
        row, column = np.mgrid[rows[0] : rows[1], 0:width] + 0.5
        place = (
            self._corner[:, None, None]
            + self._across[:, None, None] * column
            + self._down[:, None, None] * row
        )
        dark: FloatArray = map_coordinates(self._map, place[::-1] - 0.5, order=1)
        return dark


def cast_shadow(
    camera: Camera, up: str, bounds: FloatArray, draw: Callable[[Camera, DepthBuffer], None]
) -> GroundShadow | None:
    """Return the shadow on the ground below what `draw` draws; None where it cannot be seen.

    Bounds (2, 3) are around all that casts it; `draw` draws into a depth buffer, as a camera sees
    it.
    """
    axes = turn_upright(camera.axes, up)
    if axes[2, 2] < np.sin(np.radians(_LOWEST)):
        return None
    corners = turn_upright(bounds, up)
    low, high = corners.min(axis=0), corners.max(axis=0)
    extent = float((high - low).max()) or 1.0
    below_axes = np.diag([1.0, -1.0, -1.0]) @ turn_up(up)
    middle = 0.5 * (low + high) * [1.0, -1.0, -1.0]
    scale = _CELLS / ((1.0 + 2.0 * _MARGIN) * extent)
    side = _CELLS // SAMPLES
    below = Camera(below_axes, middle, scale, side, side)
    # From below: the lowest thing above each cell of the ground is the nearest one.
    half = 0.5 * extent * scale
    buffer = DepthBuffer((0, _CELLS), _CELLS, (-half, half))
    draw(below, buffer)
    height = (0.5 * (high - low)[2] * scale - buffer.nearness(1)) / (extent * scale)
    light = np.ones((_CELLS, _CELLS))
    for darkness, blur, reach in _SHADOWS:
        cover = np.exp(-np.maximum(height, 0.0) / reach)
        light *= 1.0 - darkness * gaussian_filter(cover.astype(np.float64), blur * _CELLS)
    return GroundShadow(camera, below, 1.0 - light, float(low[2]))


def _find_ground(
    camera: Camera, below: Camera, level: float, column: float, row: float
) -> NDArray[np.float64]:
    """Return the cell of the ground, column and row, that a place of the picture shows."""
    upward = -below.axes[2]
    seen = np.array([column - 0.5 * camera.width, 0.5 * camera.height - row, 0.0])
    place = (seen / camera.pixels_per_unit + camera.middle) @ camera.axes
    # Along the line of sight down to the level of the ground.
    place = place + (level - place @ upward) / (camera.axes[2] @ upward) * camera.axes[2]
    along = (place @ below.axes.T - below.middle) * below.scale
    return np.array([0.5 * _CELLS + along[0], 0.5 * _CELLS - along[1]])
