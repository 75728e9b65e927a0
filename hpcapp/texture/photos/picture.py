"""A photograph that is looked up at any size."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hpcapp.geometry.points import ByteArray, FloatArray


def read_picture(path: Path) -> ByteArray:
    """Return a photograph, shape (height, width, 3); OSError where it cannot be read."""
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


class Picture:
    """A photograph, and the same half as large, and again, as it is asked for."""

    def __init__(self, pixels: ByteArray) -> None:
        self._levels = [pixels]

    def find(self, places: FloatArray, widths: FloatArray) -> ByteArray:
        """Return colours at columns and rows (n, 2), of texels that are so many pixels wide."""
        levels = np.rint(np.log2(np.maximum(widths, 1.0))).astype(np.int64)
        while len(self._levels) <= levels.max(initial=0) and min(self._levels[-1].shape[:2]) >= 4:
            self._levels.append(_halve(self._levels[-1]))
        levels = np.minimum(levels, len(self._levels) - 1)
        colours = np.empty((len(places), 3), np.uint8)
        for level in np.unique(levels).tolist():
            rows = np.flatnonzero(levels == level)
            colours[rows] = _blend(self._levels[level], places[rows] / 2**level)
        return colours


def _halve(pixels: ByteArray) -> ByteArray:
    """Return a picture of the means of four pixels."""
    height, width = (side // 2 * 2 for side in pixels.shape[:2])
    whole = pixels[:height, :width]
    total = np.full((height // 2, width // 2, 3), 2, np.uint16)
    for row in (0, 1):
        for column in (0, 1):
            total += whole[row::2, column::2]
    return (total // 4).astype(np.uint8)


def _blend(pixels: ByteArray, places: FloatArray) -> ByteArray:
    """Return colours between the middles of pixels."""
    last = np.array(pixels.shape[1::-1]) - 1
    at = np.clip(places - 0.5, 0.0, last)
    low = np.minimum(at.astype(np.int64), np.maximum(last - 1, 0))
    right, down = (at - low).astype(np.float32).T[:, :, None]
    flat, width = pixels.reshape(-1, 3), pixels.shape[1]
    first = low[:, 1] * width + low[:, 0]
    upper, lower = (
        flat[start] * (1.0 - right) + flat.take(start + 1, axis=0, mode="clip") * right
        for start in (first, np.minimum(first + width, len(flat) - 1))
    )
    colours: ByteArray = np.rint(upper * (1.0 - down) + lower * down).astype(np.uint8)
    return colours
