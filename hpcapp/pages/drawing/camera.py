"""An eye at an infinite distance: parallel projection, in which lengths can be measured."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.axes import turn_up
from hpcapp.geometry.points import FloatArray
from hpccomponent.dataclass import dataclass

SAMPLES = 3
"""Samples along each side of a pixel."""

Screen = NDArray[np.float32]
"""Columns, rows and nearness in samples, shape (n, 3): rows count downwards."""

_ROWS = 500_000  # positions that are projected at once


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """Where a picture is seen from, and which part of the world it shows.

    Parameters
    ----------
    axes : ndarray of float64, shape (3, 3)
        Rows: to the right, upwards, and towards the eye.
    middle : ndarray of float64, shape (3,)
        What is seen in the middle of the picture, along these axes.
    scale : float
        Samples per length unit.
    width, height : int
        Of the picture, in pixels.
    """

    axes: FloatArray
    middle: FloatArray
    scale: float
    width: int
    height: int

    @property
    def pixels_per_unit(self) -> float:
        """How long a length unit is in the picture."""
        return self.scale / SAMPLES

    def project(self, positions: FloatArray) -> Screen:
        """Return positions as the picture has them."""
        screen = np.empty((len(positions), 3), np.float32)
        half = 0.5 * SAMPLES * np.array([self.width, self.height])
        for begin in range(0, len(positions), _ROWS):
            part = slice(begin, begin + _ROWS)
            seen = (positions[part] @ self.axes.T - self.middle) * self.scale
            screen[part, 0] = half[0] + seen[:, 0]
            screen[part, 1] = half[1] - seen[:, 1]
            screen[part, 2] = seen[:, 2]
        return screen


def look_along(azimuth: float, elevation: float, up: str) -> FloatArray:
    """Return the axes (3, 3) of a camera whose eye is at these angles, in degrees.

    `up` is the axis of the world that points up, of `axis_names.AXES`.
    """
    az, el = np.radians([azimuth, elevation])
    eye = np.array([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)])
    right = np.array([-np.sin(az), np.cos(az), 0.0])
    axes = np.stack([right, np.cross(eye, right), eye])  # of a world whose z points up
    turned: FloatArray = axes @ turn_up(up)
    return turned


def turn_upright(positions: FloatArray, up: str) -> FloatArray:
    """Return positions, shape (..., 3), in a world whose z points up."""
    turned: FloatArray = positions @ turn_up(up).T
    return turned


def aim(
    axes: FloatArray, low: FloatArray, high: FloatArray, width: int, height: int, fill: float
) -> Camera:
    """Return the camera that shows a box between two corners along `axes`, in so many pixels.

    `fill` is the share of the picture that it takes, along the side where it is longest.
    """
    extent = np.maximum((high - low)[:2], 1e-300)
    scale = fill * SAMPLES * float((np.array([width, height]) / extent).min())
    return Camera(axes, 0.5 * (low + high), scale, width, height)
