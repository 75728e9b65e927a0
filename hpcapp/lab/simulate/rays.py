"""Where lines meet an analytic shape, and which of its points is nearest: exact to rounding."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from hpcapp.geometry.points import BoolArray, FloatArray, IntArray
from hpcapp.kernels.parallel import run_batches
from hpcapp.lab.simulate.implicit import Solid, diagonal_of
from hpcapp.lab.simulate.tracing import Tracer
from hpccomponent.limits import available_cores

_BLOCK = 1 << 16  # rows that a thread takes at a time
_SAME_FACE = 0.98  # cosine between normals: where it is less, two faces meet at an edge

Result = TypeVar("Result")


def cross_rays(
    shape: Solid, origins: FloatArray, directions: FloatArray, reach: float, first_only: bool
) -> tuple[IntArray, FloatArray]:
    """Return which rays cross the surface of `shape`, (m,), and how far from their origin, (m,).

    Directions (n, 3) have unit length, origins (n, 3) lie outside the shape. Rays stop at the first
    crossing, as light does, or go on to the last as far as they reach. They ascend, and distances
    go outwards within a ray, exact to 1e-12 of the diagonal.

    Sphere tracing with a shortest step, so that a ray passes through the surface; then the Illinois
    variant of regula falsi between the two last steps. A ray that grazes the surface may overlook a
    chord shorter than 5e-4 of the diagonal.
    """
    tracer = Tracer(shape, len(origins))
    return _cross(tracer, origins, directions, reach, first_only)


def run_in_blocks(function: Callable[[slice], Result], count: int) -> list[Result]:
    """Call a function for one block of rows after another, on all cores; results are in order.

    It works in numpy, which lets other threads run. There is at least one block, even of no rows;
    what the blocks are depends on the count alone.
    """
    blocks = [slice(at, min(at + _BLOCK, count)) for at in range(0, max(count, 1), _BLOCK)]
    return run_batches(function, blocks, available_cores())


def sample_lines(
    shape: Solid, count: int, rng: np.random.Generator, tracer: Tracer | None = None
) -> FloatArray:
    """Return the points in which `count` random lines cross the surface, shape (m, 3).

    Lines of uniform direction and offset cross every patch of a surface in proportion to its area
    (Crofton's formula), so that the points are spread evenly whatever the shape.
    """
    low, high = shape.bounds
    radius = 0.5 * diagonal_of(shape) * 1.001
    # (count, 3): directions, and two vectors that span the plane across each
    directions = unit_vectors(rng.standard_normal((count, 3)))
    side, up = frame_about(directions)
    # (count,): a place on the disc that covers the shape; (count, 3): from its middle
    angle, distance = 2 * np.pi * rng.random(count), radius * np.sqrt(rng.random(count))
    offset = (distance * np.cos(angle))[:, None] * side + (distance * np.sin(angle))[:, None] * up
    origins = 0.5 * (low + high) + offset - radius * directions
    tracer = tracer or Tracer(shape, count)
    rays, distances = _cross(tracer, origins, directions, 2.0 * radius, first_only=False)
    crossings: FloatArray = origins[rays] + distances[:, None] * directions[rays]
    return crossings


def closest_points(
    shape: Solid, points: FloatArray, guesses: FloatArray, rounds: int = 6
) -> FloatArray:
    """Return a point of the surface near each of `points` (n, 3): the nearest one, as a rule.

    It is never farther away than the guess (n, 3), a point of the surface to start from, as the
    nearest of an even sample. So many rounds move the foot in its tangent plane below the point; it
    falls back on the surface by Newton steps, and is kept where that brought it nearer. Where it
    has fallen on a face that meets the first at an edge, the point of both tangent planes that is
    nearest is tried too, and with a third face that of all three, so that feet find edges and
    corners.
    """
    # (n, 3): the nearest surface point so far; (n,): its distance
    best, least = guesses.copy(), _lengths(points - guesses)

    def offer(rows: IntArray, trial: FloatArray) -> FloatArray:
        """Let `trial` fall, keep it where it is nearer, and return where it fell."""
        feet, landed = fall(shape, trial)
        reach = _lengths(points[rows] - feet)
        better = np.flatnonzero(landed & (reach < least[rows]))
        best[rows[better]], least[rows[better]] = feet[better], reach[better]
        return feet

    everyone = np.arange(len(points))
    offer(everyone, points)
    for _ in range(rounds):
        # (r,): points at work; (r, k, 3): the k tangent planes that each has met, one at first
        rows, feet, normals = everyone, best[:, None], shape.normal(best)[:, None]
        for _ in range(3):
            # (r, 3): the nearest point common to these planes, fallen on the surface
            trial = offer(rows, _nearest_on_planes(points[rows], feet, normals))
            other = shape.normal(trial)
            # (r,): whether it fell on a face that is none of theirs: an edge or a corner is near
            is_other = (np.einsum("nki,ni->nk", normals, other) < _SAME_FACE).all(axis=1)
            rows = rows[is_other]
            if not len(rows):
                break
            feet = np.concatenate([feet[is_other], trial[is_other, None]], axis=1)
            normals = np.concatenate([normals[is_other], other[is_other, None]], axis=1)
    return best


def _nearest_on_planes(points: FloatArray, feet: FloatArray, normals: FloatArray) -> FloatArray:
    """Return the nearest point that lies on each of up to three planes, shape (n, k, 3)."""
    # (n, k): how far each point is above each of its planes
    heights = np.einsum("nki,nki->nk", points[:, None] - feet, normals)
    # Planes that are nearly parallel in threes have no common point: a trace of 1e-9 finds one.
    gram = normals @ normals.transpose(0, 2, 1) + 1e-9 * np.eye(normals.shape[1])
    # (n, k, 1): how much of each normal leads to all planes at once
    shares = np.linalg.solve(gram, heights[..., None])
    nearest: FloatArray = points - (normals.transpose(0, 2, 1) @ shares)[..., 0]
    return nearest


def fall(shape: Solid, points: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Move points along their normals onto the surface; tell which ones arrived, (n,).

    These are within 1e-12 of the diagonal of the surface.
    """
    tolerance = 1e-12 * diagonal_of(shape)
    feet = points.copy()
    active = np.arange(len(points))
    for _ in range(30):
        value = shape.value(feet[active])
        away = np.abs(value) > tolerance
        active, value = active[away], value[away]
        if not len(active):
            break
        slope = shape.gradient(feet[active])
        # A step is Newton's, but no longer than ten times the value: slopes vanish at centres.
        square = np.maximum(np.einsum("ij,ij->i", slope, slope), 0.01)
        feet[active] -= (value / square)[:, None] * slope
    landed = np.ones(len(points), dtype=bool)
    landed[active] = False
    return feet, landed


def frame_about(directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors square on each unit direction and on each other, shapes (n, 3)."""
    helper = np.zeros_like(directions)
    smallest = np.abs(directions).argmin(axis=1)
    helper[np.arange(len(directions)), smallest] = 1.0
    side = unit_vectors(np.cross(directions, helper))
    return side, np.cross(directions, side)


def unit_vectors(vectors: FloatArray) -> FloatArray:
    """Return vectors of shape (n, 3) scaled to unit length; zero stays zero."""
    tiny = np.finfo(np.float64).tiny
    unit: FloatArray = vectors / np.maximum(_lengths(vectors), tiny)[:, None]
    return unit


def _cross(
    tracer: Tracer, origins: FloatArray, directions: FloatArray, reach: float, first_only: bool
) -> tuple[IntArray, FloatArray]:
    """Return where rays cross the surface, on all cores; see `cross_rays`."""

    def cross(part: slice) -> tuple[IntArray, FloatArray]:
        rays, distances = tracer.cross(origins[part], directions[part], reach, first_only)
        return rays + part.start, distances

    rays, distances = zip(*run_in_blocks(cross, len(origins)), strict=True)
    return np.concatenate(rays), np.concatenate(distances)


def _lengths(vectors: FloatArray) -> FloatArray:
    """Return the length of each row."""
    lengths: FloatArray = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))
    return lengths
