"""Where lines meet an analytic shape, and which of its points is nearest: exact to rounding."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.simulate.shapes import Shape, diagonal_of
from hpccomponent.surface.types.points import FloatArray, IntArray

__all__ = ["closest_points", "cross_rays", "frame_about", "sample_lines", "unit_vectors"]

_SHORTEST_STEP = 5e-4  # of the diagonal: two crossings closer than this may be overlooked
_TOLERANCE = 1e-13  # of the diagonal
_MOST_STEPS = 4000


def cross_rays(
    shape: Shape, origins: FloatArray, directions: FloatArray, reach: float, first_only: bool
) -> tuple[IntArray, FloatArray]:
    """Return where rays cross the surface of `shape`.

    Parameters
    ----------
    shape : Shape
    origins, directions : ndarray of float64, shape (n, 3)
        Rays; the directions have unit length, the origins lie outside the shape.
    reach : float
        Length of the rays, in length units of the shape.
    first_only : bool
        Stop at the first crossing, as light does; else go on to the last.

    Returns
    -------
    rays : ndarray of int64, shape (m,)
        The ray of each crossing; ascending, and from its origin outwards within a ray.
    distances : ndarray of float64, shape (m,)
        From the ray's origin, exact to 1e-12 of the diagonal.

    Notes
    -----
    Sphere tracing with a shortest step, so that a ray passes through the surface; then the
    Illinois variant of regula falsi between the two last steps. A ray that grazes the surface
    may overlook a chord shorter than 5e-4 of the diagonal.
    """
    rays, near, far = _bracket(shape, origins, directions, reach, first_only)
    ahead = directions[rays]
    distances = _polish(shape, origins[rays], ahead, near, far)
    order = np.lexsort((distances, rays))
    return rays[order], distances[order]


def sample_lines(shape: Shape, count: int, rng: np.random.Generator) -> FloatArray:
    """Return the points in which `count` random lines cross the surface.

    Parameters
    ----------
    shape : Shape
    count : int
        How many lines.
    rng : numpy.random.Generator

    Returns
    -------
    ndarray of float64, shape (m, 3)

    Notes
    -----
    Lines of uniform direction and offset cross every patch of a surface in proportion to its
    area (Crofton's formula), so that the points are spread evenly whatever the shape.
    """
    low, high = shape.bounds
    radius = 0.5 * diagonal_of(shape) * 1.001
    directions = unit_vectors(rng.standard_normal((count, 3)))
    side, up = frame_about(directions)
    angle, distance = 2 * np.pi * rng.random(count), radius * np.sqrt(rng.random(count))
    offset = (distance * np.cos(angle))[:, None] * side + (distance * np.sin(angle))[:, None] * up
    origins = 0.5 * (low + high) + offset - radius * directions
    rays, distances = cross_rays(shape, origins, directions, 2.0 * radius, first_only=False)
    crossings: FloatArray = origins[rays] + distances[:, None] * directions[rays]
    return crossings


def closest_points(
    shape: Shape, points: FloatArray, guesses: FloatArray, rounds: int = 6
) -> FloatArray:
    """Return a point of the surface near each of `points`: the nearest one, as a rule.

    Parameters
    ----------
    shape : Shape
    points : ndarray of float64, shape (n, 3)
    guesses : ndarray of float64, shape (n, 3)
        Points of the surface to start from, such as the nearest of an even sample.
    rounds : int
        How often the foot is moved along its tangent plane.

    Returns
    -------
    ndarray of float64, shape (n, 3)
        On the surface, and never farther away than the guess.

    Notes
    -----
    The foot moves in its tangent plane below the point and falls back on the surface by Newton
    steps; it is kept where that brought it nearer.
    """
    best = guesses.copy()
    least = _lengths(points - best)
    trial, _ = _fall(shape, points)
    for _ in range(rounds):
        trial, landed = _fall(shape, trial)
        reach = _lengths(points - trial)
        better = landed & (reach < least)
        best[better], least[better] = trial[better], reach[better]
        normal = shape.normal(best)
        away = points - best
        trial = points - np.einsum("ij,ij->i", away, normal)[:, None] * normal
    return best


def frame_about(directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors at right angles to each direction and to each other.

    Parameters
    ----------
    directions : ndarray of float64, shape (n, 3)
        Of unit length.

    Returns
    -------
    side, up : ndarray of float64, shape (n, 3)
    """
    helper = np.zeros_like(directions)
    smallest = np.abs(directions).argmin(axis=1)
    helper[np.arange(len(directions)), smallest] = 1.0
    side = unit_vectors(np.cross(directions, helper))
    return side, np.cross(directions, side)


def unit_vectors(vectors: FloatArray) -> FloatArray:
    """Return `vectors`, shape (n, 3), scaled to unit length; zero stays zero.

    Parameters
    ----------
    vectors : ndarray of float64, shape (n, 3)

    Returns
    -------
    ndarray of float64, shape (n, 3)
    """
    tiny = np.finfo(np.float64).tiny
    unit: FloatArray = vectors / np.maximum(_lengths(vectors), tiny)[:, None]
    return unit


def _bracket(
    shape: Shape, origins: FloatArray, directions: FloatArray, reach: float, first_only: bool
) -> tuple[IntArray, FloatArray, FloatArray]:
    """March along the rays and return (ray, distance before, distance after) of sign changes."""
    shortest = _SHORTEST_STEP * diagonal_of(shape)
    ray = np.arange(len(origins))
    travelled = np.zeros(len(origins))
    value = shape.value(origins)
    found: list[tuple[IntArray, FloatArray, FloatArray]] = []
    for _ in range(_MOST_STEPS):
        if not len(ray):
            break
        ahead = travelled + np.maximum(np.abs(value), shortest)
        next_value = shape.value(origins[ray] + ahead[:, None] * directions[ray])
        crossed = (value < 0.0) != (next_value < 0.0)
        found.append((ray[crossed], travelled[crossed], ahead[crossed]))
        goes_on = ahead < reach
        if first_only:
            goes_on &= ~crossed
        ray, travelled, value = ray[goes_on], ahead[goes_on], next_value[goes_on]
    if not found:
        return ray, travelled, travelled
    rays, near, far = (np.concatenate(column) for column in zip(*found, strict=True))
    return rays, near, far


def _polish(
    shape: Shape, origins: FloatArray, directions: FloatArray, near: FloatArray, far: FloatArray
) -> FloatArray:
    """Close in on the sign change between `near` and `far` along each ray."""
    tolerance = _TOLERANCE * diagonal_of(shape)
    root = 0.5 * (near + far)
    left, right = near.copy(), far.copy()
    at_left = shape.value(origins + left[:, None] * directions)
    at_right = shape.value(origins + right[:, None] * directions)
    active = np.arange(len(near))
    for turn in range(80):
        if not len(active):
            break
        a, b, fa, fb = left[active], right[active], at_left[active], at_right[active]
        # Every fourth step halves: a kink of the field cannot stall the search.
        t = 0.5 * (a + b) if turn % 4 == 3 else (a * fb - b * fa) / (fb - fa)
        value = shape.value(origins[active] + t[:, None] * directions[active])
        keeps_right = (value < 0.0) != (fb < 0.0)
        left[active], at_left[active] = b, fb
        # Illinois: an end that stays for a second time counts half.
        left[active[~keeps_right]] = a[~keeps_right]
        at_left[active[~keeps_right]] = 0.5 * fa[~keeps_right]
        right[active], at_right[active] = t, value
        root[active] = t
        done = (np.abs(value) <= tolerance) | (np.abs(right[active] - left[active]) <= tolerance)
        active = active[~done]
    return root


def _fall(shape: Shape, points: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Move points along their normals onto the surface; tell which ones arrived."""
    tolerance = 1e-12 * diagonal_of(shape)
    feet = points.copy()
    active = np.arange(len(points))
    for _ in range(30):
        value = shape.value(feet[active])
        away = np.abs(value) > tolerance
        active = active[away]
        if not len(active):
            break
        feet[active] -= value[away, None] * shape.normal(feet[active])
    landed = np.ones(len(points), dtype=bool)
    landed[active] = False
    return feet, landed


def _lengths(vectors: FloatArray) -> FloatArray:
    """Return the length of each row."""
    lengths: FloatArray = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
    return lengths
