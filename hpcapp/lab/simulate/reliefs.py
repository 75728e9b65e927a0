"""Reliefs: smooth displacements of several scales along a solid's normals.

The surface is where the solid's field equals the relief: known exactly, and so are its normals.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hpcapp.geometry.axes import turn_by
from hpcapp.geometry.points import FloatArray
from hpcapp.lab.simulate.fields import SolidField
from hpccomponent.dataclass import dataclass


@dataclass(frozen=True, slots=True, eq=False)
class Relief:
    """A height at every position, outwards, with its gradient.

    The highest is the largest absolute height; the steepest the largest length of the gradient as
    far as `reach` from the undisplaced surface.
    """

    height: SolidField
    highest: float
    steepest: float

    @property
    def reach(self) -> float:
        """Return how far from the undisplaced surface heights are asked for, in length units."""
        return self.highest * (2.0 + self.steepest) / self.steepest


def displace(solid: SolidField, relief: Relief) -> SolidField:
    """Return a solid with a relief on its surface.

    solid - height changes by up to 1 + steepest, and is divided by it. No surface is nearer than
    |solid| - highest either: the larger of the two is taken, which changes no faster than the
    distance and needs no height away from the surface.
    """
    scale = 1.0 / (1.0 + relief.steepest)

    def bound(base: FloatArray) -> FloatArray:
        return np.sign(base) * np.maximum(np.abs(base) - relief.highest, 0.0)

    def value(points: FloatArray) -> FloatArray:
        base = solid.value(points)
        far = bound(base)
        near = np.flatnonzero(np.abs(base) < relief.reach)
        fine = scale * (base[near] - relief.height.value(points[near]))
        far[near] = np.where(np.abs(fine) >= np.abs(far[near]), fine, far[near])
        return far

    def gradient(points: FloatArray) -> FloatArray:
        base, slopes = solid.value(points), solid.gradient(points)
        near = np.flatnonzero(np.abs(base) < relief.reach)
        fine = scale * (base[near] - relief.height.value(points[near]))
        near = near[np.abs(fine) >= np.abs(bound(base[near]))]
        slopes[near] = scale * (slopes[near] - relief.height.gradient(points[near]))
        return slopes

    return SolidField(value, gradient)


def lumps(octaves: Sequence[tuple[float, float]], seed: int) -> Relief:
    """Return lumps of several sizes, as if the solid were cut out of a lumpy block.

    Octaves are the wavelength and height of each size; the seed turns and shifts them. Each is
    height sin(k u) sin(k v) sin(k w) in a frame (u, v, w) of its own, with k = 2 pi / wavelength.
    Its gradient is never longer than height k.
    """
    rng = np.random.default_rng(seed)
    waves = []
    for length, height in octaves:
        turn = rng.standard_normal(4)
        frame = (2.0 * np.pi / length) * turn_by(turn / np.linalg.norm(turn))
        waves.append((height, frame, rng.uniform(0.0, 2.0 * np.pi, 3)))

    def value(points: FloatArray) -> FloatArray:
        total = np.zeros(len(points))
        for height, frame, shift in waves:
            u, v, w = np.sin(points @ frame.T + shift).T
            total += height * (u * v * w)
        return total

    def gradient(points: FloatArray) -> FloatArray:
        total = np.zeros_like(points)
        for height, frame, shift in waves:
            phase = points @ frame.T + shift
            (u, v, w), (du, dv, dw) = np.sin(phase).T, np.cos(phase).T
            total += height * (np.stack([du * v * w, u * dv * w, u * v * dw], axis=1) @ frame)
        return total

    highest = sum(height for _, height in octaves)
    steepest = sum(2.0 * np.pi * height / length for length, height in octaves)
    return Relief(SolidField(value, gradient), highest, steepest)


def studs(major: float, minor: float, around: tuple[int, int], height: float) -> Relief:
    """Return rows of studs and pits on a torus of two radii about the z axis.

    `around` counts the studs along the circle and about the tube: height cos(m u) cos(n v) in the
    two angles. The gradient grows towards the tube's circle; the bound holds for two fifths of the
    way.
    """
    m, n = around
    inner = 0.6 * minor

    def angles(points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        x, y, z = points.T
        radius = np.sqrt(x * x + y * y)
        out = radius - major
        return radius, out, m * np.arctan2(y, x), n * np.arctan2(z, out)

    def value(points: FloatArray) -> FloatArray:
        _, _, along, about = angles(points)
        heights: FloatArray = height * np.cos(along) * np.cos(about)
        return heights

    def gradient(points: FloatArray) -> FloatArray:
        x, y, z = points.T
        radius, out, along, about = angles(points)
        by_along = -m * height * np.sin(along) * np.cos(about) / radius**2
        by_about = -n * height * np.cos(along) * np.sin(about) / (out**2 + z**2)
        inward = -z * by_about / radius
        return np.stack(
            [-y * by_along + x * inward, x * by_along + y * inward, out * by_about], axis=1
        )

    steepest = height * max(m / (major - 2.0 * minor + inner), n / inner)
    return Relief(SolidField(value, gradient), height, steepest)
