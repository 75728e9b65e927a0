"""Building blocks of analytic models: primitive solids and what joins or cuts them.

A field maps positions of shape (n, 3) to values (n,) and gradients (n, 3). Every field here is
negative inside, exact on its surface, and changes no faster than the distance does (Lipschitz
constant 1), so that its absolute value never exceeds the distance to the surface: what sphere
tracing needs. Away from the surface the value may be smaller than the distance.

References
----------
J. C. Hart, Sphere tracing: a geometric method for the antialiased ray tracing of implicit
surfaces, The Visual Computer 12 (1996), doi:10.1007/s003710050084.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial import KDTree

from hpccomponent.surface.types.points import FloatArray

__all__ = [
    "Field",
    "box",
    "cone",
    "cut",
    "cylinder",
    "ellipsoid",
    "grow",
    "intersect",
    "mirror",
    "smooth_unite",
    "torus",
    "tube",
    "unite",
]

Field = Callable[[FloatArray], tuple[FloatArray, FloatArray]]
Curve = Callable[[FloatArray], FloatArray]

_TINY = 1e-300  # keeps 0/0 out of gradients at centres, where no direction is right


def ellipsoid(semi_axes: Sequence[float]) -> Field:
    """Return an ellipsoid about the origin, min(a) (|p / a| - 1).

    Parameters
    ----------
    semi_axes : sequence of 3 floats
        Along x, y and z; three equal ones make a sphere and the exact distance.

    Returns
    -------
    Field
    """
    axes = np.asarray(semi_axes, dtype=np.float64)
    shortest = float(axes.min())

    def field(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        scaled = points / axes
        length = np.sqrt(np.einsum("ij,ij->i", scaled, scaled))
        gradient = scaled * (shortest / axes) / (length + _TINY)[:, None]
        return shortest * (length - 1.0), gradient

    return field


def torus(major: float, minor: float) -> Field:
    """Return a torus about the z axis: the exact distance to its circle, less `minor`.

    Parameters
    ----------
    major : float
        Radius of the circle.
    minor : float
        Radius of the tube.

    Returns
    -------
    Field
    """

    def field(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        radius = np.hypot(points[:, 0], points[:, 1]) + _TINY
        centers = np.zeros_like(points)
        centers[:, :2] = points[:, :2] * (major / radius)[:, None]
        return _ball(points, centers, minor)

    return field


def cone(
    start: Sequence[float], end: Sequence[float], start_radius: float, end_radius: float
) -> Field:
    """Return a limb: the hull of two balls, exact distance.

    Parameters
    ----------
    start, end : sequence of 3 floats
        Centres of the balls; neither ball may contain the other.
    start_radius, end_radius : float
        Equal radii make a capsule.

    Returns
    -------
    Field
    """
    origin = np.asarray(start, dtype=np.float64)
    axis = np.asarray(end, dtype=np.float64) - origin
    length = float(np.linalg.norm(axis))
    axis /= length
    slope = (start_radius - end_radius) / length
    tangent = slope / np.sqrt(1.0 - slope * slope)

    def field(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        local = points - origin
        along = local @ axis
        across = np.sqrt(np.maximum(np.einsum("ij,ij->i", local, local) - along**2, 0.0))
        # The ball of the hull that is nearest to a point lies downhill of its foot on the axis.
        nearest = np.clip(along - across * tangent, 0.0, length)
        return _ball(local, nearest[:, None] * axis, start_radius - slope * nearest)

    return field


def tube(curve: Curve, radius: float, samples: int = 1024) -> Field:
    """Return a tube about a closed curve: the exact distance to the curve, less `radius`.

    Parameters
    ----------
    curve : callable
        Maps parameters t of shape (n,), of period 2 pi, to the curve and its first two
        derivatives, shape (3, n, 3).
    radius : float
        Smaller than the curve's radius of curvature everywhere.
    samples : int
        How many points of the curve seed the search for the nearest one.

    Returns
    -------
    Field

    Notes
    -----
    Three Newton steps from the nearest sample square the error of half a sample's spacing
    three times: far below rounding for any smooth curve.
    """
    seeds = np.linspace(0.0, 2.0 * np.pi, samples, endpoint=False)
    tree = KDTree(curve(seeds)[0])
    spacing = seeds[1]

    def field(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        t = seeds[tree.query(points)[1]]
        first = t
        for _ in range(3):
            center, tangent, bend = curve(t)
            offset = center - points
            slope = np.einsum("ij,ij->i", offset, tangent)
            curvature = np.einsum("ij,ij->i", tangent, tangent) + np.einsum(
                "ij,ij->i", offset, bend
            )
            step = slope / np.maximum(curvature, _TINY)
            t = np.clip(t - step, first - spacing, first + spacing)
        return _ball(points, curve(t)[0], radius)

    return field


def box(center: Sequence[float], half: Sequence[float]) -> Field:
    """Return an axis-parallel box, exact distance.

    Parameters
    ----------
    center, half : sequence of 3 floats
        Its middle, and half its edges.

    Returns
    -------
    Field
    """
    middle, extent = np.asarray(center, dtype=np.float64), np.asarray(half, dtype=np.float64)

    def field(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        local = points - middle
        value, gradient = _corner(np.abs(local) - extent)
        return value, gradient * np.where(local < 0.0, -1.0, 1.0)

    return field


def cylinder(center: Sequence[float], axis: int, radius: float, half: float = np.inf) -> Field:
    """Return a cylinder along a coordinate axis, exact distance.

    Parameters
    ----------
    center : sequence of 3 floats
    axis : int
        0, 1 or 2.
    radius : float
    half : float
        Half its length; infinite for a drill.

    Returns
    -------
    Field
    """
    middle = np.asarray(center, dtype=np.float64)
    others = [k for k in range(3) if k != axis]

    def field(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        local = points - middle
        across = np.hypot(local[:, others[0]], local[:, others[1]])
        value, slope = _corner(np.stack([across - radius, np.abs(local[:, axis]) - half], axis=1))
        gradient = np.empty_like(points)
        gradient[:, others] = local[:, others] * (slope[:, 0] / (across + _TINY))[:, None]
        gradient[:, axis] = slope[:, 1] * np.where(local[:, axis] < 0.0, -1.0, 1.0)
        return value, gradient

    return field


def unite(*fields: Field) -> Field:
    """Return the union of solids.

    Parameters
    ----------
    *fields : Field
        At least one.

    Returns
    -------
    Field
    """
    return _select(fields, np.less)


def intersect(*fields: Field) -> Field:
    """Return what is common to solids.

    Parameters
    ----------
    *fields : Field
        At least one.

    Returns
    -------
    Field
    """
    return _select(fields, np.greater)


def cut(solid: Field, *tools: Field) -> Field:
    """Return `solid` with every one of `tools` taken away.

    Parameters
    ----------
    solid : Field
    *tools : Field
        What is taken away.

    Returns
    -------
    Field
    """
    return intersect(solid, *(_complement(tool) for tool in tools))


def grow(solid: Field, thickness: float) -> Field:
    """Return `solid` with a layer added all round; convex edges become round.

    Parameters
    ----------
    solid : Field
    thickness : float
        Of the layer, in length units.

    Returns
    -------
    Field
    """

    def field(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        value, gradient = solid(points)
        return value - thickness, gradient

    return field


def mirror(octant: Field) -> Field:
    """Return a solid that is symmetric in x, y and z, given in the octant of positive signs.

    Parameters
    ----------
    octant : Field
        Only asked for points without negative coordinates.

    Returns
    -------
    Field
    """

    def field(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        value, gradient = octant(np.abs(points))
        return value, gradient * np.where(points < 0.0, -1.0, 1.0)

    return field


def smooth_unite(fillet: float, *fields: Field) -> Field:
    """Return the union of solids with rounded joints.

    Parameters
    ----------
    fillet : float
        Where two values differ by less, in length units, the joint is filled.
    *fields : Field

    Returns
    -------
    Field
        Twice continuously differentiable across the joint.

    Notes
    -----
    min(a, b) - fillet h^3 / 6 with h = max(1 - |a - b| / fillet, 0). Its gradient is a mean of
    the two gradients with weights that add to one, which keeps the Lipschitz constant.
    """

    def join(first: Field, second: Field) -> Field:
        def field(points: FloatArray) -> tuple[FloatArray, FloatArray]:
            (a, slope_a), (b, slope_b) = first(points), second(points)
            overlap = np.maximum(1.0 - np.abs(a - b) / fillet, 0.0)
            minor = 0.5 * overlap**2
            share = np.where(a < b, minor, 1.0 - minor)[:, None]
            value = np.minimum(a, b) - fillet * overlap**3 / 6.0
            return value, slope_a + share * (slope_b - slope_a)

        return field

    joined = fields[0]
    for other in fields[1:]:
        joined = join(joined, other)
    return joined


def _ball(
    points: FloatArray, centers: FloatArray, radius: float | FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the distance from each point to the ball that is nearest to it, and its gradient."""
    offset = points - centers
    length = np.sqrt(np.einsum("ij,ij->i", offset, offset))
    return length - radius, offset / (length + _TINY)[:, None]


def _corner(excess: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the distance to the corner {excess <= 0}, and its slope by each excess."""
    outside = np.maximum(excess, 0.0)
    length = np.sqrt(np.einsum("ij,ij->i", outside, outside))
    deepest = excess.argmax(axis=1)
    slope = outside / (length + _TINY)[:, None]
    inner = np.flatnonzero(length == 0.0)
    slope[inner, deepest[inner]] = 1.0
    return np.where(length > 0.0, length, excess.max(axis=1)), slope


def _complement(solid: Field) -> Field:
    """Return all that is not in `solid`."""

    def field(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        value, gradient = solid(points)
        return -value, -gradient

    return field


def _select(fields: Sequence[Field], better: np.ufunc) -> Field:
    """Return the field that takes, at each point, the value that is `better` than the others."""

    def field(points: FloatArray) -> tuple[FloatArray, FloatArray]:
        value, gradient = fields[0](points)
        for other in fields[1:]:
            rival, slope = other(points)
            wins = better(rival, value)
            value = np.where(wins, rival, value)
            gradient = np.where(wins[:, None], slope, gradient)
        return value, gradient

    return field
