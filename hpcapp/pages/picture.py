"""A picture of whatever is shown: meshes as shaded faces, clouds as discs."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hpcapp.geometry.faces import cross_edges
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.pages.drawing.camera import look_along, turn_upright
from hpcapp.pages.drawing.scale_bar import add_scale_bar
from hpcapp.pages.png import write_png
from hpcapp.pages.render import draw_mesh
from hpcapp.pages.thumbnail import draw_points

EYE = (30.0, 20.0)
"""Azimuth and elevation from where a mesh is seen, in degrees, if it is no sheet: `choose_eye`."""
TURNED = 0.2
"""Length of the mean normal away from the eye, from which on a sheet is seen from behind. The mean
normals of objects and rooms are shorter than .1, those of sheets longer than .5."""
_FACES = 200_000  # that are worked on at once


def write_picture(
    path: Path,
    shown: Mesh | PointCloud,
    eye: tuple[float, float] | None = None,
    size: int = 800,
    up: str = "z",
    unit: str | None = None,
) -> None:
    """Draw a mesh or a cloud into a PNG file, which appears whole or not at all.

    The eye is at an azimuth and an elevation, in degrees, for a mesh `choose_eye` by default. The
    size is in pixels along a side, for points along the longer one at most; the unit is for the
    scale bar. Raise OutputError where the file cannot be written.
    """
    if isinstance(shown, PointCloud):
        write_png(path, draw_points(shown, eye=eye, size=size, up=up, unit=unit))
        return
    axes = look_along(*(eye or choose_eye(shown, up)), up)
    picture, pixels_per_unit = draw_mesh(shown, axes, size, up)
    write_png(path, add_scale_bar(picture, pixels_per_unit, unit))


def choose_eye(mesh: Mesh, up: str) -> tuple[float, float]:
    """Return azimuth and elevation from where the front of a mesh is seen, in degrees."""
    area, total = np.zeros(3), 0.0
    for begin in range(0, len(mesh.faces), _FACES):
        corners = mesh.vertices[mesh.faces[begin : begin + _FACES]]
        crosses = cross_edges(np.nan_to_num(corners))
        area += crosses.sum(axis=0)
        total += float(np.linalg.norm(crosses, axis=1).sum())
    x, y, z = turn_upright(area / max(total, 1e-300), up)
    azimuth, elevation = EYE
    if x * np.cos(np.radians(azimuth)) + y * np.sin(np.radians(azimuth)) < -TURNED:
        azimuth -= 180.0
    return azimuth, -elevation if z < -TURNED else elevation
