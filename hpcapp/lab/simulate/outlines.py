"""Plane outlines, and the solids that are drawn or turned from them, as fields: see `fields`.

Distances are exact, inside and outside, so that those to the solids are.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpcapp.lab.simulate.fields import SolidField
from hpcapp.lab.simulate.solids import corner_distance, corner_slopes

_TINY = 1e-300  # keeps 0/0 out of gradients at centres, where no direction is right


def disc(center: Sequence[float], radius: float) -> SolidField:
    """Return a disc, as a field of plane positions of shape (n, 2)."""
    x, y = center

    def arms(points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        across, along = points[:, 0] - x, points[:, 1] - y
        return across, along, np.sqrt(across * across + along * along)

    def gradient(points: FloatArray) -> FloatArray:
        across, along, length = arms(points)
        return np.stack([across, along], axis=1) / (length + _TINY)[:, None]

    return SolidField(lambda points: arms(points)[2] - radius, gradient)


def polygon(corners: Sequence[Sequence[float]]) -> SolidField:
    """Return a polygon, as a field of plane positions (n, 2), of counter-clockwise corners.

    Sides do not meet elsewhere. The nearest side gives the distance; a ray to the left that crosses
    an odd number of sides tells the inside.
    """
    starts = np.asarray(corners, dtype=np.float64)
    sides = np.roll(starts, -1, axis=0) - starts
    edges = list(zip(starts.tolist(), sides.tolist(), strict=True))
    tiny = 1e-12 * float(np.abs(sides).max())

    def value(points: FloatArray) -> FloatArray:
        x, y = points[:, 0], points[:, 1]
        square = np.full(len(points), np.inf)
        is_inside = np.zeros(len(points), np.bool_)
        for (start_x, start_y), (side_x, side_y) in edges:
            across, along = x - start_x, y - start_y
            share = across * side_x + along * side_y
            share *= 1.0 / (side_x * side_x + side_y * side_y)
            share = np.minimum(np.maximum(share, 0.0), 1.0)
            off_x, off_y = across - share * side_x, along - share * side_y
            square = np.minimum(square, off_x * off_x + off_y * off_y)
            if side_y:
                # The half-open side's ends count once where two sides meet.
                spans = (along >= 0.0) != (y - (start_y + side_y) >= 0.0)
                is_inside ^= spans & ((side_x * along - side_y * across) * side_y < 0.0)
        distance: FloatArray = np.where(is_inside, -1.0, 1.0) * np.sqrt(square)
        return distance

    def gradient(points: FloatArray) -> FloatArray:
        # (n, k, 2): from the start of each of k sides; (n, k): the nearest place on it, 0 to 1
        arms = points[:, None] - starts
        share = np.clip(np.einsum("nki,ki->nk", arms, sides) / (sides**2).sum(axis=1), 0.0, 1.0)
        arms -= share[..., None] * sides
        # (n,): the nearest side of each point; what follows is of that side alone
        rows, nearest = np.arange(len(points)), (arms**2).sum(axis=2).argmin(axis=1)
        share, arm, side = share[rows, nearest], arms[rows, nearest], sides[nearest]
        out = np.stack([side[:, 1], -side[:, 0]], axis=1)
        out /= np.sqrt((side**2).sum(axis=1))[:, None]
        # Beyond a side's end the corner is nearest, and the direction is that to the corner.
        length = np.sqrt((arm**2).sum(axis=1))
        is_corner = ((share == 0.0) | (share == 1.0)) & (length > tiny)
        away = arm * (np.sign(value(points)) / (length + _TINY))[:, None]
        return np.where(is_corner[:, None], away, out)

    return SolidField(value, gradient)


def extrude(outline: SolidField, half: float) -> SolidField:
    """Return what an outline in the plane of x and y sweeps along z, from -half to half."""

    def value(points: FloatArray) -> FloatArray:
        return corner_distance(outline.value(points[:, :2]), np.abs(points[:, 2]) - half)

    def gradient(points: FloatArray) -> FloatArray:
        plane, z = points[:, :2], points[:, 2]
        by_outline, by_length = corner_slopes(outline.value(plane), np.abs(z) - half)
        turned = by_outline[:, None] * outline.gradient(plane)
        return np.column_stack([turned, by_length * np.where(z < 0.0, -1.0, 1.0)])

    return SolidField(value, gradient)


def revolve(outline: SolidField) -> SolidField:
    """Return what an outline sweeps when it is turned about the z axis.

    It is of positions (distance from the axis, z), (n, 2), and does not reach below zero.
    """

    def halve(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        radius = np.sqrt(points[:, 0] ** 2 + points[:, 1] ** 2)
        return radius, np.stack([radius, points[:, 2]], axis=1)

    def gradient(points: FloatArray) -> FloatArray:
        radius, plane = halve(points)
        slope = outline.gradient(plane)
        turned = points[:, :2] * (slope[:, 0] / (radius + _TINY))[:, None]
        return np.column_stack([turned, slope[:, 1]])

    return SolidField(lambda points: outline.value(halve(points)[1]), gradient)
