"""How fine the evaluation grid is: as asked for, or as the scan and the memory allow."""

from __future__ import annotations

import logging
from math import sqrt
from typing import Protocol

import numpy as np

from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.methods.method import MARGIN, MAX_GRID, MIN_GRID, MethodSettings
from hpcapp.applications.surface.resolution.memory import check_memory, fit_memory
from hpcapp.geometry.points import FloatArray
from hpccomponent.cli.option_names import name_option
from hpccomponent.errors import UsageError

log = logging.getLogger("hpcapp")

_LEAST_GUESS = 256


class Asked(Protocol):
    """What a user asks of the resolution: at most one of three, or that the method chooses.

    They are cells along the longest side, margins included, as a number or its binary logarithm
    (`depth`), and the edge of one, in length units of the input.
    """

    @property
    def method(self) -> MethodSettings: ...  # noqa: D102 - see the class

    @property
    def grid(self) -> int | None: ...  # noqa: D102 - see the class

    @property
    def depth(self) -> int | None: ...  # noqa: D102 - see the class

    @property
    def voxel_size(self) -> float | None: ...  # noqa: D102 - see the class


def find_grid(settings: Asked, cloud: ArrangedCloud) -> int:
    """Return the cells along the longest side: asked for, or chosen by the method and announced.

    A chosen grid is never larger than what memory holds. UsageError where the voxels are too small
    or too large, or memory does not hold the grid that is asked for; InputError where the method
    finds nothing to choose by.
    """
    asked = choose_grid(settings, cloud.low, cloud.high)
    if asked is not None:
        check_memory(settings.method, asked, cloud)
        return asked
    suited = settings.method.suggest_grid(cloud)
    grid = min(suited.grid, fit_memory(settings.method, suited.grid, cloud))
    reason = suited.reason
    if grid < suited.grid:
        reason = f"all that memory holds; {suited.grid} would suit ({reason})"
    log.info("grid %d: %s", grid, reason)
    return grid


def choose_grid(settings: Asked, low: FloatArray, high: FloatArray) -> int | None:
    """Return the cells along the longest side, margins included, asked for in one of three ways.

    `low` and `high`, (3,), are corners of the box around all points. None where the method is to
    choose; UsageError where the voxels are too small or too large.
    """
    if settings.depth is not None:
        return int(2**settings.depth)
    if settings.voxel_size is None:
        return settings.grid
    longest = float((high - low).max())
    with np.errstate(over="ignore"):
        cells = float(np.ceil(np.float64(longest) / settings.voxel_size)) + 2 * MARGIN
    if not MIN_GRID <= cells <= MAX_GRID:  # NaN is not, either
        raise UsageError(
            f"{name_option('voxel_size', settings.voxel_size)} means {cells:g} cells along the "
            "longest side",
            f"choose one that gives {MIN_GRID} to {MAX_GRID}; the side is {longest:g} long",
        )
    return int(cells)


def guess_grid(settings: Asked, points: int) -> int:
    """Return the cells along the longest side before any point is read: as many as there may be.

    What is asked for; else that of about so many points spread evenly over a square.
    """
    if settings.depth is not None:
        return int(2**settings.depth)
    return settings.grid or min(max(_LEAST_GUESS, int(sqrt(points))), MAX_GRID)
