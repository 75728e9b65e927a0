"""Rows that stand for no measurement: missing returns of a scanner, no-data of a raster.

Both are the same again and again where all others vary. A place is told by how often it comes. One
coordinate may come as often and be meant (a floor, a lake, a slice of a lattice), so it must lie
far from all others, too: by twice their range, where programs write it for no data (-9999 and
others, and 0 as a height on a map), else by the longest extent of the cloud.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

import numpy as np

from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.points import BoolArray, FloatArray, PointCloud
from hpcapp.io.points.survey import is_projected

_FEWEST, _FEWEST_ELSEWHERE = 10, 100  # rows: at the origin, or of a number; at another place
_LEAST_SHARE = 0.01  # of the rows, for a place other than the origin
_TIMES_USUAL = 10  # as many rows as other places, or numbers, have

_TO_COME = (-9999.0, -99999.0, -32768.0, -32767.0)  # none even where no row that was seen has it
_WRITTEN = (*_TO_COME, -999.0, 9999.0, 99999.0, 32767.0)
_SAME = 1e-6  # of a number that text, or integers of a scale, have rounded
_BEYOND = 1e30  # no coordinate of any unit, as the largest number of single precision
_LARGEST = (_BEYOND, float(np.finfo(np.float32).max))

_RANGES = 2.0
"""Of the others' range, to a number that is written for no data: 1.7 for a sea at 0 below an island
of cliffs, 3.0 for a height of 0 below a terrain at 300 to 400 (a test holds 1.78 and 2.22)."""

_EXTENTS = 1.0
"""Of the longest extent, to any other number that comes often: .45 for the wall behind an object
(``odd/a6_short_millimetres.ply`` of the real files, the most of 386 clouds), 1.9 and more for 0
below a terrain of 200 by 200 at 380 and more (a test holds .89 and 1.11)."""


def find_no_data(
    cloud: PointCloud, unit: str | None, crs: str | None, *, goes_on: bool
) -> tuple[FloatArray, list[str]]:
    """Find what stands for no measurement in a file.

    Finite points come from all over it; from its start, if it `goes_on`. Return the places (k, 3),
    NaN where a coordinate may be anything, and warnings of what is kept, and may be no data.
    """
    places = list(_find_places(cloud.positions))
    numbers = _find_numbers(leave_out(cloud, places), unit, crs)
    places += numbers
    rest = leave_out(cloud, places)
    if goes_on and len(rest) >= _FEWEST:
        if _is_far_from_origin(rest.positions):
            places = [place for place in places if place.any()] + [np.zeros(3)]
        places += _find_to_come(rest.positions)
    return np.array(places).reshape(-1, 3), list(_find_doubts(rest.positions))


def may_be_data(cloud: PointCloud, unit: str | None, crs: str | None) -> bool:
    """Tell whether rows to come may show that a number of these points is none, or is meant."""
    if _are_written(cloud.positions[:, 2], may_be_zero=True).all():
        return True
    numbers = np.array(_find_numbers(cloud, unit, crs)).ravel()
    numbers = numbers[~np.isnan(numbers)]
    return bool(len(numbers) and not _are_written(numbers, may_be_zero=True).all())


def leave_out(cloud: PointCloud, places: Iterable[FloatArray]) -> PointCloud:
    """Return the points that are at none of some places."""
    for place in places:
        is_there = find_at(cloud.positions, place)
        cloud = cloud.take(~is_there) if is_there.any() else cloud
    return cloud


def find_at(positions: FloatArray, place: FloatArray) -> BoolArray:
    """Tell which points are at a place, of which NaN are any coordinates."""
    # Column by column: reductions along rows of three are several times slower.
    columns = zip(positions.T, place, strict=True)
    is_there: BoolArray = np.logical_and.reduce(
        [column == value for column, value in columns if not np.isnan(value)]
    )
    return is_there


def name_no_data(place: FloatArray) -> tuple[str, str]:
    """Return under which word points at a place are counted, and a line that says why."""
    is_number = np.isnan(place)
    if is_number.any():
        axis = int(np.argmin(is_number))
        named = f"{'xyz'[axis]} is {place[axis]:.9g}"
        return "no data", f"{named} where nothing was measured: these points are dropped"
    if not place.any():
        return "repeated", "points at the origin (0, 0, 0) are missing returns: they are dropped"
    named = ", ".join(f"{coordinate:.9g}" for coordinate in place)
    return "repeated", (
        f"many points are at the same place ({named}), which is that of missing returns: "
        "they are dropped"
    )


def sum_coordinates(positions: FloatArray) -> FloatArray:
    """Return a number of each point that is another where the point is another, but for chance."""
    x, y, z = positions.T
    with np.errstate(over="ignore", invalid="ignore"):  # then some points count as one
        sums: FloatArray = x + math.pi * y + math.e * z
    sums[np.isnan(sums)] = np.inf
    return sums


def _find_places(positions: FloatArray) -> Iterator[FloatArray]:
    """Find the places where so many points are the same that they are missing returns."""
    if len(positions) < _FEWEST:
        return
    sums = sum_coordinates(positions)
    values, counts = np.unique(sums, return_counts=True)
    if len(counts) <= _FEWEST:
        return
    fewest = max(_FEWEST, _TIMES_USUAL * float(np.median(counts)))
    elsewhere = max(fewest, _FEWEST_ELSEWHERE, _LEAST_SHARE * len(positions))
    for value in values[counts >= fewest]:
        place = positions[np.argmax(sums == value)]
        if find_at(positions, place).sum() >= (elsewhere if place.any() else fewest):
            yield place


def _is_far_from_origin(positions: FloatArray) -> bool:
    """Tell whether points are so far from the origin that one there can be none of them."""
    low, high = bound_points(positions)
    away = np.maximum(np.maximum(low, -high), 0)
    with np.errstate(over="ignore"):  # beyond all numbers: not far
        return bool(math.hypot(*away) > math.hypot(*(high - low)) > 0)


def _find_numbers(cloud: PointCloud, unit: str | None, crs: str | None) -> list[FloatArray]:
    """Find single coordinates that are none, as places: the next where others are set aside."""
    places: list[FloatArray] = []
    while len(cloud):
        numbers = list(_find_far(cloud.positions, is_projected(cloud, unit, crs)))
        cloud = leave_out(cloud, numbers)
        if not numbers or len(cloud) < _FEWEST:
            break
        places += numbers
    return places


def _find_far(positions: FloatArray, is_map: bool) -> Iterator[FloatArray]:
    """Find single coordinates that are far from all others."""
    for axis, column in enumerate(np.ascontiguousarray(positions.T)):
        is_written = _are_written(column, may_be_zero=not (is_map and axis == 2))
        others = column[~is_written]
        if not len(others):
            continue
        for number in np.unique(column[is_written]):
            if _is_beyond(number, others, _RANGES * _extent(others)):
                yield _any_but(axis, number)
        for number in {others.min(), others.max()}:
            if _is_repeated(number, others):
                is_there = column == number
                extents = map(_extent, [*positions[is_there].T, *positions[~is_there].T])
                if _is_beyond(number, others[others != number], _EXTENTS * max(extents)):
                    yield _any_but(axis, number)


def _are_written(column: FloatArray, *, may_be_zero: bool) -> BoolArray:
    """Tell which coordinates are as programs write them for no data."""
    are_written = np.zeros(len(column), np.bool_) if may_be_zero else column == 0
    largest = max(-column.min(), column.max())
    for number in _WRITTEN:
        if largest >= (1 - _SAME) * abs(number):
            are_written |= np.abs(column - number) <= _SAME * abs(number)
    if largest >= _BEYOND:
        are_written |= np.abs(column) >= _BEYOND
    return are_written


def _find_to_come(positions: FloatArray) -> list[FloatArray]:
    """Return heights that would be none, should they come."""
    heights = positions[:, 2]
    reach = _RANGES * _extent(heights)
    numbers = [*_TO_COME, *_LARGEST, *(-number for number in _LARGEST)]
    return [_any_but(2, number) for number in numbers if _is_beyond(number, heights, reach)]


def _find_doubts(positions: FloatArray) -> Iterator[str]:
    """Say where zeros far from all others are kept."""
    for name, column in zip("xyz", positions.T, strict=True):
        others = column[column != 0]
        if _is_repeated(0.0, column) and _is_beyond(0.0, others, _RANGES * _extent(others)):
            yield (
                f"{name} is 0 in {len(column) - len(others)} of {len(column)} points that were "
                "looked at, and far from that in all others: if it stands for no data, leave "
                "these points out (--box)"
            )


def _is_repeated(number: float, column: FloatArray) -> bool:
    """Tell whether a number comes much more often than the others, and these are many."""
    rows = int(np.count_nonzero(column == number))
    if rows < _FEWEST:
        return False
    _, counts = np.unique(column, return_counts=True)
    return len(counts) > _FEWEST and rows >= _TIMES_USUAL * float(np.median(counts))


def _is_beyond(number: float, others: FloatArray, reach: float) -> bool:
    """Tell whether a number is farther than some reach from all others."""
    with np.errstate(over="ignore"):
        return bool(number < others.min() - reach or number > others.max() + reach)


def _extent(column: FloatArray) -> float:
    with np.errstate(over="ignore"):
        return float(np.ptp(column)) if len(column) else 0.0


def _any_but(axis: int, number: float) -> FloatArray:
    """Return the place of all points with a number in one coordinate."""
    place = np.full(3, np.nan)
    place[axis] = number
    return place
