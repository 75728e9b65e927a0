"""Points of a place on the earth, from its centre."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hpcapp.geometry.points import FloatArray, PointCloud

_LONG, _SHORT = 6_378_137.0, 6_356_752.3142


def find_place(latitude: float, longitude: float, height: float) -> tuple[FloatArray, FloatArray]:
    """Return a place, and the directions to the east, to the north and up as rows."""
    phi, lam = np.radians([latitude, longitude])
    up = np.array([np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)])
    east = np.array([-np.sin(lam), np.cos(lam), 0.0])
    squares = np.array([_LONG, _LONG, _SHORT]) ** 2
    place = squares * up / np.sqrt(squares @ up**2) + height * up
    return place, np.stack([east, np.cross(up, east), up])


def put_on_earth(cloud: PointCloud, latitude: float, longitude: float = 9.0) -> PointCloud:
    """Return a cloud of x to the east, y to the north and z up there."""
    place, axes = find_place(latitude, longitude, 300.0)
    return replace(cloud, positions=cloud.positions @ axes + place)
