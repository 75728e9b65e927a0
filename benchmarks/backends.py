"""Is ``--backend auto`` ever slower than this machine alone? backends.py [--sizes N ...].

`hpcapp reconstruct` as it is typed, and with the backend of one process, turn by turn, each run a
process of its own. One line for each size and each way to ask: what was chosen, and the median of
the pairs' ratios, of wall time and of CPU time (all processes together).
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np
from big_cloud import write_cloud
from msgspec import convert
from process_usage import run

from hpcapp.applications.surface.job.settings import THREADS_FROM_POINTS
from hpccomponent.limits import available_cores

SIZES = (1_000, 10_000, 100_000, 1_000_000)
WAYS = ((), ("--workers", "2"))
ENTRY = "import sys; from hpcapp.__main__ import main; sys.exit(main())"


@dataclass(frozen=True, slots=True)
class _Choice:
    reason: str


@dataclass(frozen=True, slots=True)
class Job:
    """What a job's report says of where it ran."""

    backend: str
    workers: int
    choice: _Choice | None = None


@dataclass(frozen=True, slots=True)
class Run:
    """One process with its helpers; times in seconds."""

    wall_s: float
    cpu_s: float
    job: Job


@dataclass(frozen=True, slots=True)
class Pairs:
    """What pairs of runs come to: medians, and ratios of `auto` by one process."""

    points: int
    way: str
    backends: list[str]
    workers: list[int]
    wall_s: float
    cpu_s: float
    wall_ratio: float
    wall_ratios: tuple[float, float]
    cpu_ratio: float
    reason: str


def run_job(cloud: Path, grid: int, *options: str) -> Run:
    """Reconstruct a cloud with the command, in a process of its own."""
    mesh, log = cloud.with_name("mesh.ply"), cloud.with_name("log")
    words = ["reconstruct", str(cloud), "-o", str(mesh), "--grid", str(grid), "--json", *options]
    usage = run(str(log), [sys.executable, "-P", "-c", ENTRY, *words])
    if usage["exit_code"]:
        raise SystemExit(log.read_text())
    report = next(line for line in log.read_text().splitlines() if line.startswith("{"))
    return Run(usage["wall_s"], usage["cpu_s"], convert(json.loads(report), Job))


def local_backend(points: int) -> str:
    """Return the backend that one process has for so many points."""
    return "threads" if points >= THREADS_FROM_POINTS and available_cores() > 1 else "serial"


def compare_backends(cloud: Path, points: int, grid: int, way: Sequence[str], pairs: int) -> Pairs:
    """Run pairs of `auto` and one process, each first as often as the other."""
    ours: list[Run] = []
    theirs: list[Run] = []
    for number in range(pairs):
        both = [(ours, tuple(way)), (theirs, ("--backend", local_backend(points)))]
        for runs, options in both if number % 2 else reversed(both):
            runs.append(run_job(cloud, grid, *options))
    wall = [a.wall_s / b.wall_s for a, b in zip(ours, theirs, strict=True)]
    cpu = [a.cpu_s / b.cpu_s for a, b in zip(ours, theirs, strict=True)]
    choice = ours[-1].job.choice
    return Pairs(
        points,
        " ".join(way) or "(nothing)",
        sorted({one.job.backend for one in ours}),
        sorted({one.job.workers for one in ours}),
        median(one.wall_s for one in theirs),
        median(one.cpu_s for one in theirs),
        median(wall),
        (min(wall), max(wall)),
        median(cpu),
        "" if choice is None else choice.reason,
    )


def print_backends(sizes: Sequence[int], grid: int, pairs: int) -> None:
    """Print a line for each size and each way to ask."""
    with tempfile.TemporaryDirectory(prefix="alternatives-") as folder:
        print("load", np.round(os.getloadavg(), 1).tolist())
        for points in sizes:
            cloud = Path(folder, f"{points}.ply")
            write_cloud(cloud, points)
            for way in WAYS:
                row = compare_backends(cloud, points, grid, way, pairs)
                least, most = row.wall_ratios
                print(
                    f"{points:>9} {row.way:12} {'/'.join(row.backends)} x{row.workers} "
                    f"alone {row.wall_s:.2f} s, {row.cpu_s:.2f} CPU s; auto by alone: "
                    f"{row.wall_ratio:.3f} ({least:.2f} to {most:.2f}), CPU {row.cpu_ratio:.3f}",
                    flush=True,
                )
    print("load", np.round(os.getloadavg(), 1).tolist())


def main() -> None:
    """Compare, and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--grid", type=int, default=256)
    parser.add_argument("--pairs", type=int, default=10)
    asked = parser.parse_args()
    print_backends(asked.sizes, asked.grid, asked.pairs)


if __name__ == "__main__":
    main()
