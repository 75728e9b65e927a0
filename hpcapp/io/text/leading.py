"""What stands in front of x, y and z where no column has a name, and which of them comes first.

Survey lists begin with a number of the point, and most go on with the northing; logs begin with the
time. Both only grow from row to row, evenly, as x does not: where a cloud is sorted by x, its steps
are of any length, or zero.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.geometry.validity import are_finite
from hpcapp.io.points.column_roles import AXES, judge_normals
from hpcapp.io.points.survey import is_projected

NORTHING_FIRST = ("y", "x", "z")

_FEWEST_ROWS = 20  # that tell whether a column grows
_EVEN = 0.75
"""Share of the steps within twice and half the median: .46 where random numbers are sorted, 1 of a
clock; of numbers of points more than .9."""
_STILL = 0.05  # share of steps of zero that a clock has at most
_LATEST = 1e8  # no coordinate on earth, in metres or feet; seconds since 1970 or 1980 are more

_IN_NAME = re.compile(r"(?<![a-z])p(ne|en)zd?(?![a-z])")
_NORTH, _EAST = (1e6, 1e7), (1e5, 9e5)  # of UTM, in metres; near the equator nothing can tell
_FARTHEST_EAST = 4e6
"""US feet: where northings are below 9e5, the eastings of State Plane zones end at 3.4e6 (Maine and
Indiana, 900 km at their middle), or begin at 1.2e7 (Michigan); a northing of UTM is as likely."""


def are_point_numbers(sample: FloatArray) -> bool:
    """Tell whether the first column numbers the points whose coordinates follow.

    The sample (n, columns) is of rows in the order of the file.
    """
    sample = sample[are_finite(sample[:, :4])]
    if sample.shape[1] < 4 or not len(sample) or _has_fractions(sample[:, 0]):
        return False
    if sample[:, 0].max() > _LATEST:
        return False
    if are_on_map(sample[:, 1:4]):
        return True
    if sample[0, 0] in (0, 1):  # it may begin anew with each scan
        sample = sample[:_FEWEST_ROWS]
    steps = np.diff(sample[:, 0])
    are_coordinates = all(map(_has_fractions, sample[:, 1:4].T))
    return are_coordinates and _is_even(steps) and float(np.median(steps)) == 1.0


def find_named_order(path: Path) -> tuple[str, ...]:
    """Return the axes that the name of a survey list spells, as in ``site_pnezd.csv``, or none."""
    named = _IN_NAME.search(path.stem.lower())
    return () if named is None else NORTHING_FIRST if named[1] == "ne" else AXES


def is_time(sample: FloatArray) -> bool:
    """Tell whether the first column is the time at which the coordinates that follow were taken."""
    sample = sample[are_finite(sample[:, :4])]
    if sample.shape[1] < 4 or not all(map(_has_fractions, sample[:, 1:4].T)):
        return False
    if sample.shape[1] > 5 and judge_normals(sample[:, 3:6]) == "unit":
        return False
    steps = np.diff(sample[:, 0])
    is_late = sample[:, 0].min() > _LATEST
    return _is_even(steps) or (is_late and _only_grows(steps))


def find_order(sample: FloatArray) -> tuple[str, ...]:
    """Return the axes that map coordinates behind the number of a point are, or none: by UTM.

    What may as well be a northing and an easting in feet is not told.
    """
    first, second = sample[:, 0], sample[:, 1]
    if _lies_in(first, _NORTH) and _lies_in(second, _EAST):
        return NORTHING_FIRST
    far_north = (_FARTHEST_EAST, _NORTH[1])
    return AXES if _lies_in(first, _EAST) and _lies_in(second, far_north) else ()


def are_on_map(sample: FloatArray) -> bool:
    """Tell whether three columns are coordinates of a map, whichever of two comes first."""
    finite = sample[are_finite(sample[:, :3])]
    return any(is_projected(PointCloud(finite[:, order])) for order in ([0, 1, 2], [1, 0, 2]))


def _lies_in(values: FloatArray, limits: tuple[float, float]) -> bool:
    return bool(len(values) and values.min() >= limits[0] and values.max() <= limits[1])


def _has_fractions(values: FloatArray) -> bool:
    return bool((values != np.rint(values)).any())


def _only_grows(steps: FloatArray) -> bool:
    """Tell whether no step goes back, but one: a sample of a large file begins twice."""
    return len(steps) >= _FEWEST_ROWS - 1 and bool((steps < 0).sum() <= 1 and steps.sum() > 0)


def _is_even(steps: FloatArray) -> bool:
    """Tell whether steps go on, most of them about as far as the others."""
    if not _only_grows(steps) or (steps == 0).mean() > _STILL:
        return False
    usual = float(np.median(steps))
    return bool(((steps >= usual / 2) & (steps <= 2 * usual)).mean() > _EVEN)
