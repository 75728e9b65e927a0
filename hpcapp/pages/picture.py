"""A picture of whatever is shown: meshes as shaded faces, clouds as points."""

from __future__ import annotations

from pathlib import Path

from hpcapp.applications.surface.types.mesh import Mesh
from hpcapp.applications.surface.types.points import PointCloud
from hpcapp.pages.png import write_png
from hpcapp.pages.render import render_mesh
from hpcapp.pages.thumbnail import draw_points

__all__ = ["EYE", "write_picture"]

EYE = (30.0, 20.0)
"""Azimuth and elevation from where a mesh is seen, in degrees."""


def write_picture(
    path: Path,
    shown: Mesh | PointCloud,
    eye: tuple[float, float] | None = None,
    size: int = 800,
    up: str = "z",
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

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    if isinstance(shown, PointCloud):
        write_png(path, draw_points(shown, eye=eye, size=size, up=up))
        return
    azimuth, elevation = eye or EYE
    write_png(path, render_mesh(shown, azimuth, elevation, size, up))
