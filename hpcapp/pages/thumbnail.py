"""A small picture of a point cloud: what is nearest is seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpcapp.applications.surface.types.points import FloatArray, PointCloud
from hpcapp.pages.png import write_png

__all__ = ["draw_points", "write_thumbnail"]

_SIDE = 512  # pixels of the picture
_FEWEST_CELLS = 32  # along the longer side: points are squares of the picture's side over it
_POINTS_PER_CELL = 3.0
_OBLIQUE = np.array([-0.5, -0.8, 0.45])  # where the picture is seen from, if no scanner is known
_BACKGROUND = 255
_NEAR, _FAR = 40, 215  # greys


def write_thumbnail(path: Path, cloud: PointCloud, scanner: FloatArray | None = None) -> None:
    """Draw a cloud into a PNG file, which appears whole or not at all.

    Parameters
    ----------
    scanner : ndarray of float64, shape (3,), optional
        Where the scanner stood, in the input's coordinates: the points are seen from there.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    write_png(path, draw_points(cloud, scanner))


def draw_points(
    cloud: PointCloud,
    scanner: FloatArray | None = None,
    *,
    eye: tuple[float, float] | None = None,
    size: int = _SIDE,
    up: str = "z",
) -> NDArray[np.uint8]:
    """Draw a cloud, in its colours or by depth: what is near is dark.

    Parameters
    ----------
    cloud : PointCloud
        Points that are not finite are not drawn.
    scanner : ndarray of float64, shape (3,), optional
        Where the scanner stood, in the input's coordinates; else it is seen from above and aside.
    eye : tuple of float, optional
        Azimuth and elevation to see it from, in degrees.
    size : int
        Pixels along the longer side at most.
    up : {"x", "y", "z"}
        The axis that points up.

    Returns
    -------
    ndarray of uint8, shape (h, w, 3)
        White where nothing is.
    """
    finite = np.flatnonzero(np.isfinite(cloud.positions).all(axis=1))
    if not len(finite):
        return np.full((size, size, 3), _BACKGROUND, np.uint8)
    turns = 2 - "xyz".index(up)
    positions = np.roll(cloud.positions[finite], turns, axis=1)
    middle = np.median(positions, axis=0)
    seen_from = _OBLIQUE
    if eye is not None:
        seen_from = _direction(*eye)
    elif scanner is not None:
        seen_from = np.roll(scanner - cloud.origin, turns) - middle
    across, above, depth = _look(positions - middle, seen_from if seen_from.any() else _OBLIQUE)
    # A few points far away must not make all others one pixel.
    low, high = (np.quantile([across, above], share, axis=1) for share in (0.002, 0.998))
    longest = float((high - low).max()) or 1.0
    low, high = low - 0.02 * longest, high + 0.02 * longest
    cells = int(np.clip(np.sqrt(len(positions) / _POINTS_PER_CELL), min(_FEWEST_CELLS, size), size))
    cell = float((high - low).max()) / cells
    width, height = np.maximum(np.ceil((high - low) / cell).astype(int), 1).tolist()
    column = ((across - low[0]) / cell).astype(int)
    row = ((high[1] - above) / cell).astype(int)
    inside = (
        (across >= low[0]) & (column < width) & (above <= high[1]) & (row < height) & (row >= 0)
    )
    order = np.argsort(-depth)  # far ones first: what is drawn later covers what is there
    order = order[inside[order]]
    canvas = np.full((height, width, 3), _BACKGROUND, np.uint8)
    colours = _shade(depth) if cloud.colours is None else cloud.colours[finite]
    canvas[row[order], column[order]] = colours[order]
    zoom = max(1, size // max(height, width))
    return canvas.repeat(zoom, axis=0).repeat(zoom, axis=1)


def _direction(azimuth: float, elevation: float) -> FloatArray:
    """Return where an eye is, by two angles in degrees."""
    az, el = np.radians([azimuth, elevation])
    return np.array([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)])


def _look(arms: FloatArray, eye: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return coordinates to the right, upwards and away from an eye that keeps z upright."""
    back = eye / np.linalg.norm(eye)
    right = np.cross([0.0, 0.0, 1.0], back)
    right = right / np.linalg.norm(right) if right.any() else np.array([1.0, 0.0, 0.0])
    return arms @ right, arms @ np.cross(back, right), -(arms @ back)


def _shade(depth: FloatArray) -> NDArray[np.uint8]:
    """Return greys by depth."""
    near, far = np.quantile(depth, (0.01, 0.99))
    share = np.clip((depth - near) / ((far - near) or 1.0), 0, 1)
    greys = (_NEAR + (_FAR - _NEAR) * share).astype(np.uint8)
    return np.repeat(greys[:, None], 3, axis=1)
