"""The grid of heights of a terrain, in the coordinates of its map."""

from __future__ import annotations

import logging
from math import ceil, floor, log10, sqrt

import numpy as np

from hpcapp.applications.compare.volume.epochs import FEW_LAYERS, MOST_CELLS, Epoch
from hpcapp.applications.compare.volume.errors import LIKELY
from hpcapp.applications.compare.volume.lattice import PLANES_PER_POINT, Heights, Lattice
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.points import FloatArray
from hpcapp.io.crs import Crs
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import InputError, UsageError

log = logging.getLogger("hpcapp")

_BENT = 0.5 * 3.0**2 / 12.0
"""Half the variance of places in three cells: what a plane errs by, of a bend."""
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


def grid_heights(ground: Epoch, step: float | None) -> HeightGrid:
    """Return the heights of a mesh, or of points, in cells whose borders are multiples of a step.

    Parameters
    ----------
    step : float, optional
        Width of a cell; by default what points or faces are dense enough for, rounded up.

    Raises
    ------
    InputError
        No cell has a height.
    UsageError
        There are too many cells.
    """
    origin = ground.surface.origin
    flat = ground.turn("z", origin)
    width = step or _round_up(flat.choose_step())
    low, high = (corner + origin for corner in bound_points(flat.positions))
    west, south = (width * floor(along / width) for along in low[:2].tolist())
    columns, rows = (
        max(ceil((along - start) / width), 1)
        for along, start in zip(high[:2].tolist(), (west, south), strict=True)
    )
    if columns * rows > MOST_CELLS:
        raise UsageError(
            f"{columns:,} by {rows:,} cells {width:.3g} wide are more than {MOST_CELLS:,}",
            f"give a --step of {_round_up(width * (columns * rows / MOST_CELLS) ** 0.5):g} or more",
        )
    lattice = Lattice((west - origin[0], south - origin[1]), width, (rows, columns))
    heights = flat.read_heights(lattice)
    is_known = np.isfinite(heights.values)
    if not is_known.any():
        raise InputError(
            f"{ground.name}: has no height in cells {width:.3g} wide", "give a larger --step"
        )
    layered = float(heights.is_layered[is_known].mean())
    if layered > FEW_LAYERS:
        log.warning(
            "heights differ by more than a cell is wide on %.2g %% of the area: crowns and walls "
            "are counted as ground unless they are left out",
            100.0 * layered,
        )
    scale = ground.crs.height_scale
    return HeightGrid(
        (heights.values[::-1] + origin[2]) / scale, west, south + rows * width, width, ground.crs,
        _find_uncertainty(heights) / scale,
    )  # fmt: skip


def _find_uncertainty(heights: Heights) -> float:
    """Return what the scatter of points, and bends that a plane takes for none, make of heights."""
    z = heights.values
    scatter = float(
        np.nanmean(
            np.where(np.isfinite(z), heights.variances + heights.relief / PLANES_PER_POINT, np.nan)
        )
    )
    if scatter == 0.0:
        return 0.0
    bends = z[1:-1, 2:] + z[1:-1, :-2] + z[2:, 1:-1] + z[:-2, 1:-1] - 4.0 * z[1:-1, 1:-1]
    known = _BENT * bends[np.isfinite(bends)]
    bent = float((known**2).mean()) if len(known) else 0.0
    return LIKELY * sqrt(scatter + bent)


def _round_up(width: float) -> float:
    power = 10.0 ** floor(log10(width))
    return next(power * factor for factor in _ROUND if power * factor >= width * (1.0 - 1e-9))
