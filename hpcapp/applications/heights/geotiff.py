"""Write heights as a GeoTIFF, in the coordinate reference system of their file."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from hpcapp.applications.heights.grid import HeightGrid
from hpcapp.extras import load_library
from hpcapp.io.crs import parse_epsg
from hpcapp.io.staging import replacing
from hpccomponent.errors import OutputError

log = logging.getLogger("hpcapp")

_Foreign = Any  # of rasterio, which has no stubs
Crs = Any
"""A coordinate reference system of rasterio."""


def load_rasterio(path: Path) -> _Foreign:
    """Return the library; MissingLibraryError where it is not installed."""
    return load_library("rasterio", f"{path}: GeoTIFF needs the package rasterio", "gis")


def read_crs(text: str | None, path: Path) -> Crs | None:
    """Return a coordinate reference system as rasterio has it; None, with a warning, of others.

    The path is that of the GeoTIFF that is to state it.
    """
    rasterio = load_rasterio(path)
    if text is None:
        log.warning("%s: states no coordinate reference system: the input has none", path)
        return None
    code, known = parse_epsg(text), rasterio.crs.CRS
    try:
        return known.from_wkt(text) if code is None else known.from_epsg(code)
    except (rasterio.errors.CRSError, ValueError):  # the latter: characters that are none
        log.warning("%s: states no coordinate reference system: %r is none by name", path, text)
        return None


@contextmanager
def write_geotiff(path: Path, grid: HeightGrid, crs: Crs | None) -> Iterator[None]:
    """Write heights as one band in single precision; NaN is where there are none.

    The file takes its place when the block ends well: what else is written belongs into it. Raise
    MissingLibraryError without rasterio, and OutputError where the file cannot be written.
    """
    rasterio = load_rasterio(path)
    rows, columns = grid.values.shape
    transform = rasterio.Affine(grid.step, 0.0, grid.west, 0.0, -grid.step, grid.north)
    try:
        with rasterio.MemoryFile() as memory:  # GDAL says nothing of a disk that is full
            with memory.open(
                driver="GTiff", width=columns, height=rows, count=1,
                dtype="float32", nodata=math.nan, crs=crs,
                transform=transform, compress="deflate", predictor=3, tiled=True,
            ) as image:  # fmt: skip
                image.write(grid.values.astype(np.float32), 1)
                image.set_band_description(1, "height")
                image.units = (grid.crs.height_unit or grid.crs.unit or "",)
            with replacing(path) as file:
                file.write(memory.getbuffer())
                file.flush()  # a full disk says so here
                yield
    except rasterio.errors.RasterioError as error:
        why = str(error).partition("\n")[0]
        raise OutputError(f"{path}: cannot be written: {why}", "check for room") from error
