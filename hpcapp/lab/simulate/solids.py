"""Primitive solids of analytic models, as fields: see `fields`."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial import KDTree

from hpcapp.geometry.points import FloatArray
from hpcapp.lab.simulate.fields import SolidField

Curve = Callable[[FloatArray], FloatArray]
Feet = Callable[[FloatArray], tuple[FloatArray, float | FloatArray]]

_TINY = 1e-300  # keeps 0/0 out of gradients at centres, where no direction is right


def ellipsoid(semi_axes: Sequence[float], center: Sequence[float] = (0.0, 0.0, 0.0)) -> SolidField:
    """Return an ellipsoid, min(a) (|p / a| - 1).

    Three equal semi-axes make a sphere and the exact distance.
    """
    axes = np.asarray(semi_axes, dtype=np.float64)
    middle = np.asarray(center, dtype=np.float64)
    shortest = float(axes.min())

    def gradient(points: FloatArray) -> FloatArray:
        scaled = (points - middle) / axes
        return scaled * (shortest / axes) / (_lengths(scaled) + _TINY)[:, None]

    return SolidField(
        lambda points: shortest * (_lengths((points - middle) / axes) - 1.0), gradient
    )


def torus(major: float, minor: float) -> SolidField:
    """Return a torus about the z axis, of a circle and a tube: exact distance to its surface."""

    def value(points: FloatArray) -> FloatArray:
        x, y, z = points.T
        away = np.sqrt(x * x + y * y) - major
        distance: FloatArray = np.sqrt(away * away + z * z) - minor
        return distance

    def feet(points: FloatArray) -> tuple[FloatArray, float]:
        radius = np.hypot(points[:, 0], points[:, 1]) + _TINY
        centers = np.zeros_like(points)
        centers[:, :2] = points[:, :2] * (major / radius)[:, None]
        return centers, minor

    return SolidField(value, _balls(feet).gradient)


def cone(
    start: Sequence[float], end: Sequence[float], start_radius: float, end_radius: float
) -> SolidField:
    """Return a limb: the hull of two balls, neither of which contains the other, exact distance.

    Equal radii make a capsule.
    """
    origin = np.asarray(start, dtype=np.float64)
    axis = np.asarray(end, dtype=np.float64) - origin
    length = float(np.linalg.norm(axis))
    axis /= length
    slope = (start_radius - end_radius) / length
    tangent = slope / np.sqrt(1.0 - slope * slope)

    def feet(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        local = points - origin
        along = local @ axis
        across = np.sqrt(np.maximum(np.einsum("ij,ij->i", local, local) - along**2, 0.0))
        # The ball of the hull that is nearest to a point lies downhill of its foot on the axis.
        nearest = np.clip(along - across * tangent, 0.0, length)
        return origin + nearest[:, None] * axis, start_radius - slope * nearest

    return _balls(feet)


def tube(curve: Curve, radius: float, samples: int = 512) -> SolidField:
    """Return a tube about a closed curve: the exact distance to the curve, less `radius`.

    The curve maps parameters t (n,), of period 2 pi, to itself and its first two derivatives, (3,
    3, n): derivative, axis, point. Its radius of curvature is everywhere larger than `radius`.

    So many samples seed the search for the nearest point. Two Newton steps from there square the
    error of half a sample's spacing twice, and that of the distance is its square: below rounding
    for any smooth curve. The gradient, which follows the foot, takes a third.
    """
    seeds = np.linspace(0.0, 2.0 * np.pi, samples, endpoint=False)
    tree = KDTree(curve(seeds)[0].T, leafsize=16)
    spacing = seeds[1]

    def feet(points: FloatArray, steps: int) -> FloatArray:
        t = seeds[tree.query(points)[1]]
        first = t
        x, y, z = points.T
        for _ in range(steps):
            center, tangent, bend = curve(t)
            offset = center[0] - x, center[1] - y, center[2] - z
            slope = offset[0] * tangent[0] + offset[1] * tangent[1] + offset[2] * tangent[2]
            curvature = offset[0] * bend[0] + offset[1] * bend[1] + offset[2] * bend[2]
            curvature += tangent[0] ** 2 + tangent[1] ** 2 + tangent[2] ** 2
            t = np.clip(t - slope / np.maximum(curvature, _TINY), first - spacing, first + spacing)
        centers: FloatArray = curve(t)[0].T
        return centers

    return SolidField(
        _balls(lambda points: (feet(points, 2), radius)).value,
        _balls(lambda points: (feet(points, 3), radius)).gradient,
    )


def box(center: Sequence[float], half: Sequence[float]) -> SolidField:
    """Return an axis-parallel box from its middle and half its edges, exact distance."""
    middle, extent = np.asarray(center, dtype=np.float64), np.asarray(half, dtype=np.float64)

    def value(points: FloatArray) -> FloatArray:
        return corner_distance(*(np.abs(points - middle) - extent).T)

    def gradient(points: FloatArray) -> FloatArray:
        local = points - middle
        slopes = np.stack(corner_slopes(*(np.abs(local) - extent).T), axis=1)
        return slopes * np.where(local < 0.0, -1.0, 1.0)

    return SolidField(value, gradient)


def cylinder(center: Sequence[float], axis: int, radius: float, half: float = np.inf) -> SolidField:
    """Return a cylinder along a coordinate axis, exact distance.

    `half` is half its length; infinite for a drill.
    """
    middle = np.asarray(center, dtype=np.float64)
    first, second = (k for k in range(3) if k != axis)

    def excess(points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        local = points - middle
        across = np.sqrt(local[:, first] ** 2 + local[:, second] ** 2)
        return local, across - radius, np.abs(local[:, axis]) - half

    def value(points: FloatArray) -> FloatArray:
        return corner_distance(*excess(points)[1:])

    def gradient(points: FloatArray) -> FloatArray:
        local, outward, along = excess(points)
        by_radius, by_length = corner_slopes(outward, along)
        slopes = local * (by_radius / (outward + radius + _TINY))[:, None]
        slopes[:, axis] = by_length * np.where(local[:, axis] < 0.0, -1.0, 1.0)
        return slopes

    return SolidField(value, gradient)


def half_space(normal: Sequence[float], offset: float) -> SolidField:
    """Return all points below a plane, exact distance.

    The normal points out of the solid, of any length; the offset along it is from the origin.
    """
    up = np.asarray(normal, dtype=np.float64)
    up = up / np.linalg.norm(up)
    return SolidField(
        lambda points: points @ up - offset, lambda points: np.tile(up, (len(points), 1))
    )


def corner_distance(*excess: FloatArray) -> FloatArray:
    """Return the distance (n,) to the corner where every `excess` is negative.

    Each is the distance (n,) to a surface at right angles to the others, negative inside. The
    result is exact where they are.
    """
    deepest, square = excess[0], np.maximum(excess[0], 0.0) ** 2
    for other in excess[1:]:
        deepest = np.maximum(deepest, other)
        square = square + np.maximum(other, 0.0) ** 2
    distance: FloatArray = np.sqrt(square) + np.minimum(deepest, 0.0)
    return distance


def corner_slopes(*excess: FloatArray) -> list[FloatArray]:
    """Return the derivatives of `corner_distance` by each excess, all of shape (n,)."""
    distance = corner_distance(*excess)
    deepest = np.argmax(excess, axis=0)
    is_inside = distance <= 0.0
    length = np.where(is_inside, 1.0, distance)
    return [
        np.where(is_inside, deepest == number, np.maximum(each, 0.0) / length)
        for number, each in enumerate(excess)
    ]


def _balls(feet: Feet) -> SolidField:
    """Return the union of balls of which `feet` tells the nearest: its centre and its radius."""

    def value(points: FloatArray) -> FloatArray:
        centers, radius = feet(points)
        return _lengths(points - centers) - radius

    def gradient(points: FloatArray) -> FloatArray:
        offset = points - feet(points)[0]
        return offset / (_lengths(offset) + _TINY)[:, None]

    return SolidField(value, gradient)


def _lengths(vectors: FloatArray) -> FloatArray:
    """Return the length of each row."""
    lengths: FloatArray = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
    return lengths
