"""The grid of heights of a terrain, in the coordinates of its map."""

from __future__ import annotations

import logging
from math import ceil, floor, log10
from os import PathLike
from pathlib import Path

import numpy as np
from scipy.ndimage import uniform_filter
from scipy.stats import norm

from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io.crs import Crs
from hpcapp.terrain.epoch import FEW_LAYERS, MOST_CELLS, PER_CELL, Epoch
from hpcapp.terrain.errors import CONFIDENCE
from hpcapp.terrain.heights import PLANE, Heights
from hpcapp.terrain.lattice import Lattice
from hpcapp.wording import say_share
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError, UsageError
from hpccomponent.ranges import check_range

log = logging.getLogger("hpcapp")

_FEWER = 0.5  # points of a part, by those of a usual cell
_MOST_PARTS = 63  # along a cell
_AROUND = 5  # cells across which relief is told
_UNSEEN = 0.4
"""Variance of the relief in a cell by that between a cell and those around
(`benchmarks/volumes.py`)."""
_TOLD = 1000  # deviations whose normal distributions are mixed
_NORMAL = np.abs(norm.ppf(np.arange(0.5, 100.0) / 200.0))
"""A normal distribution, either way, in hundredths."""
_MAP = 0.8
"""Width of a cell of a map by the spacing of points where they are sparse, before it is rounded up:
the narrowest that leaves no holes. Of ground points of an airborne scan that were held back, 6.0 ft
apart, 5 ft miss .19 ft and cover 90 %, 10 ft .31 and 96 %, 20 ft .57 and 92 %; cells of .78
spacings cover a tenth less than those of twice the width, of .82 to 1.0 at most .03 less."""
_ROUND = (1.0, 2.0, 5.0, 10.0)  # times a power of ten: widths that a map has


@dataclass(frozen=True, slots=True, eq=False)
class HeightGrid:
    """Heights in square cells, as a map has them.

    Parameters
    ----------
    values : ndarray of float64, shape (rows, columns)
        At the middles of the cells, in the unit of heights of the file; the first row is the
        northernmost. NaN where nothing was scanned.
    west, north : float
        The corner of the first cell, on the map.
    step : float
        Width of a cell.
    crs : Crs
    uncertainty : float
        Within which 95 % of the heights are, as points tell it; zero of a mesh.
    """

    values: FloatArray
    west: float
    north: float
    step: float
    crs: Crs
    uncertainty: float

    def save(
        self,
        path: str | PathLike[str],
        *,
        contours: str | PathLike[str] | None = None,
        interval: float | None = None,
    ) -> int:
        """Write a GeoTIFF, and contours as GeoJSON where both are given; return how many.

        Raise OutputError where a file cannot be written, UsageError where the interval is too
        small, and MissingLibraryError where rasterio is not installed.
        """
        from hpcapp.applications.heights.contours import write_contours
        from hpcapp.applications.heights.geotiff import read_crs, write_geotiff

        if (contours is None) != (interval is None):
            raise UsageError("contours and their interval belong together", "give both, or none")
        if interval is not None:
            check_range("interval", interval, 0.0, is_open=True)
        crs = read_crs(self.crs.text, Path(path))
        with write_geotiff(Path(path), self, crs):
            if contours is None or interval is None:
                return 0
            return write_contours(Path(contours), self, interval, crs)


def grid_heights(ground: Epoch, step: float | None) -> HeightGrid:
    """Return the heights of a mesh, or of points, in cells whose borders are multiples of a step.

    By default cells are as wide as points are apart where they are sparse, or a five-hundredth of a
    mesh, rounded to what a map has; wider where that were too many. Raise InputError where no cell
    has a height, and UsageError where a step makes too many cells.
    """
    origin = ground.surface.origin
    flat = ground.turn("z", origin)
    need = flat.choose_step()
    is_cloud = isinstance(flat.surface, PointCloud)
    usual = _round_up(_MAP * need / PER_CELL**0.5 if is_cloud else need)
    width = step or usual
    low, high = (corner + origin for corner in bound_points(flat.positions))
    (west, south), (columns, rows) = _lay_cells(low, high, width)
    if columns * rows > MOST_CELLS:
        # a row and a column more than the area has, where it does not begin at a border
        least = _round_up(width * (1.01 * columns * rows / MOST_CELLS) ** 0.5)
        if step is not None:
            raise UsageError(
                f"{columns:,} by {rows:,} cells {width:.3g} wide are more than {MOST_CELLS:,}",
                f"give {name_option('step', least)} or more",
            )
        width = least
        (west, south), (columns, rows) = _lay_cells(low, high, width)
    parts = _split(width, need, MOST_CELLS / (columns * rows))
    lattice = Lattice(
        (west - origin[0], south - origin[1]), width / parts, (rows * parts, columns * parts)
    )
    heights = flat.read_heights(lattice, need / PER_CELL**0.5)
    middle = slice(parts // 2, None, parts)
    values, deviations = (array[middle, middle] for array in _smooth(heights))
    values = np.where(heights.cover[middle, middle] > 0.5, values, np.nan)
    is_known = np.isfinite(values)
    if not is_known.any():
        raise InputError(
            f"{ground.name}: has no height at the middles of cells {width:.3g} wide",
            f"give another {name_option('step')}: its points are dense enough for {usual:g}",
        )
    layered = float(heights.is_layered[heights.cover > 0.0].mean())
    if layered > FEW_LAYERS:
        log.warning(
            "heights differ by more than a cell is wide on %s of the area: crowns and walls "
            "are counted as ground unless they are left out",
            say_share(layered),
        )
    scale = ground.crs.height_scale
    return HeightGrid(
        (values[::-1] + origin[2]) / scale, west, south + rows * width, width, ground.crs,
        _find_uncertainty(deviations[is_known]) / scale,
    )  # fmt: skip


def _lay_cells(
    low: FloatArray, high: FloatArray, width: float
) -> tuple[tuple[float, float], tuple[int, int]]:
    """Return west and south of the cells over a box, and the number of columns and rows."""
    west, south = (width * floor(along / width) for along in low[:2].tolist())
    columns, rows = (
        max(ceil((along - start) / width), 1)
        for along, start in zip(high[:2].tolist(), (west, south), strict=True)
    )
    return (west, south), (columns, rows)


def _split(width: float, need: float, most: float) -> int:
    """Return in how many parts, an odd number, the side of a cell is fitted.

    So that its middle is that of a part, which is no narrower than points suffice for: those of
    half a usual cell.
    """
    parts = 1
    most = min(most, _MOST_PARTS**2)
    while width / (parts + 2) >= need * _FEWER**0.5 and (parts + 2) ** 2 <= most:
        parts += 2
    return parts


def _smooth(heights: Heights) -> tuple[FloatArray, FloatArray]:
    """Return the heights at the middles of cells, and the standard deviations of their errors.

    What means over cells differ by from means over nine of them is relief or noise: so much of it
    is kept as there is relief (Wiener's filter).
    """
    relief = heights.values - heights.planes
    has_both = np.isfinite(relief)
    known = uniform_filter(has_both.astype(np.float64), _AROUND)
    both = np.maximum(known, 1e-9)
    told = uniform_filter(np.where(has_both, relief, 0.0) ** 2, _AROUND) / both
    noise = uniform_filter(np.where(has_both, heights.variances, 0.0), _AROUND) / both
    bent = np.maximum(told - noise, 0.0)
    kept = bent / np.maximum(bent + heights.variances, np.finfo(np.float64).tiny)
    variances = heights.variances * (kept + (1.0 - kept) / PLANE) + _UNSEEN * bent
    return heights.planes + kept * relief, np.sqrt(variances)


def _find_uncertainty(deviations: FloatArray) -> float:
    """Return within what `CONFIDENCE` of the heights are."""
    some = deviations[:: -(-len(deviations) // _TOLD)]
    return float(np.quantile(np.outer(some, _NORMAL), CONFIDENCE))


def _round_up(width: float) -> float:
    power = 10.0 ** floor(log10(width))
    return next(power * factor for factor in _ROUND if power * factor >= width * (1.0 - 1e-9))
