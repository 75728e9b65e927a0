"""A picture of whatever is shown: meshes as shaded faces, clouds as discs."""

from __future__ import annotations

from pathlib import Path

from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import PointCloud
from hpcapp.pages.drawing.camera import look_along
from hpcapp.pages.drawing.scale_bar import add_scale_bar
from hpcapp.pages.png import write_png
from hpcapp.pages.render import draw_mesh
from hpcapp.pages.thumbnail import draw_points

EYE = (30.0, 20.0)
"""Azimuth and elevation from where a mesh is seen, in degrees."""


def write_picture(
    path: Path,
    shown: Mesh | PointCloud,
    eye: tuple[float, float] | None = None,
    size: int = 800,
    up: str = "z",
    unit: str | None = None,
) -> None:
    """Draw a mesh or a cloud into a PNG file, which appears whole or not at all.

    Parameters
    ----------
    eye : tuple of float, optional
        Azimuth and elevation, in degrees; for a mesh `EYE` by default.
    size : int
        Pixels along a side, for points along the longer one at most.
    up : {"x", "y", "z"}
        The axis that points up.
    unit : str, optional
        Of the coordinates, for the scale bar.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    if isinstance(shown, PointCloud):
        write_png(path, draw_points(shown, eye=eye, size=size, up=up, unit=unit))
        return
    picture, pixels_per_unit = draw_mesh(shown, look_along(*(eye or EYE), up), size, up)
    write_png(path, add_scale_bar(picture, pixels_per_unit, unit))
