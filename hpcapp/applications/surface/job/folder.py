"""Whether a cloud goes through a folder, who works there, and on how much at once."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from hpcapp.applications.surface.cloud.point_workers import PointWorkers
from hpcapp.applications.surface.job.settings import (
    JobSettings,
    Settings,
    choose_steps,
    name_backend,
)
from hpcapp.applications.surface.resolution.memory import count_most_points, fitting_tile
from hpcapp.backends import BACKENDS, IN_PROCESS
from hpcapp.backends.selection import Backend
from hpcapp.io import open_points
from hpccomponent.files.private_files import make_private_folder
from hpccomponent.limits import available_cores

FOLDER_FROM_POINTS = 200_000
"""With fewer, what is saved by workers that read for themselves is less than what files cost."""
_BYTES_PER_POINT = 200  # of room in the folder: two copies of the points, and finished tiles


def may_pay_in_folder(settings: JobSettings) -> bool:
    """Tell whether points that fit into memory should lie where other processes read them.

    That is where workers may be processes that will see the folder: those of this machine see any,
    others one that was named, and where they can read the input from the middle.
    """
    points = count_most_points(settings.points)
    name, place = name_backend(settings), settings.temp_dir
    is_here = settings.cluster is None and (name or "zmq") in BACKENDS
    if name is None and is_here:
        name = "zmq" if (settings.workers or available_cores()) > 1 else "serial"
    if points < FOLDER_FROM_POINTS or name in IN_PROCESS or choose_steps(settings):
        return False
    if place is None or "://" in place:
        free = shutil.disk_usage(tempfile.gettempdir()).free
        if not is_here or free < _BYTES_PER_POINT * points:
            return False
    is_ply = settings.points.suffix.lower() == ".ply"
    return is_ply and open_points(settings.points).isotropic().records is not None


def choose_tile(settings: Settings, backend: Backend) -> int | None:
    """Return how many points of a tile fit the memory of a process; None if it has no limit."""
    if settings.max_memory is None:
        return None
    workforce = backend.workforce
    return fitting_tile(settings.max_memory, workforce.workers if workforce.in_process else 1)


def all_see_folder(folder: Path, backend: Backend) -> bool:
    """Find out whether every worker sees a folder, and what this process writes into it."""
    if backend.is_here:
        return True
    with tempfile.NamedTemporaryFile(dir=folder) as sign:
        return backend.workforce.sees(Path(sign.name))


def find_point_workers(path: Path, folder: Path, backend: Backend, points: int) -> PointWorkers:
    """Find out who can go through a cloud in a folder.

    `path` is that of the input. The folder need not exist, the one around it is made; a task may
    hold about `points` at most.
    """
    if backend.is_here:
        return PointWorkers(backend.workforce, True, points)
    make_private_folder(folder.parent)
    with tempfile.NamedTemporaryFile(dir=folder.parent) as sign:
        sees_both = backend.workforce.sees(Path(sign.name), path)
    sees = sees_both or all_see_folder(folder.parent, backend)
    return PointWorkers(backend.workforce, sees, points, sees_both)
