"""Figures 7 and 8: time and speed-up against the number of workers.

0 workers: the master does all by itself, without any engine; 1 and more: real loaders, components
and workers on loopback. Rounds go through all numbers of workers, every other one backwards, so
that whatever else the machine does falls on all alike:

::

    open workers ─> each method once (cold) ─> each method: read, cut, fit, extract, write ─> close
      start_s         first_fit_s               job_s, of which fit_s

Two ways of handing out: the paper's, fits of patches, and the default method's, whole tiles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from statistics import median
from time import perf_counter

from hpcapp.applications.surface.hierarchical.settings import Hierarchical
from hpcapp.applications.surface.methods.method import MethodSettings, Resources
from hpcapp.applications.surface.paper.settings import Paper
from hpcapp.applications.surface.pipeline import make_surface
from hpcapp.backends.selection import Backend, open_executor
from hpcapp.io import drop_unusable, read_points
from hpcapp.lab.reproduce.subject import arrange_for
from hpcapp.progress import Progress, StageClock
from hpccomponent.dataclass import dataclass
from hpccomponent.errors import UsageError

#: Patches of the paper's Figures 7 and 8.
PAPER_PATCHES = 240
#: What is handed out, by the name that tables and plots have for it.
WAYS: dict[str, MethodSettings] = {
    "fits": Paper(patches=PAPER_PATCHES),
    "tiles": Hierarchical(),
}


@dataclass(frozen=True, slots=True)
class ScalingRun:
    """One job with some number of workers; times are in seconds.

    Parameters
    ----------
    way : str
        One of `WAYS`.
    workers : int
        0: the master does all by itself.
    start_s : float
        Until all workers have registered; 0 without workers.
    first_fit_s : float
        The stage ``fit`` of the first job of these workers: they still load the code.
    fit_s, job_s : float
        The stage ``fit``, and everything from reading to writing, with warm workers.
    bytes_sent : int
        By the master for one job.
    """

    way: str
    workers: int
    round: int
    start_s: float
    first_fit_s: float
    fit_s: float
    job_s: float
    bytes_sent: int


@dataclass(frozen=True, slots=True)
class Spread:
    """The median of some values, the smallest and the largest."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Return the spread of `values`, at least one.

        Examples
        --------
        >>> Spread.of([3.0, 1.0, 2.0])
        Spread(median=2.0, low=1.0, high=3.0)
        """
        return cls(median(values), min(values), max(values))

    def cell(self, scale: float = 1.0, digits: int = 2) -> str:
        """Return ``median (smallest to largest)``, of the values times `scale`.

        Examples
        --------
        >>> Spread(0.095, 0.064, 0.113).cell(1e3, 0)
        '95 (64 to 113)'
        """
        middle, low, high = (
            f"{scale * value:.{digits}f}" for value in (self.median, self.low, self.high)
        )
        return f"{middle} ({low} to {high})"


@dataclass(frozen=True, slots=True)
class Summary:
    """All runs of one way with one number of workers; times are those of `ScalingRun`.

    Speed-ups are the time of the master alone by that with workers, within each round.
    """

    workers: int
    start_s: Spread
    first_fit_s: Spread
    fit_s: Spread
    job_s: Spread
    fit_speedup: Spread
    job_speedup: Spread
    bytes_sent: int


def measure(
    cloud: Path,
    grid: int,
    rounds: int,
    most_workers: int,
    backend: str = "zmq",
    done: Callable[[int, int], object] = lambda _done, _total: None,
) -> Iterator[ScalingRun]:
    """Yield the runs of an oriented point cloud, of all rounds, as they finish.

    Each way runs once a round with each number of workers, 0 to the most; the grid is of so many
    cells along the longest side. `done` is told (n, total) whenever n of the total of openings of
    workers are measured.
    """
    total = rounds * (most_workers + 1)
    for number in range(rounds):
        counts = list(range(most_workers + 1))
        for i, workers in enumerate(counts if number % 2 == 0 else reversed(counts)):
            name, count = (backend, workers) if workers else ("serial", None)
            begin = perf_counter()
            with open_executor(name, workers=count, policy="equal") as opened:
                start_s = perf_counter() - begin if workers else 0.0
                first = {way: _run(cloud, settings, grid, opened) for way, settings in WAYS.items()}
                for way, settings in WAYS.items():
                    fit_s, job_s, sent = _run(cloud, settings, grid, opened)
                    yield ScalingRun(
                        way, workers, number, start_s, first[way][0], fit_s, job_s, sent
                    )
            done(number * len(counts) + i + 1, total)


def _run(
    cloud: Path, settings: MethodSettings, grid: int, opened: Backend
) -> tuple[float, float, int]:
    """Run a job from file to file; return the seconds of the fit, of the whole, and the bytes."""
    sent = opened.traffic().bytes_sent
    clock = StageClock(Progress())
    start = perf_counter()
    points, _ = drop_unusable(read_points(cloud), str(cloud))
    method = settings.open(grid, Resources())
    result = make_surface(arrange_for(settings, points), method, opened.workforce, clock)
    result.surface.write(cloud.with_name("mesh.ply"), opened.workforce)
    seconds = perf_counter() - start
    return clock.seconds["fit"], seconds, opened.traffic().bytes_sent - sent


def summarise(runs: Sequence[ScalingRun]) -> list[Summary]:
    """Return what the runs of one way say, by number of workers.

    Every round has a run without workers: speed-ups compare within a round, so that what slows a
    whole round cancels.
    """
    alone = {run.round: run for run in runs if run.workers == 0}
    if not {run.round for run in runs} <= set(alone):
        raise UsageError("a round has no run without workers", "measure 0 workers too")
    by_workers = [
        [run for run in runs if run.workers == workers]
        for workers in sorted({run.workers for run in runs})
    ]
    return [
        Summary(
            workers=same[0].workers,
            start_s=Spread.of([run.start_s for run in same]),
            first_fit_s=Spread.of([run.first_fit_s for run in same]),
            fit_s=Spread.of([run.fit_s for run in same]),
            job_s=Spread.of([run.job_s for run in same]),
            fit_speedup=Spread.of([alone[run.round].fit_s / run.fit_s for run in same]),
            job_speedup=Spread.of([alone[run.round].job_s / run.job_s for run in same]),
            bytes_sent=same[0].bytes_sent,
        )
        for same in by_workers
    ]


def limit_of_fits(share: float, workers: int) -> float:
    """Return the speed-up of a job whose fits cost nothing to hand out (Amdahl's law).

    The share is that of the fits in the time without workers, 0 to 1; 0 means the master alone.

    Examples
    --------
    >>> limit_of_fits(0.05, 0)
    1.0
    >>> round(limit_of_fits(0.05, 4), 3)
    1.039
    """
    return 1.0 / (1.0 - share + share / max(workers, 1))
