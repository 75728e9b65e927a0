"""From the samples of a depth buffer to the pixels of a picture, a band of rows at a time."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hpcapp.pages.drawing.camera import SAMPLES, Camera
from hpcapp.pages.drawing.depth_buffer import DepthBuffer, list_bands
from hpcapp.pages.drawing.light import darken_hollows, reach_of_hollows
from hpcapp.pages.drawing.shadow import GroundShadow

_SHADED = 200_000  # samples that are shaded at once

IntArray = NDArray[np.int64]


class Drawn(Protocol):
    """Things that can be drawn: each item has a shade at each sample that it covers."""

    def enter(self, buffer: DepthBuffer) -> None:
        """Draw all that may be seen in the rows of a depth buffer."""

    def shade(self, item: IntArray, column: IntArray, row: IntArray) -> NDArray[np.float32]:
        """Return the shades of items at samples, shape (n, 3), in shares of white."""


def paint(
    camera: Camera, drawn: Drawn, nearness: tuple[float, float], shadow: GroundShadow | None
) -> NDArray[np.uint8]:
    """Return a picture (h, w, 3) on white ground, behind it the shadow, if there is one.

    Nearness is that of the farthest and of the nearest thing, in samples.
    """
    size = max(camera.width, camera.height)
    beside = reach_of_hollows(size)
    picture = np.empty((camera.height, camera.width, 3), np.uint8)
    for begin, end in list_bands(SAMPLES * camera.height, SAMPLES * camera.width, SAMPLES):
        first, last = begin // SAMPLES, end // SAMPLES
        top, bottom = max(0, first - beside), min(camera.height, last + beside)
        rows = (SAMPLES * top, SAMPLES * bottom)
        buffer = DepthBuffer(rows, SAMPLES * camera.width, nearness)
        drawn.enter(buffer)
        nearest = buffer.nearness(SAMPLES)
        nearest /= SAMPLES
        light = darken_hollows(nearest, size)[first - top :]
        shades, cover = _average(drawn, buffer, camera.width)
        inner = slice(first - top, last - top)
        shades = shades[inner] * light[: last - first, :, None]
        behind = np.ones((last - first, camera.width))
        if shadow is not None:
            behind -= shadow.darkness((first, last), camera.width)
        shades += ((1.0 - cover[inner]) * behind)[..., None]
        picture[first:last] = 255.0 * np.clip(shades, 0.0, 1.0) + 0.5
    return picture


def _average(
    drawn: Drawn, buffer: DepthBuffer, width: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the shades of pixels, shape (h, w, 3), times the share of each that is covered."""
    height = (buffer.rows[1] - buffer.rows[0]) // SAMPLES
    shades = np.zeros((height * width, 3), np.float32)
    cover = np.zeros(height * width, np.float32)
    places, items = buffer.find_items()
    for begin in range(0, len(places), _SHADED):
        part = slice(begin, begin + _SHADED)
        row, column = np.divmod(places[part], buffer.width)
        values = np.clip(drawn.shade(items[part], column, row + buffer.rows[0]), 0.0, 1.0)
        pixel = row // SAMPLES * width + column // SAMPLES
        first = int(pixel.min())
        pixel -= first
        count = int(pixel.max()) + 1
        cover[first : first + count] += np.bincount(pixel)
        for k in range(3):
            shades[first : first + count, k] += np.bincount(pixel, values[:, k])
    shades /= SAMPLES**2
    cover /= SAMPLES**2
    return shades.reshape(height, width, 3), cover.reshape(height, width)
