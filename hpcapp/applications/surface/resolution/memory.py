"""Whether a job fits into memory, found out before it starts: the system kills without a word."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hpcapp import kernels
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.cloud.spacing import estimate_spacing
from hpcapp.applications.surface.methods.method import (
    BYTES_OF_PROGRAM,
    BYTES_PER_POINT,
    TILE_POINTS,
    MethodSettings,
)
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.points import PointCloud
from hpcapp.io.registry import find_point_reader
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import HpcError, UsageError
from hpccomponent.limits import available_memory
from hpccomponent.units import parse_size

LEAST_MEMORY = 256 * 2.0**20
#: The boxes along the surface are counted on a sample of them, with about so many points.
SAMPLED_POINTS = 1_000_000
#: Below this a job fits on any machine that runs it.
SMALL_GRID = 256


#: What a tile takes of the process that makes its mesh, a point: 200 of a closed surface, 540 of a
#: terrain without normals.
BYTES_PER_TILE_POINT = 600.0
LEAST_TILE = 50_000
_SIZES = 40  # of tiles that are looked at, each a tenth smaller
#: What waits beside local workers: their loaders and components.
BYTES_OF_LOADERS = 1e8
#: What this process knows of the seams of tiles in a folder, for each spacing of points along them:
#: 3.6 to 8 kB of 10, 20 and 100 million points in 4 to 88 tiles.
BYTES_PER_SEAM = 6e3
#: A point without a normal, while patches and their links tell its side.
BYTES_PER_UNTURNED_POINT = 170.0


def parse_limit(text: str) -> float:
    """Return the bytes that ``--max-memory`` names, as of `hpccomponent.units.parse_size`.

    UsageError where it is no size, or less than the program itself takes.

    Examples
    --------
    >>> parse_limit("2G") == 2 * 1024**3
    True
    """
    try:
        size = float(parse_size(text))
    except ValueError as error:
        raise UsageError(f"{text!r} is not a size", f"it {error}") from None
    if size < LEAST_MEMORY:
        raise UsageError(
            f"{text} is less memory than any job needs",
            f"give {LEAST_MEMORY / 2**20:.0f}M or more",
        )
    return size


def count_most_points(path: Path) -> int:
    """Return how many points a file holds at most: as it says, or judged by its size.

    None are in one that cannot be read: who reads it says what is wrong.
    """
    if not path.is_file():  # looking into a pipe would wait for ever
        return 0
    try:
        known = find_point_reader(path)
        counted = known.open(path).count if known.states_count else None
        return int(path.stat().st_size / known.least_bytes) if counted is None else counted
    except (OSError, HpcError):
        return 0


def may_lack_normals(path: Path) -> bool:
    """Tell whether a file holds no normals, by its head; False where that does not say so."""
    if not path.is_file():  # looking into a pipe would wait for ever
        return False
    try:
        known = find_point_reader(path)
        return known.states_count and not known.open(path).has_normals
    except (OSError, HpcError):
        return False


@dataclass(frozen=True, slots=True)
class Together:
    """What the processes of this machine take together that work on so many points.

    These lie in this process's memory if they are `here`, else in a folder. Each of the `workers`
    makes a tile, in a process of its own unless `in_process`.
    """

    points: int
    workers: int
    here: bool = False
    in_process: bool = False
    has_normals: bool = True

    def own(self, tile: int) -> float:
        """Return the bytes of this process and of loaders, without tiles of so many points."""
        if self.here:
            return BYTES_OF_PROGRAM + BYTES_PER_POINT * self.points
        # The sides of all tiles, each of a square of a surface.
        known = BYTES_PER_SEAM * 4.0 * self.points / float(np.sqrt(tile))
        if not self.has_normals:
            known = max(known, BYTES_PER_UNTURNED_POINT * self.points)
        return BYTES_OF_PROGRAM + known + (0.0 if self.in_process else BYTES_OF_LOADERS)

    def each(self, tile: int) -> float:
        """Return the bytes of a worker."""
        tile = min(tile, max(1, self.points // self.workers))
        return BYTES_PER_TILE_POINT * tile + (0.0 if self.in_process else BYTES_OF_PROGRAM)

    def whole(self, tile: int) -> float:
        """Return the bytes of all."""
        return self.own(tile) + self.workers * self.each(tile)

    def fits(self, limit: float) -> bool:
        """Tell whether there is a tile with which all fit into so many bytes."""
        return self.whole(self.fit(limit)) <= limit

    def fit(self, limit: float) -> int:
        """Return the largest tile with which all fit into so many bytes; else which takes least."""
        tiles: list[int] = np.geomspace(TILE_POINTS, LEAST_TILE, _SIZES).astype(int).tolist()
        fitting = [tile for tile in tiles if self.whole(tile) <= limit]
        return fitting[0] if fitting else min(tiles, key=self.whole)


def check_memory(method: MethodSettings, grid: int, cloud: ArrangedCloud) -> None:
    """Refuse, by a UsageError, a grid whose mesh cannot be computed in the memory there is.

    The message names a grid that fits. Of a cloud that is not in memory, tiles fit.
    """
    fitting = fit_memory(method, grid, cloud)
    if fitting >= grid:
        return
    needed, available = _estimate(method, grid, cloud), available_memory() or 0
    raise UsageError(
        f"{name_option('grid', grid)} needs about {needed / 2**30:.0f} GB of memory, "
        f"{available / 2**30:.1f} GB are available",
        f"choose {name_option('grid', fitting)} or smaller, or a machine with more memory",
    )


def fit_memory(method: MethodSettings, grid: int, cloud: ArrangedCloud) -> int:
    """Return the finest grid, up to one, whose mesh can be computed in the memory there is.

    It is `grid`, or in sixteens; a grid of 256 is tried anywhere, and any where tiles fit.
    """
    available = available_memory()
    if grid <= SMALL_GRID or available is None or not cloud.is_here:
        return grid
    needed = _estimate(method, grid, cloud)
    if needed <= available:
        return grid
    fitting = int(grid * (available / needed) ** (1 / method.memory_power)) // 16 * 16
    return max(SMALL_GRID, fitting)


def _estimate(method: MethodSettings, grid: int, cloud: ArrangedCloud) -> float:
    points = cloud.take_columns(cloud.keys)
    return method.estimate_memory(grid, len(points), count_surface_cells(grid, points))


def count_surface_cells(grid: int, cloud: PointCloud) -> float:
    """Estimate how many cells of a grid lie along the surface of points.

    Positions are finite, and not all at one place. The surface's area is that of the boxes that
    hold points, wide enough for several each, else they would miss what lies between these.
    """
    low, high = bound_points(cloud.positions)
    step = float((high - low).max()) / grid
    box = max(8.0 * step, 3.0 * estimate_spacing(cloud.positions))
    one_in = len(cloud) // SAMPLED_POINTS + 1
    _, boxes = kernels.count_boxes(cloud.positions, low, box, one_in)
    return float(one_in * boxes * (box / step) ** 2)
