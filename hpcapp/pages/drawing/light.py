"""Light on surfaces and points: two lamps at the eye, and less of both in hollows."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

GREY = (0.80, 0.82, 0.86)
"""What has no colours, in shares of white."""

_KEY = np.array([-0.43, 0.53, 0.73], np.float32)  # over the left shoulder
_FILL = np.array([0.6, -0.5, 0.6], np.float32)  # a weaker one from below
_REACHES = (0.0016, 0.005, 0.013)  # of hollows, in shares of the picture's longer side
_STRENGTH = 1.6

Floats = NDArray[np.float32]
Any = TypeVar("Any", bound=np.generic)


def light_normals(normals: Floats, *, is_coloured: bool) -> Floats:
    """Return the light on surfaces of unit normals (n, 3): to the right, upwards, to the eye.

    Colours have seen a light of their own already: they get a softer one.
    """
    key, fill = np.maximum(normals @ _KEY, 0.0), np.maximum(normals @ _FILL, 0.0)
    light: Floats = 0.20 + 0.74 * key + 0.24 * fill
    return 0.4 + 0.6 * light if is_coloured else light


def reach_of_hollows(size: int) -> int:
    """Return how many pixels around a pixel its light depends on, in a picture of such a size."""
    return max(_steps(size))


def darken_hollows(nearness: Floats, size: int) -> Floats:
    """Return the share (h, w) of the light that reaches each pixel of a picture this long.

    What lies behind the mean of two opposite neighbours is in a hollow; a slope is not. Nearness
    (h, w) is in pixels; -inf where nothing is.
    """
    is_drawn = np.isfinite(nearness)
    depth = np.where(is_drawn, nearness, 0.0).astype(np.float32)
    hollow = np.zeros(depth.shape, np.float32)
    for step in _steps(size):
        for down, across in ((0, step), (step, 0), (step, step), (step, -step)):
            pair = _shift(depth, down, across) + _shift(depth, -down, -across) - 2.0 * depth
            is_pair = _shift(is_drawn, down, across) & _shift(is_drawn, -down, -across)
            hollow += np.clip(np.where(is_pair, pair, 0.0) / (4.0 * step), 0.0, 1.0)
    shade: Floats = np.exp(-_STRENGTH / (4 * len(_REACHES)) * hollow)
    return shade


def _steps(size: int) -> list[int]:
    return [max(1, round(reach * size)) for reach in _REACHES]


def _shift(values: NDArray[Any], down: int, across: int) -> NDArray[Any]:
    """Return for each pixel the value of the one that lies so far from it; zero beyond the edge."""
    shifted = np.zeros_like(values)
    height, width = values.shape
    if abs(down) >= height or abs(across) >= width:
        return shifted
    to_rows = slice(max(0, -down), height - max(0, down))
    of_rows = slice(max(0, down), height - max(0, -down))
    to_columns = slice(max(0, -across), width - max(0, across))
    of_columns = slice(max(0, across), width - max(0, -across))
    shifted[to_rows, to_columns] = values[of_rows, of_columns]
    return shifted
