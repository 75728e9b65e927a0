"""Where a camera's picture shows what lies in front of it: focal length, distortion, size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpccomponent.dataclass import dataclass

_WIDEST = 2.75
"""Tangent of the angle off the axis, 70 degrees, beyond which nothing is taken from a picture: of
a fisheye the rim, which is the least sharp."""
_STEPS = 2048
_BEYOND = 1.1  # times the farthest corner: tangential distortion and skew move less
_ALIKE = 0.02  # of the ratio of the sides: a small picture is rounded to whole pixels


@dataclass(frozen=True, slots=True)
class Lens:
    """A lens of the Brown or the fisheye model, as OpenCV and COLMAP write them.

    A direction (x, y, 1), y down, has the radius r = sqrt(x^2 + y^2); a fisheye takes the angle
    atan(r) in its place. It is multiplied by (1 + k1 r^2 + k2 r^4 + ..) / (1 + d1 r^2 + ..), moved
    by the tangential terms, and becomes a pixel.

    Parameters
    ----------
    size : tuple of float
        Width and height of the picture that `focal` and `offset` are of; 0 where unknown.
    focal : tuple of float
        Across and down, in pixels.
    offset : tuple of float
        Of the principal point from the middle of the picture, in pixels.
    radial, divisor : tuple of float
        k1, k2, ..; d1, d2, ..
    tangential : tuple of float
        p1, p2.
    skew : float
        Pixels to the right for each unit down.
    """

    size: tuple[float, float]
    focal: tuple[float, float]
    offset: tuple[float, float] = (0.0, 0.0)
    radial: tuple[float, ...] = ()
    divisor: tuple[float, ...] = ()
    tangential: tuple[float, float] = (0.0, 0.0)
    skew: float = 0.0
    is_fisheye: bool = False

    def __post_init__(self) -> None:
        numbers = (*self.size, *self.focal, *self.offset, *self.radial, *self.divisor)
        is_number = np.isfinite((*numbers, *self.tangential, self.skew)).all()
        if not is_number or min(self.focal) <= 0.0 or min(self.size) < 0.0:
            raise ValueError(f"a lens has the focal length {self.focal}"[:200])

    def fit(self, width: int, height: int) -> Lens:
        """Return the lens of a picture of another size; ValueError where the sides do not fit."""
        own_width, own_height = self.size
        scale = width / own_width if own_width else 1.0
        if own_height and abs(own_height * scale / height - 1.0) > _ALIKE:
            own = f"{own_width:g} x {own_height:g}"
            raise ValueError(f"has {width} x {height} pixels, and its camera {own}")
        return replace(
            self,
            size=(float(width), float(height)),
            focal=(self.focal[0] * scale, self.focal[1] * scale),
            offset=(self.offset[0] * scale, self.offset[1] * scale),
            skew=self.skew * scale,
        )

    def find_reach(self) -> float:
        """Return the tangent of the angle off the axis beyond which nothing is taken.

        There the picture ends, or the distortion, made for what is in it, turns back.
        """
        tangents = np.linspace(0.0, _WIDEST, _STEPS + 1)[1:]
        radii = np.arctan(tangents) if self.is_fisheye else tangents
        bent = radii * self._bend(radii * radii)
        corner = np.hypot(*(0.5 * np.array(self.size) + np.abs(self.offset))) / min(self.focal)
        ends = (np.diff(bent, prepend=0.0) <= 0.0) | (bent > _BEYOND * corner)
        end = int(np.argmax(ends)) if ends.any() else _STEPS - 1
        return float(tangents[end])

    def project(self, seen: FloatArray) -> FloatArray:
        """Return the pixels (n, 2) of directions (n, 2), as x and y at a distance of 1.

        Columns and rows count from the upper left corner of the picture.
        """
        x, y = seen.T
        squares = x * x + y * y
        if self.is_fisheye:
            radii = np.sqrt(squares)
            angles = np.arctan(radii)
            scale = np.divide(angles, radii, out=np.ones_like(radii), where=radii > 0.0)
            x, y, squares = scale * x, scale * y, angles * angles
        bend = self._bend(squares)
        p1, p2 = self.tangential
        right = x * bend + 2.0 * p1 * x * y + p2 * (squares + 2.0 * x * x)
        down = y * bend + p1 * (squares + 2.0 * y * y) + 2.0 * p2 * x * y
        middle = 0.5 * np.array(self.size) + self.offset
        return np.stack([
            middle[0] + self.focal[0] * right + self.skew * down,
            middle[1] + self.focal[1] * down,
        ], axis=1)  # fmt: skip

    def _bend(self, squares: FloatArray) -> FloatArray:
        """Return by how much radii grow, given their squares."""
        return _sum_powers(self.radial, squares) / _sum_powers(self.divisor, squares)


def _sum_powers(factors: tuple[float, ...], squares: FloatArray) -> FloatArray:
    """Return 1 + f1 s + f2 s^2 + .."""
    total = np.zeros_like(squares)
    for factor in reversed(factors):
        total = (total + factor) * squares
    return total + 1.0
