"""Which points support places on a surface, each in a flat ellipsoid around it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hpcapp.geometry.lattice import NEIGHBOURS, find_keys, number_keys, pack_places, step_keys
from hpcapp.geometry.points import FloatArray, IntArray
from hpcapp.kernels.portable.lattice.points import sort_points
from hpccomponent.dataclass import dataclass

__all__ = ["count_supporting", "measure_aside"]

_CLASS = 1.25  # points whose radii differ by less are searched together
_STEPS = 2.0**20  # so many whole ones make 1: sums of them are exact
_PLACES_AT_ONCE = 1 << 10  # each is paired with all points in 27 cells


def count_supporting(
    places: FloatArray,
    positions: FloatArray,
    normals: FloatArray,
    radii: FloatArray,
    thickness: FloatArray,
    threads: int = 1,
) -> tuple[IntArray, FloatArray]:
    """Count the points that support each place, and add up their normals.

    The ellipsoids of points (n, 3) reach `radii` (n,) along the plane that the normal (n, 3) stands
    on, and `thickness` (n,) off it: above 0, in length units of the input, the thickness the radius
    at most. Return, for places (p, 3), counts (p,) and the sums (p, 3) of normals, in units of
    2^-20, to which each is rounded.
    """
    del threads  # numpy runs on one
    counts, sums = np.zeros(len(places), np.int64), np.zeros((len(places), 3))
    for run, pairs in _pair_places(places, positions, normals, radii, thickness, 1.0):
        number = len(counts[run])
        counts[run] += np.bincount(pairs.at, minlength=number)
        # (q, 3): whole numbers, whose sum is the same in any order
        for axis, whole in enumerate(np.round(normals[pairs.points] * _STEPS).T):
            sums[run, axis] += np.bincount(pairs.at, whole, number)
    return counts, sums


def measure_aside(
    places: FloatArray,
    ways: FloatArray,
    positions: FloatArray,
    normals: FloatArray,
    radii: FloatArray,
    thickness: FloatArray,
    enough: int,
    least: float,
    most: float,
    threads: int = 1,
) -> FloatArray:
    """Measure how far places a step beside some are from the points that support them.

    `ways` (p, k, 3) are unit vectors from each of the places (p, 3); a point is asked how far it is
    a step that way: as far along its plane as it is thick. Of the squares of `enough` points, the
    largest is that of a step. Squares are clamped to `least` and `most`; points beyond the latter
    are not asked. Return the largest squares of all ways, (p,), in the axes of the points'
    ellipsoids (see `count_supporting`).
    """
    del threads
    # (p, k, e): the least squares there
    held = np.full((*ways.shape[:2], enough), most)
    for run, pairs in _pair_places(places, positions, normals, radii, thickness, most):
        steps = (thickness / radii)[pairs.points, None]
        # (q, k): along . way. A step s leaves what is off the plane as it is, and makes the square
        # of what is along it larger by 2 s along . way + s^2.
        aside = np.zeros((len(pairs.at), ways.shape[1]))
        for axis in range(3):
            aside += ways[run][pairs.at, :, axis] * pairs.along[:, axis, None]
        _lower(held[run], pairs.at, pairs.squares[:, None] + 2.0 * steps * aside + steps * steps)
    largest: FloatArray = held.max(axis=(1, 2), initial=least)
    return largest


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """Places, each with a point near it; q pairs.

    `along` (q, 3) is from the point to the place along the point's plane, in radii; `squares` (q,)
    are of the distance, in the axes of the point's ellipsoid.
    """

    at: IntArray
    points: IntArray
    along: FloatArray
    squares: FloatArray


def _pair_places(
    places: FloatArray,
    positions: FloatArray,
    normals: FloatArray,
    radii: FloatArray,
    thickness: FloatArray,
    most: float,
) -> Iterator[tuple[slice, _Pairs]]:
    """Pair some places at a time with the points within a square, of like radii at a time."""
    if not len(places) or not len(positions):
        return
    classes = np.floor(np.log(radii / radii.min()) / np.log(_CLASS) + 1e-6)
    for one in np.unique(classes):
        alike = np.flatnonzero(classes == one)
        # Cells as large as the reach: what is near a place is in its cell or in the 26 around it.
        size, origin = np.sqrt(most) * float(radii[alike].max()), positions[alike[0]]
        cells = sort_points(positions[alike], origin, size)
        for start in range(0, len(places), _PLACES_AT_ONCE):
            batch = places[start : start + _PLACES_AT_ONCE]
            at, point = _pair(np.floor((batch - origin) / size).astype(np.int64), *cells)
            point = alike[point]
            offsets, normal = batch[at] - positions[point], normals[point]
            off = np.zeros(len(at))  # (q,): how far each is off the point's plane
            for axis in range(3):  # sums in one order, whatever the shape
                off += offsets[:, axis] * normal[:, axis]
            # (q, 3), (q,): what is left along the plane, in radii; then both parts by the axes of
            # the point's ellipsoid, on which the sum of their squares is 1.
            along = (offsets - off[:, None] * normal) / radii[point, None]
            squares = _square(along) + (off / thickness[point]) ** 2
            near = np.flatnonzero(squares < most)
            pairs = _Pairs(at[near], point[near], along[near], squares[near])
            yield slice(start, start + len(batch)), pairs


def _pair(
    cells: IntArray, keys: IntArray, offsets: IntArray, rows: NDArray[np.uint32]
) -> tuple[IntArray, IntArray]:
    """Return each place with the points in its cell and the 26 around it."""
    names, name = number_keys(pack_places(cells))  # places are many, their cells few
    around = np.stack([find_keys(keys, step_keys(names, step)) for step in NEIGHBOURS], axis=1)
    ends = np.append(offsets, offsets[-1])  # no cell is the last one
    # (27 p,): the points of each place in each of the cells
    first = ends[around][name].ravel()
    counts = (ends[around + 1] - ends[around])[name].ravel()
    # (q,): in its cell, the how-manieth point each one is.
    turn = np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
    at = np.repeat(np.arange(len(counts)) // len(NEIGHBOURS), counts)
    return at, rows[np.repeat(first, counts) + turn].astype(np.int64)


def _lower(least: FloatArray, at: IntArray, squares: FloatArray) -> None:
    """Put some squares, shape (q, k), among the least ones of the places they are of."""
    order = np.argsort(at, kind="stable")
    at = at[order]
    # (q,): the how-manieth of its place each one is.
    turn = np.arange(len(at)) - np.searchsorted(at, at)
    # (p, k, w): those of each place side by side
    here = np.full((*least.shape[:2], int(turn.max(initial=-1)) + 1), np.inf)
    here[at, :, turn] = squares[order]
    # (p, k, e + w): old and new ones, of which the least stay, in any order.
    enough = least.shape[2]
    both = np.concatenate([least, here], axis=2)
    least[:] = np.partition(both, enough - 1, axis=2)[:, :, :enough]


def _square(vectors: FloatArray) -> FloatArray:
    x, y, z = vectors.T
    squares: FloatArray = x * x + y * y + z * z
    return squares
