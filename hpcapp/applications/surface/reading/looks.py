"""From where a scanner looked around, and which points it measured from there.

A tripod's scans are looks as they are. A path is cut into short pieces, each a look from its
middle; a point is of the piece in whose time it was measured.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from itertools import pairwise

import numpy as np

from hpcapp.applications.surface.reading.reach import EvenSample
from hpcapp.geometry.points import FloatArray, IntArray, PointCloud
from hpcapp.geometry.validity import are_finite
from hpcapp.io import PointSource
from hpcapp.io.points.column_roles import is_time
from hpcapp.io.points.point_source import SCAN
from hpccomponent.dataclass import dataclass

_ROWS = 1 << 20  # at once
_UNTOLD = 1 << 20  # points of a file that does not say how many there are
_PIECE = 0.2
"""Of the distance at which half of the points are: how long a piece of a path is. In a street 56 %
of what moved goes with .2 and 44 % with .1, in a room 37 and 7; of the rest .002 to .004 %."""
_NEAREST = 0.4
"""Of that distance: nearer to a piece, its middle is not where it looked from. With .25, .4 and .5
69, 67 and 56 % of what moved go in a street, 64, 69 and 73 % in a room."""
_PASSED = 4
"""Of so many pieces one is looked from. With 2 (and twice as many looked at to find those that are
asked) 71 % go in a street, not 56, in twice the time; of a room that stands still .15, not
.004 %."""
_PIECE_S = 2.0  # that a piece takes at most: people walk through a bin meanwhile
_APART_S = 4.0  # between a point and what looks through it: what moves must have gone on
_MOST_PIECES = 100_000  # 50 hours, or 20,000 times as far as most points are: else no seconds
_EARLIEST = 1e8  # seconds: clocks that count from 1970 or 1980 have more, and 1e11 at most


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """One of them: where it was, when (from, to), and about how many points it has."""

    place: FloatArray
    points: int
    times: tuple[float, float] = (0.0, 0.0)


class Looks:
    """All looks of a file; nothing where it does not tell them.

    Parameters
    ----------
    looks : list of Look
    nearest : float
        Points nearer to one than that are not judged by it, in length units.
    time : str or None
        The column of times by which points are told; None where they have the number of a scan.
    second : float
        In units of these times.
    """

    def __init__(
        self,
        looks: list[Look],
        nearest: float = 0.0,
        time: str | None = None,
        second: float = 1.0,
    ) -> None:
        self.looks, self.nearest, self._time, self._second = looks, nearest, time, second

    @property
    def is_path(self) -> bool:
        """Whether they are pieces of a path."""
        return self._time is not None

    @cached_property
    def judges(self) -> IntArray:
        """Which of them look at what others have measured."""
        return np.arange(0, len(self.looks), _PASSED if self.is_path else 1)

    def number(self, part: PointCloud) -> IntArray | None:
        """Return the look of each point, (n,), or -1; None where points do not tell."""
        values = part.attributes.get(self._time or SCAN)
        if values is None or self._time is None:
            return None if values is None else values.astype(np.int64)
        begins = np.array([one.times[0] for one in self.looks])
        numbers: IntArray = np.searchsorted(begins, values, "right") - 1
        return np.where(values > self.looks[-1].times[1], -1, numbers)

    def list_others(self, number: int) -> IntArray:
        """Return which judges may have looked through a point of one: at another time."""
        judges = self.judges
        is_other = judges != number
        if self.is_path:
            begin, end = self.looks[number].times
            times = np.array([one.times for one in self.looks])[judges]
            apart = np.maximum(times[:, 0] - end, begin - times[:, 1])
            is_other = apart > _APART_S * self._second
        others: IntArray = judges[is_other]
        return others


def find_looks(source: PointSource, path: FloatArray) -> Looks:
    """Return the looks of a file of several scans, or along a path (n, 4) with the time last."""
    places = [one.scanner for one in source.scans if one.scanner is not None]
    if len(places) >= 2 and len(places) == len(source.scans):
        # Where a file says of none how many points it has, each has as many.
        share = (source.count or _UNTOLD) // len(places)
        return Looks([
            Look(place, one.points or share)
            for place, one in zip(places, source.scans, strict=True)
        ])  # fmt: skip
    return _cut_path(source, path) if len(path) >= 2 else Looks([])


def list_parts(source: PointSource, looks: Looks) -> Iterator[tuple[FloatArray, IntArray]]:
    """Yield finite points (n, 3) and the look of each."""
    for part in source.chunks(_ROWS):
        numbers = looks.number(part)
        if numbers is None:
            return
        is_there = are_finite(part.positions) & (numbers >= 0)
        yield part.positions[is_there], numbers[is_there]


def _cut_path(source: PointSource, path: FloatArray) -> Looks:
    """Return the pieces of a path, where points have times within those of it."""
    sample, times, count, name = EvenSample(), list[FloatArray](), 0, None
    for part in source.chunks(_ROWS):
        name = next((one for one in part.attributes if is_time(one)), None)
        if name is None:
            return Looks([])
        clock = part.attributes[name].astype(np.float64)
        is_within = are_finite(part.positions) & (clock >= path[0, 3]) & (clock <= path[-1, 3])
        count += int(is_within.sum())
        # (n, 3): from the sensor to each point
        eyes = _follow(path, clock[is_within])
        sample.add(part.positions[is_within] - eyes)
        times.append(clock[np.isfinite(clock)][:: max(len(clock) // 1000, 1)])
    if not count:
        known = np.concatenate(times)
        if len(known):
            source.findings.warn(
                f"what moved is not looked for: points were measured from {known.min():g} to "
                f"{known.max():g}, the trajectory goes from {path[0, 3]:g} to {path[-1, 3]:g}"
            )
        return Looks([])
    far, second = float(np.median(np.linalg.norm(sample.positions, axis=1))), _find_second(path)
    steps = np.linalg.norm(np.diff(path[:, :3], axis=0), axis=1)
    # (n,): how many pieces the path has taken at each of its places, by length or by time
    pieces = np.maximum(
        steps / max(_PIECE * far, 1e-300), np.diff(path[:, 3]) / (_PIECE_S * second)
    )
    taken = np.append(0.0, np.cumsum(pieces))
    if path[0, 3] == path[-1, 3] or taken[-1] > _MOST_PIECES:
        source.findings.warn(
            f"what moved is not looked for: the trajectory goes {steps.sum():g} in a time of "
            f"{np.ptp(path[:, 3]):g}, and most points are {far:g} away from it"
        )
        return Looks([])
    bounds = np.interp(np.linspace(0.0, taken[-1], int(taken[-1]) + 2), taken, path[:, 3])
    shares = np.diff(bounds) / (bounds[-1] - bounds[0])
    middles = _follow(path, 0.5 * (bounds[:-1] + bounds[1:]))
    looks = [
        Look(place, int(share * count), ends)
        for place, share, ends in zip(middles, shares, pairwise(bounds.tolist()), strict=True)
    ]
    return Looks(looks, _NEAREST * far, name, second)


def _find_second(path: FloatArray) -> float:
    """Return how many units of time of a path are a second: 1, a thousand, a million, a billion.

    Examples
    --------
    >>> [_find_second(np.array([[0.0, 0.0, 0.0, time]])) for time in (5e5, 1.4e9, 1.7e12, 1.7e18)]
    [1.0, 1.0, 1000.0, 1000000000.0]
    """
    thousands = np.log10(max(float(np.abs(path[:, 3]).max()), 1.0) / _EARLIEST) // 3
    return float(1000.0 ** max(thousands, 0.0))


def _follow(path: FloatArray, times: FloatArray) -> FloatArray:
    """Return where a sensor was at some times, (n, 3)."""
    return np.stack([np.interp(times, path[:, 3], path[:, axis]) for axis in range(3)], axis=1)
