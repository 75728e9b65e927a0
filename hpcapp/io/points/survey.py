"""Whether points were measured from above, as by scanners and cameras on aircraft.

A file never says so. What it has tells: later returns of a pulse, angles that go from side to
side, a class of ground, or coordinates of a map. Scanners on tripods write some of that, too; but
what was flown over is covered evenly as seen on a map, and nothing else is: walls stand on lines of
it, and around a tripod points get ever denser. From the centre of the earth, too, a place is told.
"""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.axes import rotate
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io.crs import METRES, Crs
from hpcapp.io.geocentric import find_upright

EVIDENCE = ("return_number", "scan_angle", "classification")
"""Attributes that tell."""

_GROUND = 2  # class, by the ASPRS
_SWEEP = 2.0  # degrees that the angles of a scan go apart, at least
_EAST, _NORTH = 1e4, 1e5  # least coordinates of places on a map, in metres
_HIGHEST = 1e4  # metres: above that coordinates are those of the whole earth
_NEAR = 0.1  # most that points are apart, by their northing
_FARTHEST = 1e12  # in any unit: beyond it there is no place on earth
_WIDE = 30.0  # metres: less on a map may be anything

_A_CELL = 16  # points on average
_CROWDED = 4.0  # times as many points as most cells have
_UNEVEN = 0.02  # share of the points in such cells


def is_flown_over(points: PointCloud, unit: str | None = None, crs: str | None = None) -> bool:
    """Tell whether points were measured from above.

    They are finite, and have what there is of the attributes `EVIDENCE`.
    """
    if len(points) < 2 * _A_CELL or unit == "degree":
        return False
    low, high = bound_points(points.positions)
    if max(*-low, *high) > _FARTHEST:
        return False
    upright = find_upright(low + points.origin, high + points.origin, Crs(crs, unit))
    positions = rotate(points.positions, upright)
    wide, size = _WIDE / METRES.get(unit or "m", 1.0), np.ptp(positions, axis=0)
    is_wide = bool(min(size[:2]) > wide and size[2] < max(size))
    is_placed = upright is not None or is_projected(points, unit, crs)
    return (_has_evidence(points) or (is_wide and is_placed)) and _is_even(positions)


def is_projected(points: PointCloud, unit: str | None = None, crs: str | None = None) -> bool:
    """Tell whether coordinates are those of a map, so that z is a height."""
    if unit == "degree" or not len(points):
        return False
    metres = METRES.get(unit or "m", 1.0)
    corners = bound_points(points.positions)
    if max(*-corners[0], *corners[1]) > _FARTHEST:
        return False
    columns = zip(points.positions.T, points.origin, strict=True)
    low = [metres * np.abs(column + start).min() for column, start in columns]
    if low[2] > _HIGHEST:
        return False
    size = metres * (corners[1] - corners[0]).max()
    is_map = low[0] > _EAST and low[1] > _NORTH and size < _NEAR * low[1]
    return crs is not None or bool(is_map)


def _has_evidence(points: PointCloud) -> bool:
    """Tell whether the attributes are those of a flight."""
    returns, angles, classes = (points.attributes.get(name) for name in EVIDENCE)
    return (
        (returns is not None and bool((returns > 1).any()))
        or (angles is not None and float(np.ptp(angles)) > _SWEEP)
        or (classes is not None and bool((classes == _GROUND).any()))
    )


def _is_even(positions: FloatArray) -> bool:
    """Tell whether few points are crowded as seen from above."""
    plan = positions[:, :2]
    low, high = bound_points(plan)
    size = high - low
    if not size.all():
        return False
    # Columns and rows of about square cells over the box.
    root = np.sqrt(size)
    cells = np.ceil(np.sqrt(len(plan) / _A_CELL) * root / root[::-1])
    column, row = np.minimum(np.floor((plan - low) / size * cells), cells - 1.0).T
    _, counts = np.unique(row * cells[0] + column, return_counts=True)
    crowded = counts[counts > _CROWDED * np.median(counts)].sum()
    return bool(crowded < _UNEVEN * len(plan))
