"""The paper's Figures 7 and 8 on this machine: python benchmarks/paper_figures.py FOLDER [CLOUD].

Time and speed-up of the paper's method against the number of workers. 0 workers: the master fits
by itself, without any engine; 1 and more: real loaders, components and workers on loopback, as
many patches to each. Rounds go through all numbers of workers, every other one backwards, so that
whatever else the machine does falls on all alike. Every run opens its own workers:

::

    open workers ─> fit once (cold) ─> read, partition, fit, extract, check, write ─> close
       start_s       first_fit_s        job_s, of which fit_s

FOLDER receives ``paper_figures.json`` and, where matplotlib is installed (the ``bench`` extra),
``figure_7_time.png`` and ``figure_8_speedup.png``. Without CLOUD it is ``bunny_263256.ply`` of
the folder that HPCAPP_DATA names, else a simulated scan of as many points.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

from clouds import SimulatedCloud

from hpcapp.applications.reproduce.scaling import Spread, limit_of_fits
from hpcapp.applications.simulate.scanner import ScanSettings
from hpcapp.applications.surface.paper.method import PaperMethod
from hpcapp.applications.surface.pipeline import reconstruct
from hpcapp.backends.selection import Backend, open_executor
from hpcapp.io import drop_unusable, read_points
from hpcapp.progress import SilentProgress, StageClock
from hpccomponent.errors import UsageError
from hpccomponent.limits import available_cores
from hpccomponent.surface.cloud.arranged import MemoryCloud

__all__ = [
    "Run",
    "Summary",
    "find_cloud",
    "measure",
    "plot",
    "print_table",
    "summarise",
]

PAPER_CLOUD = "bunny_263256.ply"
PAPER_POINTS = 263_256
PAPER_PATCHES = 240
MOST_WORKERS = 4


@dataclass(frozen=True, slots=True)
class Run:
    """One job with some number of workers.

    Parameters
    ----------
    workers : int
        0: the master fits by itself.
    round : int
    start_s : float
        Until all workers have registered, in seconds; 0 without workers.
    first_fit_s : float
        The first fit of these workers: they still load the code. Seconds.
    fit_s, job_s : float
        The stage ``fit``, and everything from reading to writing, with warm workers; seconds.
    bytes_sent : int
        By the master for one fit.
    """

    workers: int
    round: int
    start_s: float
    first_fit_s: float
    fit_s: float
    job_s: float
    bytes_sent: int


@dataclass(frozen=True, slots=True)
class Summary:
    """All runs with one number of workers.

    Parameters
    ----------
    workers : int
    start_s, first_fit_s, fit_s, job_s : Spread
        In seconds; see `Run`.
    fit_speedup, job_speedup : Spread
        Time without workers by time with them, within each round; dimensionless.
    bytes_sent : int
        See `Run`.
    """

    workers: int
    start_s: Spread
    first_fit_s: Spread
    fit_s: Spread
    job_s: Spread
    fit_speedup: Spread
    job_speedup: Spread
    bytes_sent: int


def find_cloud(given: Path | None, folder: Path) -> Path:
    """Return the cloud to measure on.

    Parameters
    ----------
    given : Path or None
        What the user named.
    folder : Path
        Where a simulated scan is kept.

    Returns
    -------
    Path
        The given file, the paper's where HPCAPP_DATA has it, or a scan of as many points.

    Raises
    ------
    UsageError
        The given file is not there.
    """
    if given is not None:
        if not given.exists():
            raise UsageError(f"{given} is not there", "name a point cloud, or none")
        return given
    ours = Path(os.environ.get("HPCAPP_DATA", folder)) / PAPER_CLOUD
    if ours.exists():
        return ours
    scan = ScanSettings(points=PAPER_POINTS, seed=7)
    return SimulatedCloud(f"knot-{PAPER_POINTS}", "clean", "knot", scan).place(folder)


def measure(
    cloud: Path,
    rounds: int,
    most_workers: int = MOST_WORKERS,
    method: PaperMethod | None = None,
    backend: str = "zmq",
) -> Iterator[Run]:
    """Yield the runs of all rounds as they finish.

    Parameters
    ----------
    cloud : Path
        An oriented point cloud.
    rounds : int
        How many runs each number of workers gets.
    most_workers : int
        The numbers are 0 to this.
    method : PaperMethod, optional
        With the paper's 240 patches by default.
    backend : str
        What stands behind 1 and more workers.

    Yields
    ------
    Run
    """
    method = method or PaperMethod(patches=PAPER_PATCHES)
    points = _read(cloud)
    for number in range(rounds):
        counts = list(range(most_workers + 1))
        for workers in counts if number % 2 == 0 else reversed(counts):
            name, count = (backend, workers) if workers else ("serial", None)
            start = perf_counter()
            with open_executor(name, workers=count, policy="equal") as opened:
                start_s = perf_counter() - start if workers else 0.0
                first_fit_s = _time_first_fit(points, method, opened)
                sent = opened.traffic().bytes_sent
                fit_s, job_s = _time_job(cloud, method, opened)
            yield Run(workers, number, start_s, first_fit_s, fit_s, job_s, sent)


def _read(cloud: Path) -> MemoryCloud:
    points, _ = drop_unusable(read_points(cloud), str(cloud))
    return MemoryCloud.as_they_are(points)


def _time_first_fit(points: MemoryCloud, method: PaperMethod, opened: Backend) -> float:
    """Fit once, so that the workers have loaded the code; return the seconds it took."""
    partition = method.partition(points, opened.workforce)
    start = perf_counter()
    method.fit(partition, opened.workforce, lambda _done, _total: None)
    return perf_counter() - start


def _time_job(cloud: Path, method: PaperMethod, opened: Backend) -> tuple[float, float]:
    """Run the job from file to file; return the seconds of the fit and of the whole."""
    clock = StageClock(SilentProgress())
    with TemporaryDirectory() as folder:
        start = perf_counter()
        result = reconstruct(_read(cloud), method, opened.workforce, clock)
        result.surface.write(Path(folder) / "mesh.ply", opened.workforce)
        return clock.seconds["fit"], perf_counter() - start


def summarise(runs: list[Run]) -> list[Summary]:
    """Return what the runs of each number of workers say.

    Parameters
    ----------
    runs : list of Run
        With a run without workers in every round: speed-ups compare within a round, so that
        what slows a whole round cancels.

    Returns
    -------
    list of Summary
        By number of workers.

    Raises
    ------
    UsageError
        A round has no run without workers.
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
            workers=own[0].workers,
            start_s=Spread.of([run.start_s for run in own]),
            first_fit_s=Spread.of([run.first_fit_s for run in own]),
            fit_s=Spread.of([run.fit_s for run in own]),
            job_s=Spread.of([run.job_s for run in own]),
            fit_speedup=Spread.of([alone[run.round].fit_s / run.fit_s for run in own]),
            job_speedup=Spread.of([alone[run.round].job_s / run.job_s for run in own]),
            bytes_sent=own[0].bytes_sent,
        )
        for own in by_workers
    ]


def print_table(summaries: list[Summary]) -> None:
    """Print one line of a Markdown table for each number of workers."""
    print("| workers | start s | first fit ms | fit ms | job s | speed-up of the fit "
          "| speed-up of the job | what free fits could bring | MB sent |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|")
    share = _share_of_fits(summaries)
    for line in summaries:
        cells = (
            "0 (master)" if line.workers == 0 else str(line.workers),
            "-" if line.workers == 0 else _cell(line.start_s, 1.0, 2),
            _cell(line.first_fit_s, 1e3, 0),
            _cell(line.fit_s, 1e3, 0),
            _cell(line.job_s, 1.0, 2),
            _cell(line.fit_speedup, 1.0, 2),
            _cell(line.job_speedup, 1.0, 2),
            f"{limit_of_fits(share, line.workers):.2f}",
            f"{line.bytes_sent / 1e6:.1f}",
        )
        print(f"| {' | '.join(cells)} |")
    print(f"\nthe fits are {100 * share:.1f} % of the job without workers")


def _share_of_fits(summaries: list[Summary]) -> float:
    """Return the fits' share of the job without workers, by the medians."""
    return summaries[0].fit_s.median / summaries[0].job_s.median


def _cell(spread: Spread, scale: float, digits: int) -> str:
    """Return ``median (low to high)``."""
    middle, low, high = (
        f"{scale * value:.{digits}f}" for value in (spread.median, spread.low, spread.high)
    )
    return f"{middle} ({low} to {high})"


def plot(summaries: list[Summary], cores: int, folder: Path) -> None:
    """Draw time (the paper's Figure 7) and speed-up (Figure 8) against the number of workers.

    Parameters
    ----------
    summaries : list of Summary
        By number of workers, from 0.
    cores : int
        What the workers and the master share, for the caption.
    folder : Path
        Receives ``figure_7_time.png`` and ``figure_8_speedup.png``.
    """
    from matplotlib.figure import Figure

    workers = [line.workers for line in summaries]
    share = _share_of_fits(summaries)
    seven, eight = (Figure(figsize=(5.5, 3.8), dpi=100, layout="constrained") for _ in range(2))
    times, ratios = seven.subplots(), eight.subplots()
    _draw(times, workers, [line.job_s for line in summaries], "whole job", "o")
    _draw(times, workers, [line.fit_s for line in summaries], "fits alone", "s")
    times.set(yscale="log", ylabel="time, s", title="Time (the paper's Figure 7)")
    _draw(ratios, workers, [line.job_speedup for line in summaries], "whole job", "o")
    _draw(ratios, workers, [line.fit_speedup for line in summaries], "fits alone", "s")
    limit = [limit_of_fits(share, count) for count in workers]
    ratios.plot(workers, limit, "--", color="grey", label="job, if handing out fits were free")
    ratios.set(ylim=(0, None), ylabel="speed-up over the master alone")
    ratios.set_title("Speed-up (the paper's Figure 8)")
    names = ("figure_7_time.png", "figure_8_speedup.png")
    for figure, axes, name in zip((seven, eight), (times, ratios), names, strict=True):
        axes.set(xticks=workers, xlabel=f"workers (0: the master fits; {cores} cores in all)")
        axes.grid(visible=True, alpha=0.3)
        axes.legend()
        figure.savefig(folder / name)


def _draw(axes: Any, workers: list[int], values: list[Spread], label: str, marker: str) -> None:
    """Draw medians, with bars from the smallest to the largest value."""
    below = [value.median - value.low for value in values]
    above = [value.high - value.median for value in values]
    middle = [value.median for value in values]
    axes.errorbar(workers, middle, yerr=[below, above], marker=marker, capsize=3, label=label)


def main() -> None:
    """Measure, print the table, and write results and figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="receives results and figures")
    parser.add_argument("cloud", type=Path, nargs="?", help="the paper's bunny, or a scan")
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--workers", type=int, default=MOST_WORKERS, help="the most")
    parser.add_argument("--patches", type=int, default=PAPER_PATCHES)
    parser.add_argument("--grid", type=int, default=64, help="cells along the longest side")
    args = parser.parse_args()
    args.folder.mkdir(parents=True, exist_ok=True)
    cloud = find_cloud(args.cloud, args.folder)
    method = PaperMethod(patches=args.patches, grid=args.grid)
    runs = []
    for run in measure(cloud, args.rounds, args.workers, method):
        runs.append(run)
        print(f"round {run.round} workers {run.workers}: fit {run.fit_s:.3f} s, "
              f"job {run.job_s:.2f} s", file=sys.stderr)  # fmt: skip
    summaries = summarise(runs)
    results = {
        "cloud": cloud.name,
        "patches": args.patches,
        "grid": args.grid,
        "cores": available_cores(),
        "summaries": [asdict(line) for line in summaries],
        "runs": [asdict(run) for run in runs],
    }
    text = json.dumps(results, indent=2)
    (args.folder / "paper_figures.json").write_text(text + "\n", encoding="utf-8")
    print_table(summaries)
    try:
        plot(summaries, available_cores(), args.folder)
    except ImportError:
        print("no figures: matplotlib is not installed (the bench extra)")


if __name__ == "__main__":
    main()
