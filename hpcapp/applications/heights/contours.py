"""Contours of a grid of heights, as GeoJSON."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil, floor, log10
from pathlib import Path

import numpy as np
from skimage.measure import find_contours

from hpcapp.applications.heights.geotiff import Crs
from hpcapp.applications.heights.grid import HeightGrid
from hpcapp.geometry.points import FloatArray
from hpcapp.io.geojson import write_lines
from hpccomponent.errors import UsageError

_MOST_LEVELS = 10_000


def write_contours(path: Path, grid: HeightGrid, interval: float, crs: Crs | None) -> int:
    """Write the lines of all heights that are multiples of an interval, and return how many.

    Coordinates are those of the map, rounded to a thousandth of a cell. Raise OutputError where the
    file cannot be written, and UsageError where there are too many heights.
    """
    lines = (({"height": height}, line) for height, line in find_lines(grid, interval))
    code = None if crs is None else crs.to_epsg()
    text = None if crs is None else crs.to_wkt() if code is None else f"EPSG:{code}"
    return write_lines(path, lines, text)


def find_lines(grid: HeightGrid, interval: float) -> Iterator[tuple[float, FloatArray]]:
    """Yield each line with its height: x and y on the map, shape (n, 2).

    Raise UsageError where there are too many heights.
    """
    low, high = float(np.nanmin(grid.values)), float(np.nanmax(grid.values))
    if (high - low) / interval > _MOST_LEVELS:
        raise UsageError(
            f"an interval of {interval:g} makes more than {_MOST_LEVELS:,} heights",
            "give a larger --interval",
        )
    decimals = 3 - floor(log10(grid.step))
    for number in range(ceil(low / interval), floor(high / interval) + 1):
        height = number * interval
        # scikit-image has no types
        for line in find_contours(grid.values, height):  # type: ignore[no-untyped-call]
            rows, columns = line.T
            places = [grid.west + (columns + 0.5) * grid.step,
                      grid.north - (rows + 0.5) * grid.step]  # fmt: skip
            yield height, np.stack(places, axis=1).round(decimals)
