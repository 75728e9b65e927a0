"""A small picture of a point cloud: what is nearest is seen."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hpcapp.pages.png import write_png
from hpccomponent.surface.types.points import FloatArray, PointCloud

__all__ = ["draw_points", "write_thumbnail"]

_SIDE = 512  # pixels of the picture
_FEWEST_CELLS = 32  # along the longer side: points are squares of the picture's side over it
_POINTS_PER_CELL = 3.0
_OBLIQUE = np.array([-0.5, -0.8, 0.45])  # where the picture is seen from, if no scanner is known
_BACKGROUND = 255
_NEAR, _FAR = 40, 215  # greys


def write_thumbnail(path: Path, cloud: PointCloud, scanner: FloatArray | None = None) -> None:
    """Draw a cloud into a PNG file.

    Parameters
    ----------
    path : Path
        Appears whole or not at all.
    cloud : PointCloud
    scanner : ndarray of float64, shape (3,), optional
        Where the scanner stood, in the input's coordinates: the points are seen from there.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    write_png(path, draw_points(cloud, scanner))


def draw_points(cloud: PointCloud, scanner: FloatArray | None = None) -> NDArray[np.uint8]:
    """Draw a cloud, in its colours or by depth: what is near is dark.

    Parameters
    ----------
    cloud : PointCloud
        Points that are not finite are not drawn.
    scanner : ndarray of float64, shape (3,), optional
        Where the scanner stood, in the input's coordinates; else it is seen from above and aside.

    Returns
    -------
    ndarray of uint8, shape (h, w, 3)
        White where nothing is; the longer side has at most 512 pixels.
    """
    finite = np.flatnonzero(np.isfinite(cloud.positions).all(axis=1))
    if not len(finite):
        return np.full((_SIDE, _SIDE, 3), _BACKGROUND, np.uint8)
    positions = cloud.positions[finite]
    middle = np.median(positions, axis=0)
    eye = _OBLIQUE if scanner is None else scanner - cloud.origin - middle
    across, up, depth = _look(positions - middle, eye if eye.any() else _OBLIQUE)
    # A few points far away must not make all others one pixel.
    low, high = (np.quantile([across, up], share, axis=1) for share in (0.002, 0.998))
    longest = float((high - low).max()) or 1.0
    low, high = low - 0.02 * longest, high + 0.02 * longest
    cells = int(np.clip(np.sqrt(len(positions) / _POINTS_PER_CELL), _FEWEST_CELLS, _SIDE))
    size = float((high - low).max()) / cells
    width, height = np.maximum(np.ceil((high - low) / size).astype(int), 1).tolist()
    column = ((across - low[0]) / size).astype(int)
    row = ((high[1] - up) / size).astype(int)
    inside = (across >= low[0]) & (column < width) & (up <= high[1]) & (row < height) & (row >= 0)
    order = np.argsort(-depth)  # far ones first: what is drawn later covers what is there
    order = order[inside[order]]
    canvas = np.full((height, width, 3), _BACKGROUND, np.uint8)
    colours = _shade(depth) if cloud.colours is None else cloud.colours[finite]
    canvas[row[order], column[order]] = colours[order]
    zoom = max(1, _SIDE // max(height, width))
    return canvas.repeat(zoom, axis=0).repeat(zoom, axis=1)


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
