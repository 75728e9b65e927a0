"""Fields, of which analytic models are made, and what joins, cuts and changes them.

A field is negative inside, zero exactly on its surface, and changes no faster than the distance
does (Lipschitz constant 1), so that its absolute value never exceeds the distance to the surface:
what sphere tracing needs. Away from the surface the value may be smaller than the distance.

References
----------
J. C. Hart, Sphere tracing: a geometric method for the antialiased ray tracing of implicit
surfaces, The Visual Computer 12 (1996), doi:10.1007/s003710050084.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpccomponent.dataclass import dataclass

Function = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class SolidField:
    """A function of positions (n, 3) and its gradient.

    The value (n,) is in length units. The gradient (n, 3) is on an edge that of one of its sides;
    zero where no direction is right, as at a centre.
    """

    value: Function
    gradient: Function


def unite(*fields: SolidField) -> SolidField:
    """Return the union of one or more solids."""

    def value(points: FloatArray) -> FloatArray:
        least = fields[0].value(points)
        for other in fields[1:]:
            least = np.minimum(least, other.value(points))
        return least

    def gradient(points: FloatArray) -> FloatArray:
        winner = np.argmin([field.value(points) for field in fields], axis=0)
        slopes = np.empty_like(points)
        for number, field in enumerate(fields):
            rows = np.flatnonzero(winner == number)
            slopes[rows] = field.gradient(points[rows])
        return slopes

    return SolidField(value, gradient)


def intersect(*fields: SolidField) -> SolidField:
    """Return what is common to one or more solids."""
    return _complement(unite(*(_complement(field) for field in fields)))


def cut(solid: SolidField, *tools: SolidField) -> SolidField:
    """Return `solid` with every one of `tools` taken away."""
    return _complement(unite(_complement(solid), *tools))


def grow(solid: SolidField, thickness: float) -> SolidField:
    """Return `solid` with a layer of a thickness added all round; convex edges become round."""
    return SolidField(lambda points: solid.value(points) - thickness, solid.gradient)


def mirror(octant: SolidField) -> SolidField:
    """Return a solid symmetric in x, y and z, whose octant is asked for no negative coordinates."""

    def gradient(points: FloatArray) -> FloatArray:
        return octant.gradient(np.abs(points)) * np.where(points < 0.0, -1.0, 1.0)

    return SolidField(lambda points: octant.value(np.abs(points)), gradient)


def smooth_unite(fillet: float, *fields: SolidField) -> SolidField:
    """Return the union of solids with rounded joints, which are smooth to the second derivative.

    Where two values differ by less than the fillet, the joint is filled: min(a, b) - fillet h^3 / 6
    with h = max(1 - |a - b| / fillet, 0). Its gradient is a mean of the two gradients with weights
    that add to one, which keeps the Lipschitz constant.
    """

    def join(first: SolidField, second: SolidField) -> SolidField:
        def value(points: FloatArray) -> FloatArray:
            a, b = first.value(points), second.value(points)
            overlap = np.maximum(1.0 - np.abs(a - b) / fillet, 0.0)
            joined: FloatArray = np.minimum(a, b) - fillet / 6.0 * overlap * overlap * overlap
            return joined

        def gradient(points: FloatArray) -> FloatArray:
            a, b = first.value(points), second.value(points)
            minor = 0.5 * np.maximum(1.0 - np.abs(a - b) / fillet, 0.0) ** 2
            share = np.where(a < b, minor, 1.0 - minor)[:, None]
            slope = first.gradient(points)
            return slope + share * (second.gradient(points) - slope)

        return SolidField(value, gradient)

    joined = fields[0]
    for other in fields[1:]:
        joined = join(joined, other)
    return joined


def _complement(solid: SolidField) -> SolidField:
    """Return all that is not in `solid`."""
    return SolidField(lambda points: -solid.value(points), lambda points: -solid.gradient(points))
