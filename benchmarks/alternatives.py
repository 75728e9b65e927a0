"""One job done in two ways, turn by turn, each run a process of its own.

::

    alternatives.py backend [--sizes N ...] [--pairs 10]
    alternatives.py place CLOUD [--rounds N] [RECONSTRUCT OPTIONS]

``backend``: is `auto` ever slower than this machine alone? `hpcapp reconstruct` as it is typed, and
with the backend of one process. One line for each size and each way to ask: what was chosen, and
the median of the pairs' ratios, of wall time and of CPU time (all processes together).

``place``: what does a folder cost in place of memory? Points in memory, and in a folder (in TMPDIR:
name a place in memory, such as /dev/shm); the least CPU time and memory of each, and the ratios.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median

import numpy as np
from big_cloud import write_cloud
from msgspec import convert
from process_usage import run

from hpcapp.applications.surface.job import plan
from hpcapp.applications.surface.job.settings import THREADS_FROM_POINTS
from hpccomponent.limits import available_cores

SIZES = (1_000, 10_000, 100_000, 1_000_000)
WAYS = ((), ("--workers", "2"))
ENTRY = "import sys; from hpcapp.__main__ import main; sys.exit(main())"
PLACES = ("memory", "folder")


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


def reconstruct(place: str, arguments: list[str]) -> int:
    """Run ``hpcapp`` in this process with its points in one place, whatever pays."""
    from hpcapp.__main__ import main as hpcapp

    vars(plan).update(
        fits_memory=lambda *_: place == "memory", _may_pay_in_folder=lambda *_: place == "folder"
    )
    sys.argv = ["hpcapp", "reconstruct", *arguments]
    return hpcapp()


def compare_places(cloud: Path, rounds: int, options: list[str]) -> dict[str, list[float]]:
    """Return the least CPU seconds and megabytes of each place; the meshes are the same."""
    usage: dict[str, list[tuple[float, float]]] = {place: [] for place in PLACES}
    meshes = set()
    with tempfile.TemporaryDirectory() as folder:
        mesh, log = Path(folder, "mesh.ply"), Path(folder, "log")
        for number in range(rounds):
            for place in PLACES if number % 2 == 0 else PLACES[::-1]:
                job = [sys.executable, __file__, "--place", place, str(cloud), "-o", str(mesh)]
                used = run(str(log), [*job, *options])
                text = log.read_text()
                if used["exit_code"] or ("points are put into" in text) != (place == "folder"):
                    raise SystemExit(text)
                usage[place].append((used["cpu_s"], used["rss_mb"]))
                meshes.add(mesh.read_bytes())
    if len(meshes) > 1:
        raise SystemExit("the meshes differ")
    return {place: [min(column) for column in zip(*rows, strict=True)]
            for place, rows in usage.items()}  # fmt: skip


def print_backends(sizes: Sequence[int], grid: int, pairs: int, target: Path | None) -> None:
    """Print a line for each size and each way to ask."""
    rows = []
    with tempfile.TemporaryDirectory(prefix="alternatives-") as folder:
        print("load", np.round(os.getloadavg(), 1).tolist())
        for points in sizes:
            cloud = Path(folder, f"{points}.ply")
            write_cloud(cloud, points)
            for way in WAYS:
                row = compare_backends(cloud, points, grid, way, pairs)
                rows.append(row)
                least, most = row.wall_ratios
                print(
                    f"{points:>9} {row.way:12} {'/'.join(row.backends)} x{row.workers} "
                    f"alone {row.wall_s:.2f} s, {row.cpu_s:.2f} CPU s; auto by alone: "
                    f"{row.wall_ratio:.3f} ({least:.2f} to {most:.2f}), CPU {row.cpu_ratio:.3f}",
                    flush=True,
                )
    print("load", np.round(os.getloadavg(), 1).tolist())
    if target:
        target.write_text(json.dumps([asdict(row) for row in rows], indent=1))


def print_places(cloud: Path, rounds: int, options: list[str]) -> None:
    """Print a line for each place, and the ratios."""
    best = compare_places(cloud, rounds, options)
    for place, (seconds, megabytes) in best.items():
        print(f"{place}: {seconds:.2f} CPU s, {megabytes:.0f} MB")
    time, memory = (b / a for a, b in zip(best["memory"], best["folder"], strict=True))
    print(f"folder over memory: CPU time {time:.2f}, memory {memory:.2f}")


def main() -> None:
    """Compare, and print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    commands = parser.add_subparsers(dest="what", required=True)
    backend = commands.add_parser("backend")
    backend.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    backend.add_argument("--grid", type=int, default=256)
    backend.add_argument("--pairs", type=int, default=10)
    backend.add_argument("--json", type=Path)
    place = commands.add_parser("place")
    place.add_argument("cloud", type=Path)
    place.add_argument("--rounds", type=int, default=5)
    place.add_argument("options", nargs=argparse.REMAINDER)
    asked = parser.parse_args()
    if asked.what == "backend":
        print_backends(asked.sizes, asked.grid, asked.pairs, asked.json)
    else:
        print_places(asked.cloud, asked.rounds, asked.options)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--place"]:
        sys.exit(reconstruct(sys.argv[2], sys.argv[3:]))
    main()
