"""The planes that sections lie in: typed ones, and those square to a line or along it."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, floor, inf

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpcapp.io.outlines import Drawn
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError
from hpccomponent.ranges import FARTHEST, is_place

_AXES = ("x", "y", "z")
_ABOVE = np.array([0.0, 0.0, 1.0])
_TOWARDS = (-1.0, 1.0, -1.0)
"""Along x, y and z, the way to look at what lies square to it, so that the drawing has the two
other coordinates of the map to the right and upwards."""
_UPRIGHT = 1e-9  # of a unit vector: rounding of a plane that was meant to be upright
_MOST_SECTIONS = 10_000  # of one drawing: the step was meant to be another one
_ENDS = 1e-9  # of a step: rounding of a station that is at the end of a line


@dataclass(frozen=True, slots=True, eq=False)
class Plane:
    """A plane, or a strip of it, in the coordinates of the input.

    Parameters
    ----------
    place : ndarray of float64, shape (3,)
        In the plane; at zero height where it is upright, so that drawings have heights.
    towards : ndarray of float64, shape (3,)
        Square to it, the way that it is looked at; of any length.
    start : float
        Where the place is in the drawing, to the right.
    span : tuple of 2 floats
        What counts, to the right of the place.
    ends : tuple of 2 ints
        Numbers of the corners that the strip ends at; it goes on in the one that has the same.
    """

    place: FloatArray
    towards: FloatArray
    start: float = 0.0
    span: tuple[float, float] = (-inf, inf)
    ends: tuple[int, int] = (0, 1)

    def find_axes(self, scales: FloatArray) -> FloatArray:
        """Return unit vectors to the right and upwards in the drawing, shape (2, 3).

        They are of coordinates that are so many times as long as those of the input, shape (3,).
        """
        towards = self.towards / scales
        towards /= np.linalg.norm(towards)
        right = np.cross(towards, _ABOVE)
        size = float(np.linalg.norm(right))
        right = right / size if size > _UPRIGHT else np.array([1.0, 0.0, 0.0])
        return np.stack([right, np.cross(right, towards)])


@dataclass(frozen=True, slots=True, eq=False)
class Cut:
    """One section to make: its name, its planes, and how far along a line it is, if it is."""

    name: str
    planes: tuple[Plane, ...]
    station: float | None = None
    line: str = ""


def check_cuts(
    planes: str | Sequence[str], along: object, step: float | None, width: float | None
) -> None:
    """Raise UsageError where what is said of the planes does not fit together."""
    if bool(planes) == (along is not None):
        raise UsageError(
            f"{name_option('plane')} and {name_option('along')} exclude each other"
            if planes
            else "nothing says where to cut",
            f"give {name_option('plane', 'z=10')}, or {name_option('along', 'LINE.geojson')} "
            f"{name_option('step', 5)}",
        )
    if width is not None and (along is None or step is None):
        raise UsageError(
            f"{name_option('width')} is for sections across a line",
            f"give {name_option('along')} and {name_option('step')}, too",
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
    if step is not None and not any(text.strip() in _AXES for text in texts):
        raise UsageError(
            f"{name_option('step')} has nothing to step along",
            f"give an axis as {name_option('plane', 'z')}, or a line as {name_option('along')}",
        )
    return [cut for text in texts for cut in _plan_text(text, step, low, high)]


def _plan_text(text: str, step: float | None, low: FloatArray, high: FloatArray) -> list[Cut]:
    axis, equals, value = text.strip().partition("=")
    if axis in _AXES:
        k = _AXES.index(axis)
        if not equals:
            return [_cut_axis(k, at) for at in _list_multiples(axis, step, low[k], high[k])]
        if len(numbers := _parse(value)) == 1:
            return [_cut_axis(k, numbers[0])]
    elif len(numbers := _parse(text)) == 6 and any(numbers[3:]):
        place, towards = np.array(numbers).reshape(2, 3)
        if abs(towards[2]) < _UPRIGHT * np.linalg.norm(towards):
            place[2] = towards[2] = 0.0
        return [Cut(text, (Plane(place, towards),))]
    raise UsageError(
        f"{name_option('plane', text)}: it is no plane",
        f"write it as z=10, as z with {name_option('step')}, or as X,Y,Z,DX,DY,DZ: a place in it "
        "and a direction square to it",
    )


def _parse(text: str) -> list[float]:
    """Return the numbers of a text; none where one of them is no place."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        return []
    return numbers if is_place(*numbers) else []


def _list_multiples(axis: str, step: float | None, low: float, high: float) -> list[float]:
    if step is None:
        raise UsageError(
            f"{name_option('plane', axis)}: nothing says where",
            f"write {axis}=10, or give {name_option('step')} for all of its multiples",
        )
    can_be_told = max(abs(low), abs(high)) / step <= FARTHEST
    _check_count((high - low) / step if can_be_told else inf)
    return [k * step for k in range(ceil(low / step), floor(high / step) + 1)]


def _check_count(count: float) -> None:
    if count > _MOST_SECTIONS:
        raise UsageError(
            f"more than {_MOST_SECTIONS:,} sections are asked for",
            f"give a larger {name_option('step')}, or fewer lines",
        )


def _cut_axis(axis: int, at: float) -> Cut:
    place, towards = np.zeros(3), np.zeros(3)
    place[axis], towards[axis] = at, _TOWARDS[axis]
    return Cut(f"{_AXES[axis]}={_say(at)}", (Plane(place, towards),))


def plan_along(lines: Sequence[Drawn], step: float | None, width: float | None) -> list[Cut]:
    """Return the sections square to lines at every step, to the right as one walks along them.

    Without a step the one along each line; its stations are to the right. `width` is that of each
    cross section, half of it to either side. Raise UsageError where there are too many.
    """
    _check_count(sum(line.shape.length / step if step else 1.0 for line in lines))
    half = inf if width is None else 0.5 * width
    cuts: list[Cut] = []
    for number, line in enumerate(lines, 1):
        name = line.name or ("" if len(lines) == 1 else f"line {number}")
        corners = np.array(line.shape.coords, dtype=np.float64)
        sides = np.diff(corners, axis=0)
        lengths = np.linalg.norm(sides, axis=1)
        is_side = lengths > 0.0
        # (s, 2) and (s,): where each side begins, its unit vector, and the stations of its ends
        begins, ways = corners[:-1][is_side], sides[is_side] / lengths[is_side, None]
        at = np.append(0.0, np.cumsum(lengths[is_side]))
        if step is None:
            cuts.append(_cut_along(name, begins, ways, at))
        else:
            cuts += _cut_across(name, begins, ways, at, step, half)
    return cuts


def _cut_along(name: str, begins: FloatArray, ways: FloatArray, at: FloatArray) -> Cut:
    planes = [
        Plane(
            np.array([*begin, 0.0]), np.array([-y, x, 0.0]), start, (0.0, end - start), (k, k + 1)
        )
        for k, (begin, (x, y), start, end) in enumerate(
            zip(begins, ways, at[:-1].tolist(), at[1:].tolist(), strict=True)
        )
    ]
    return Cut(name or "profile", tuple(planes), None, name)


def _cut_across(
    name: str, begins: FloatArray, ways: FloatArray, at: FloatArray, step: float, half: float
) -> list[Cut]:
    stations = step * np.arange(floor(at[-1] / step + _ENDS) + 1.0)
    # (n,): the sides before and after each station, which are two at a corner of the line
    before = np.clip(np.searchsorted(at, stations, "left") - 1, 0, len(ways) - 1)
    after = np.clip(np.searchsorted(at, stations, "right") - 1, 0, len(ways) - 1)
    # (n, 2): there a section halves the angle, unless the line turns back
    towards = ways[before] + ways[after]
    turns_back = np.linalg.norm(towards, axis=1) <= _UPRIGHT
    towards = np.where(turns_back[:, None], ways[after], towards)
    places = begins[after] + (stations - at[after])[:, None] * ways[after]
    cuts = []
    for station, place, way in zip(stations.tolist(), places, towards, strict=True):
        plane = Plane(np.append(place, 0.0), np.append(way, 0.0), span=(-half, half))
        cuts.append(Cut(f"{name} {_say(station)}".strip(), (plane,), station, name))
    return cuts


def _say(number: float) -> str:
    """Return a number that was typed, or is a multiple of one, without rounding errors."""
    return f"{number:.10g}"
