"""Whether a job fits into memory, found out before it starts: the system kills without a word."""

from __future__ import annotations

from pathlib import Path

from hpcapp import kernels
from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.cloud.spacing import estimate_spacing
from hpcapp.applications.surface.methods.method import BYTES_OF_PROGRAM, TILE_POINTS, MethodSettings
from hpcapp.geometry.bounds import bound_points
from hpcapp.geometry.points import PointCloud
from hpcapp.io.registry import find_point_reader
from hpccomponent.cli.option_names import name_option
from hpccomponent.errors import HpcError, UsageError
from hpccomponent.limits import available_memory
from hpccomponent.units import parse_size

LEAST_MEMORY = 256 * 2.0**20
#: The boxes along the surface are counted on a sample of them, with about so many points.
SAMPLED_POINTS = 1_000_000
#: Below this a job fits on any machine that runs it.
SMALL_GRID = 256


#: What a tile takes of the process that makes its mesh, or cuts it open, a point: 200 of a closed
#: surface, 540 of a terrain without normals.
BYTES_PER_TILE_POINT = 600.0
LEAST_TILE = 50_000
#: What waits beside local workers: their loaders and components.
BYTES_OF_LOADERS = 1e8
#: What this process knows of a cloud in a folder, a point: blocks, coarse cells and seams; and of
#: one without normals, patches and their links, while their sides are told.
BYTES_PER_KNOWN_POINT, BYTES_PER_UNTURNED_POINT = 20.0, 170.0


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
    try:
        known = find_point_reader(path)
        return known.states_count and not known.open(path).has_normals
    except (OSError, HpcError):
        return False


def estimate_known(points: int, *, has_normals: bool = True) -> float:
    """Return the bytes of a process that works with others on points in a folder, at most."""
    each = BYTES_PER_KNOWN_POINT if has_normals else BYTES_PER_UNTURNED_POINT
    return BYTES_OF_PROGRAM + BYTES_OF_LOADERS + each * points


def fitting_workers(limit: float, own: float) -> int:
    """Return how many processes with a least tile fit beside this one, which takes `own` bytes."""
    each = BYTES_OF_PROGRAM + BYTES_PER_TILE_POINT * LEAST_TILE
    return max(0, int((limit - own) / each))


def fitting_tile(limit: float, own: float, workers: int, *, in_process: bool) -> int:
    """Return how many points a tile may have, from `LEAST_TILE` to `TILE_POINTS`.

    `limit` is that of all processes in bytes, of which this one takes its `own` besides its tiles;
    each of the `workers` makes one, in a process of its own unless `in_process`.
    """
    others = 0.0 if in_process else BYTES_OF_PROGRAM * workers
    points = (limit - own - others) / workers / BYTES_PER_TILE_POINT
    return int(min(max(points, LEAST_TILE), TILE_POINTS))


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
