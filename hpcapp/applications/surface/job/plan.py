"""What a job will do, decided before its points are read: where they lie, who works, what it takes.

::

    sizes of files, settings ──> plan_job ──> JobPlan ──┬─> where points and tiles lie (`storage`)
                                                        ├─> whether to wait for workers (`cli.run`)
                                                        └─> what ``--plan`` prints
"""

from __future__ import annotations

import shutil
import tempfile
from enum import Enum
from typing import Any

from hpcapp.applications.surface.cloud.arranged import ArrangedCloud
from hpcapp.applications.surface.job.backend_choice import (
    SQUARE,
    BackendChoice,
    Job,
    choose_backend,
)
from hpcapp.applications.surface.job.settings import (
    JobSettings,
    Settings,
    choose_steps,
    name_backend,
)
from hpcapp.applications.surface.methods.method import (
    BYTES_OF_PROGRAM,
    BYTES_PER_POINT,
    TILE_POINTS,
    MethodSettings,
)
from hpcapp.applications.surface.resolution.asked import guess_grid
from hpcapp.applications.surface.resolution.memory import (
    Together,
    count_most_points,
    may_lack_normals,
)
from hpcapp.backends import BACKENDS, IN_PROCESS
from hpcapp.backends.selection import Backend
from hpcapp.io import open_points
from hpccomponent.cli.option_names import name_option
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError
from hpccomponent.limits import available_cores, available_memory

FOLDER_FROM_POINTS = 200_000
"""With fewer, what is saved by workers that read for themselves is less than what files cost."""
_BYTES_ON_DISK = 200  # a point: two copies of it, and finished tiles
_ELSEWHERE = Together(TILE_POINTS, 1)  # a worker that has a machine to itself
_CELLS_OF_A_POINT = 0.5
"""Of the surface, where the grid is chosen: jobs of 20 thousand to 2.5 million points took .73 to
1.1 of the memory that it tells of (a knot, a bunny; in one process)."""


class Place(Enum):
    """Where a job has its points."""

    MEMORY = "in the memory of this process"
    SHARED = "in a folder, where workers read them"
    DISK = "in a folder, as memory does not hold them"


@dataclass(frozen=True, slots=True)
class JobPlan:
    """What a job will do at most, and about what it takes.

    `tile` is how many points a tile may have; `memory`, `worker_memory` and `disk` are in bytes,
    of this process, of each worker in another, and of the temporary folder. `available` is the
    memory that may be had here, None where nothing says so. Workers are processes of this machine
    if `works_here`.
    """

    job: Job
    place: Place
    choice: BackendChoice
    tile: int | None
    memory: float
    worker_memory: float
    disk: float
    available: float | None
    works_here: bool = True

    @property
    def memory_here(self) -> float:
        """The bytes of all processes on this machine."""
        return self.memory + (self.choice.workers * self.worker_memory if self.works_here else 0.0)

    @property
    def tiles(self) -> int:
        """Return how many tiles there are at least."""
        workers = 1 if self.choice.backend in IN_PROCESS else self.choice.workers
        return max(workers, -(-self.job.points // self.tile) if self.tile else 1)

    def say_excess(self) -> str | None:
        """Say that the job takes more than is allowed; None where it does not, or nothing is."""
        if self.tile is None or self.available is None or self.memory_here <= self.available:
            return None
        return (
            f"the job takes about {_say(self.memory_here)} of memory, where "
            f"{name_option('max_memory')} allows {_say(self.available)}"
        )

    def to_json(self) -> dict[str, Any]:
        """Return what ``--plan --json`` prints."""
        return {
            "points": self.job.points,
            "grid": self.job.grid,
            "is_grid_chosen": self.job.is_chosen,
            "points_lie": self.place.value,
            "choice": self.choice.to_json(),
            "tiles": self.tiles,
            "points_of_a_tile": self.tile,
            "memory": int(self.memory_here),
            "memory_of_a_worker": int(self.worker_memory),
            "disk": int(self.disk),
            "memory_available": None if self.available is None else int(self.available),
        }

    def describe(self) -> list[tuple[str, str]]:
        """Return the same as rows of two words each."""
        grid = f"{self.job.grid}, as asked"
        if not self.job.is_chosen:
            grid = f"at most {self.job.grid}, chosen when the points are measured"
        tiles = "one" if self.tiles == 1 else f"{self.tiles} or more"
        if self.tile:
            tiles += f", of at most {self.tile:,} points"
        available = "" if self.available is None else f" of {_say(self.available)} available"
        rows = [
            ("points", f"at most {self.job.points:,}, {self.place.value}"),
            ("grid", grid),
            ("backend", f"{self.choice.backend}, workers {self.choice.workers}: "
                        f"{self.choice.reason}"),
            ("tiles", tiles),
            ("memory", f"about {_say(self.memory_here)}{available}"),
        ]  # fmt: skip
        if self.worker_memory:
            rows.append(("each worker", f"about {_say(self.worker_memory)}"))
        if self.disk:
            rows.append(("disk", f"up to {_say(self.disk)} in the temporary folder"))
        return rows


def _say(size: float) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.0f} MB"


def plan_job(
    settings: JobSettings, points: int | None = None, *, is_opened: bool = False
) -> JobPlan:
    """Plan a job, of whose file only the size and the head are looked at.

    It has so many `points` at most; by default as many as the file may hold. `is_opened` tells that
    the user has opened an executor, whose workers may read what lies in a folder. Raise InputError
    where the inventory of a cluster cannot be read, and UsageError where a job is to go on from
    nowhere.
    """
    if settings.resume and settings.temp_dir is None:
        raise UsageError("--resume goes on from what lies in --temp-dir", "give that too")
    job = guess_job(settings, points)
    choice = choose_backend(settings, job)
    limit = settings.max_memory
    available = available_memory() if limit is None else limit
    place = Place.MEMORY
    if not settings.method.needs_whole_cloud:
        if not fits_memory(job.points, available):
            place = Place.DISK
        elif is_opened or choice.backend not in IN_PROCESS:
            place = Place.SHARED if _may_pay_in_folder(settings, job.points) else place
    is_local = works_here(settings)
    together = Together(
        job.points, choice.workers, place is Place.MEMORY, choice.backend in IN_PROCESS,
        settings.normals != "estimate" and not may_lack_normals(settings.points),
    )  # fmt: skip
    tile = None if limit is None else (together if is_local else _ELSEWHERE).fit(limit)
    memory, worker = _estimate_memory(settings.method, job, together, tile)
    disk = 0.0 if place is Place.MEMORY else _BYTES_ON_DISK * float(job.points)
    return JobPlan(job, place, choice, tile, memory, worker, disk, available, is_local)


def _estimate_memory(
    method: MethodSettings, job: Job, together: Together, tile: int | None
) -> tuple[float, float]:
    """Return the bytes of this process, and of each worker in another."""
    if together.in_process and together.here and tile is None:
        cells = SQUARE * float(job.grid) ** 2 if job.is_chosen else _CELLS_OF_A_POINT * job.points
        return method.estimate_memory(job.grid, job.points, cells), 0.0
    tile = tile or TILE_POINTS
    if together.in_process:
        return together.whole(tile), 0.0
    return together.own(tile), together.each(tile)


def guess_job(settings: JobSettings, points: int | None = None) -> Job:
    """Return what can be known of a job before its points are read: as much as it may be."""
    points = count_most_points(settings.points) if points is None else points
    is_chosen = settings.depth is not None or settings.grid is not None
    return Job(points, guess_grid(settings, points), is_read=False, is_chosen=is_chosen)


def fits_memory(points: int, available: float | None) -> bool:
    """Tell whether so many points fit into so many bytes; None where nothing says how many."""
    return available is None or BYTES_OF_PROGRAM + BYTES_PER_POINT * points <= available


def _may_pay_in_folder(settings: JobSettings, points: int) -> bool:
    """Tell whether points that fit into memory should lie where other processes read them.

    That is where workers may be processes that will see the folder: those of this machine see any,
    others one that was named, and where they can read the input from the middle.
    """
    name, place = name_backend(settings), settings.room
    is_here = works_here(settings)
    if name is None and is_here:
        name = "zmq" if (settings.workers or available_cores()) > 1 else "serial"
    if points < FOLDER_FROM_POINTS or name in IN_PROCESS or choose_steps(settings):
        return False
    if place is None or "://" in place:
        free = shutil.disk_usage(tempfile.gettempdir()).free
        if not is_here or free < _BYTES_ON_DISK * points:
            return False
    if len(settings.files) > 1:  # they are made one PLY
        return True
    is_ply = settings.points.suffix.lower() == ".ply"
    return is_ply and open_points(settings.points).isotropic().records is not None


def works_here(settings: Settings) -> bool:
    """Tell whether all workers are of this machine."""
    return settings.cluster is None and (name_backend(settings) or "zmq") in BACKENDS


def choose_tile(settings: Settings, backend: Backend, cloud: ArrangedCloud) -> int | None:
    """Return how many points of a tile fit into the memory that may be had; None without a limit.

    It is of all processes of this machine; a worker of another one has that to itself.
    """
    if settings.max_memory is None:
        return None
    workforce = backend.workforce
    together = Together(len(cloud), workforce.workers, cloud.is_here, workforce.in_process)
    is_local = workforce.in_process or backend.is_here
    return (together if is_local else _ELSEWHERE).fit(settings.max_memory)
