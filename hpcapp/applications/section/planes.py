"""The planes that sections lie in: typed ones, and those square to a line or along it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import ceil, floor

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpcapp.io.outlines import Drawn
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError
from hpccomponent.ranges import FARTHEST, is_place

_AXES = "xyz"
_ABOVE = np.array([0.0, 0.0, 1.0])
_TOWARDS = (-1.0, 1.0, -1.0)
"""Along x, y and z, the way to look at what lies square to it, so that the drawing has the two
other coordinates of the map to the right and upwards."""
_UPRIGHT = 1e-9  # of a unit vector: a plane as upright as that has heights
_MOST_SECTIONS = 10_000
_ENDS = 1e-9  # of a step: a station that is so near the end of a line is on it


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A plane, or a strip of it, in the coordinates of the input.

    Parameters
    ----------
    place : ndarray of float64, shape (3,)
        In the plane.
    towards : ndarray of float64, shape (3,)
        Unit vector square to it, along which it is looked at.
    start : tuple of 2 floats
        The place in the drawing.
    span : tuple of 2 floats
        What counts, to the right of the place.
    ends : tuple of 2 ints
        Numbers of the corners that the strip ends at; it goes on in the one that has the same.
    """

    place: FloatArray
    towards: FloatArray
    start: tuple[float, float]
    span: tuple[float, float] = (-np.inf, np.inf)
    ends: tuple[int, int] = (0, 1)

    @property
    def axes(self) -> FloatArray:
        """Rows to the right and upwards in the drawing, shape (2, 3)."""
        right = np.cross(self.towards, _ABOVE)
        size = float(np.linalg.norm(right))
        right = right / size if size > _UPRIGHT else np.array([1.0, 0.0, 0.0])
        return np.stack([right, np.cross(right, self.towards)])

    def scale(self, scales: FloatArray) -> Plane:
        """Return it in coordinates that are so many times as long; x and y stay as they are."""
        towards = self.towards / scales
        towards /= np.linalg.norm(towards)
        start = self.start[0], float(self.start[1] * scales[2])
        return replace(self, place=self.place * scales, towards=towards, start=start)


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """One section to make: its name, its planes, and how far along a line it is, if it is."""

    name: str
    planes: tuple[Plane, ...]
    station: float | None = None
    line: str = ""

    def scale(self, scales: FloatArray) -> Cut:
        """Return it in coordinates that are so many times as long, shape (3,)."""
        return (
            self
            if (scales == 1.0).all()
            else replace(self, planes=tuple(one.scale(scales) for one in self.planes))
        )


def plan_planes(
    texts: Sequence[str], step: float | None, low: FloatArray, high: FloatArray
) -> list[Cut]:
    """Return the sections that were typed.

    Parameters
    ----------
    texts : sequence of str
        ``z=10``, or ``z`` for each multiple of the step between `low` and `high`, or a place and a
        direction, ``X,Y,Z,DX,DY,DZ``.

    Raises
    ------
    UsageError
        One is none of these, or there are too many.
    """
    cuts: list[Cut] = []
    for text in texts:
        axis, _, value = text.strip().partition("=")
        if axis in _AXES and axis and not value:
            k = _AXES.index(axis)
            cuts += [_cut_axis(k, at) for at in _list_multiples(text, step, low[k], high[k])]
            continue
        numbers = _parse(value if axis in _AXES and axis else text)
        if axis in _AXES and len(numbers) == 1:
            cuts.append(_cut_axis(_AXES.index(axis), numbers[0]))
            continue
        size = float(np.linalg.norm(numbers[3:]))
        if len(numbers) != 6 or not size:
            raise UsageError(
                f"{name_option('plane', text)}: it is no plane",
                "write it as z=10, as z with a --step, or as X,Y,Z,DX,DY,DZ: a place in it and a "
                "direction square to it",
            )
        cuts.append(_cut_freely(text, np.array(numbers[:3]), np.array(numbers[3:]) / size))
    if step is not None and not any(text.strip() in tuple(_AXES) for text in texts):
        raise UsageError(
            f"{name_option('step')} has nothing to step along",
            "give an axis as plane, as in --plane z --step 3, or a line with --along",
        )
    return cuts


def plan_along(lines: Sequence[Drawn], step: float | None, width: float | None) -> list[Cut]:
    """Return the sections square to lines at every step, to the right as one walks along them.

    Without a step the one along each line; its stations are to the right. `width` is that of each
    cross section, half of it to either side. Raise UsageError where there are too many.
    """
    cuts: list[Cut] = []
    for number, line in enumerate(lines, 1):
        name = line.name or ("" if len(lines) == 1 else f"line {number}")
        corners = np.array(line.shape.coords, dtype=np.float64)
        lengths = np.linalg.norm(np.diff(corners, axis=0), axis=1)
        corners, lengths = corners[np.append(True, lengths > 0.0)], lengths[lengths > 0.0]
        at = np.append(0.0, np.cumsum(lengths))
        if step is None:
            cuts.append(_cut_along(name, corners, at))
            continue
        if at[-1] / step > _MOST_SECTIONS:
            raise UsageError(
                f"{name_option('step', step)} makes more than {_MOST_SECTIONS:,} sections",
                "give a larger one",
            )
        half = np.inf if width is None else 0.5 * width
        cuts += _cut_across(name, corners, at, step, (-half, half))
    if len(cuts) > _MOST_SECTIONS:
        raise UsageError(
            f"{len(cuts):,} sections are too many", f"give a larger {name_option('step')}"
        )
    return cuts


def _parse(text: str) -> list[float]:
    """Return the numbers of a text; none where one of them is no place."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        return []
    return numbers if is_place(*numbers) else []


def _list_multiples(text: str, step: float | None, low: float, high: float) -> list[float]:
    if step is None:
        raise UsageError(
            f"{name_option('plane', text)}: nothing says where",
            f"write {text.strip()}=10, or give a --step for all of its multiples",
        )
    if max(abs(low), abs(high)) / step > FARTHEST or (high - low) / step > _MOST_SECTIONS:
        raise UsageError(
            f"{name_option('step', step)} makes more than {_MOST_SECTIONS:,} sections",
            "give a larger one",
        )
    return [k * step for k in range(ceil(low / step), floor(high / step) + 1)]


def _cut_axis(axis: int, at: float) -> Cut:
    place, towards = np.zeros(3), np.zeros(3)
    place[axis], towards[axis] = at, _TOWARDS[axis]
    return Cut(f"{_AXES[axis]}={_say(at)}", (Plane(place, towards, (0.0, 0.0)),))


def _cut_freely(name: str, place: FloatArray, towards: FloatArray) -> Cut:
    """Return a section through a place; where it is upright the drawing has heights."""
    is_upright = abs(towards[2]) < _UPRIGHT
    return Cut(name, (Plane(place, towards, (0.0, float(place[2]) if is_upright else 0.0)),))


def _cut_along(name: str, corners: FloatArray, at: FloatArray) -> Cut:
    ways = np.diff(corners, axis=0) / np.diff(at)[:, None]
    planes = [
        Plane(
            np.array([*corners[k], 0.0]), np.array([-way[1], way[0], 0.0]), (float(at[k]), 0.0),
            (0.0, float(at[k + 1] - at[k])), (k, k + 1),
        )
        for k, way in enumerate(ways)
    ]  # fmt: skip
    return Cut(name or "profile", tuple(planes), None, name)


def _cut_across(
    name: str, corners: FloatArray, at: FloatArray, step: float, span: tuple[float, float]
) -> Iterator[Cut]:
    ways = np.diff(corners, axis=0) / np.diff(at)[:, None]
    for station in step * np.arange(floor(at[-1] / step + _ENDS) + 1.0):
        after = min(int(np.searchsorted(at, station, "right")) - 1, len(ways) - 1)
        # at a corner of the line the section halves the angle
        before = min(int(np.searchsorted(at, station, "left")), len(ways)) - 1
        way = ways[after] + ways[max(before, 0)]
        size = float(np.linalg.norm(way))
        way = way / size if size > _UPRIGHT else ways[after]
        x, y = corners[after] + (station - at[after]) * ways[after]
        plane = Plane(np.array([x, y, 0.0]), np.array([*way, 0.0]), (0.0, 0.0), span)
        said = _say(float(station))
        yield Cut(f"{name} {said}" if name else said, (plane,), float(station), name)


def _say(number: float) -> str:
    """Return a number that was typed, or is a multiple of one, without rounding errors."""
    return f"{number:.10g}"
