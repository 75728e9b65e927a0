"""Coordinates from the centre of the earth (ECEF, EPSG:4978), where up is across the ellipsoid.

3D Tiles, photogrammetry and GNSS write them. A file says so, or its coordinates do: all of them lie
near the ellipsoid, which those of a map do not, for their heights are small.
"""

from __future__ import annotations

import numpy as np

from hpcapp.geometry.points import FloatArray
from hpcapp.io.crs import METRES, Crs, is_geocentric
from hpccomponent.errors import InputError

_AXES = np.array([6_378_137.0, 6_378_137.0, 6_356_752.3142])  # half, of WGS 84, in metres
_HIGH = 2e4  # metres above or below it: the earth has -11 to 9 km, what flies over it 20
_FARTHEST = 1e7  # metres: no place on the earth is
_WIDE = 1e5  # metres: over those, up turns by a degree
# Where z is a height, |z| is less; a northing of 6,350 km and an easting are as far from zero as
# the equator. Where y is one, x and z are as near a pole as nobody scans: 81 degrees.
_LEAST_Z, _LEAST_RADIUS = 1e4, 1e6


def find_upright(low: FloatArray, high: FloatArray, crs: Crs) -> FloatArray | None:
    """Return the axes of a local frame, (3, 3): rows to the east, to the north and up, or None.

    Points lie between low and high, in the file's coordinates. None is for coordinates that are not
    from the centre of the earth.

    Examples
    --------
    >>> place = np.array([0.0, 6_378_137.0, 100_000.0])
    >>> find_upright(place, place + 10.0, Crs(None, "m"))[2].round(1).tolist()
    [0.0, 1.0, 0.0]
    """
    metres = METRES.get(crs.unit or "m", 1.0)
    if crs.unit == "degree" or max(*-low, *high) > _FARTHEST / metres:
        return None
    middle, size = metres * (0.5 * low + 0.5 * high), metres * float((high - low).max())
    radius = float(np.hypot(middle[0], middle[1]))
    # Along the ray from the centre, the ellipsoid is where this is 1.
    share = float(np.linalg.norm(middle / _AXES))
    distance = float(np.linalg.norm(middle))
    if not share or abs(distance - distance / share) > _HIGH:
        return None
    is_known = size < _WIDE and abs(middle[2]) > _LEAST_Z and radius > _LEAST_RADIUS
    if not (is_known or is_geocentric(crs.text)):
        return None
    up = middle / _AXES**2
    up /= np.linalg.norm(up)
    along = np.arctan2(middle[1], middle[0])
    east = np.array([-np.sin(along), np.cos(along), 0.0])
    return np.stack([east, np.cross(up, east), up])


def refuse_geocentric(name: str, low: FloatArray, high: FloatArray, crs: Crs) -> None:
    """Refuse coordinates from the earth's centre where z has to be a height: raise InputError."""
    if find_upright(low, high, crs) is not None:
        raise InputError(
            f"{name}: its coordinates are from the centre of the earth (ECEF), and z is no height",
            "project it to a map first, by pdal translate with filters.reprojection, for one",
        )
