"""Whether it pays to hand tiles out: a model of how long a job takes here, and on workers.

A pure function of measured numbers. Work is counted in units of `calibration.time_kernels`, so
that a machine that is twice as fast is expected to take half as long; how many units a point and
a cell of the grid take does not depend on the machine, and is what ``benchmarks/choice.py
--rates`` prints.

Who may import it: the job.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

__all__ = [
    "Choice",
    "Here",
    "Job",
    "Link",
    "There",
    "choose",
    "forecast_here",
    "forecast_there",
    "may_pay",
]

# What a point and a square of the grid's longest side take, in units of the calibration.
POINT_UNITS = 5.5e-4
LOAD_POINT_UNITS = 2.7e-4  # to read and clean it, which workers do where the folder is shared
SQUARE_UNITS = 2.5e-3
# Halos are computed twice, points are sorted again: the work of all tiles by that of the whole.
TILED = 1.2
# What the master does for tiles itself: points packed and sent, parts taken and welded.
SENT_POINT_UNITS = 1.5e-4
SENT_SQUARE_UNITS = 1.0e-3
WELD_SQUARE_UNITS = 1.0e-4
# Bytes that travel: points of tiles and their halos; parts of the mesh, or their summaries.
POINT_BYTES = 48.0
PART_BYTES = 250.0
SUMMARY_BYTES = 2.0
# A task is sent after another has been answered so many times one after the other.
TURNS = 8
# What threads of one process may take part in.
THREADED = 0.55
# So much faster than here it must be expected: forecasts err, though mostly both alike.
MARGIN = 1.1


@dataclass(frozen=True, slots=True)
class Job:
    """What there is to do.

    Parameters
    ----------
    points : int
    grid : int
        Cells along the longest side.
    is_cut : bool
        Whether it is done tile by tile in one process too, because memory asks for it.
    is_shared : bool
        Whether workers would read points, clean them and put parts away by themselves: then that
        is part of what could be handed out, beside fits and extraction.
    """

    points: int
    grid: int
    is_cut: bool = False
    is_shared: bool = False

    @property
    def units(self) -> float:
        """Work that could be handed out, uncut, in units."""
        of_point = POINT_UNITS + (LOAD_POINT_UNITS if self.is_shared else 0.0)
        return of_point * self.points + SQUARE_UNITS * float(self.grid) ** 2

    @property
    def master_units(self) -> float:
        """Work of the master for workers, in units."""
        squares = float(self.grid) ** 2
        if self.is_shared:
            return WELD_SQUARE_UNITS * squares
        return SENT_POINT_UNITS * self.points + SENT_SQUARE_UNITS * squares

    @property
    def travelling_bytes(self) -> float:
        """Bytes that must travel where workers do it."""
        squares = float(self.grid) ** 2
        if self.is_shared:
            return SUMMARY_BYTES * squares
        return POINT_BYTES * self.points + PART_BYTES * squares


@dataclass(frozen=True, slots=True)
class Here:
    """The machine of the master.

    Parameters
    ----------
    unit_s : float
        What a unit of work takes, in seconds.
    threads : int
        That one process would use.
    """

    unit_s: float
    threads: int = 1


@dataclass(frozen=True, slots=True)
class Link:
    """The way from the master to all workers together.

    Parameters
    ----------
    latency_s : float
        Of a task that takes nothing, there and back.
    bytes_per_s : float
    """

    latency_s: float = 0.0
    bytes_per_s: float = float("inf")


@dataclass(frozen=True, slots=True)
class There:
    """The workers.

    Parameters
    ----------
    unit_s : tuple of float
        What a unit of work takes on each, in seconds.
    link : Link
    ready_s : float
        How long it will be until they are there.
    """

    unit_s: tuple[float, ...]
    link: Link = Link()
    ready_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Choice:
    """Where a job runs, and why.

    Parameters
    ----------
    backend : str
        See `hpcapp.backends.selection`.
    workers : int
        How many do the work.
    reason : str
        One sentence.
    local_s, distributed_s : float or None
        What fits and extraction were expected to take, in seconds, on this machine alone and
        with workers; None where nothing was to be chosen.
    bandwidth_mb_s : float or None
        Of the link to the workers, where it was measured, in MB/s.
    workers_asked : int or None
        How many the user allowed.
    """

    backend: str
    workers: int
    reason: str
    local_s: float | None = None
    distributed_s: float | None = None
    bandwidth_mb_s: float | None = None
    workers_asked: int | None = None

    def to_json(self) -> dict[str, Any]:
        """Return it for the report, with seconds to the millisecond."""
        found = asdict(self)
        for name in ("local_s", "distributed_s", "bandwidth_mb_s"):
            if found[name] is not None:
                found[name] = round(found[name], 3)
        return found


def forecast_here(job: Job, here: Here) -> float:
    """Return how long one process is expected to take, in seconds."""
    units = job.units * (TILED if job.is_cut else 1.0)
    return units * here.unit_s * (1.0 - THREADED + THREADED / here.threads)


def forecast_there(job: Job, here: Here, there: There) -> float:
    """Return how long the master is expected to take with its workers, in seconds.

    Notes
    -----
    What the master does and what travels is taken for work that nothing hides, which it is at
    the worst. Without workers it is infinite.
    """
    speed = sum(1.0 / unit_s for unit_s in there.unit_s)
    if not speed:
        return float("inf")
    link = there.link
    sent_s = job.travelling_bytes / link.bytes_per_s + TURNS * link.latency_s
    return there.ready_s + job.master_units * here.unit_s + TILED * job.units / speed + sent_s


def may_pay(job: Job, threads: int, workers: int, ready_units: float) -> bool:
    """Tell whether workers on this machine can pay at all, before anything is measured.

    Parameters
    ----------
    job : Job
    threads : int
        That one process would use.
    workers : int
        As fast as this process, and with nothing on their way.
    ready_units : float
        What their start takes, in units of work.
    """
    here, there = Here(1.0, threads), There((1.0,) * workers, ready_s=ready_units)
    return MARGIN * forecast_there(job, here, there) <= forecast_here(job, here)


def choose(job: Job, here: Here, there: There, local: Choice, distributed: Choice) -> Choice:
    """Choose between this machine and workers.

    Parameters
    ----------
    job : Job
    here : Here
    there : There
        The workers that there are, or would be.
    local, distributed : Choice
        Backend and number of workers of both; the reason of `distributed` says in a few words
        what there would be, as "2 workers here".

    Returns
    -------
    Choice
        With both forecasts; `distributed` only where it is expected to be faster, by `MARGIN`.
    """
    local_s, distributed_s = forecast_here(job, here), forecast_there(job, here, there)
    megabytes = job.travelling_bytes / 1e6
    way = f"{megabytes:.3g} MB on their way at {there.link.bytes_per_s / 1e6:.3g} MB/s"
    ready = f", {there.ready_s:.2g} s until they are there" if there.ready_s else ""
    pays = MARGIN * distributed_s <= local_s
    chosen = distributed if pays else local
    reason = (
        f"{job.points} points at grid {job.grid} should take {local_s:.2g} s in this process and "
        f"{distributed_s:.2g} s with {distributed.reason} ({way}{ready}): "
        + ("that pays" if pays else "that does not pay")
    )
    return replace(chosen, reason=reason, local_s=local_s, distributed_s=distributed_s)
