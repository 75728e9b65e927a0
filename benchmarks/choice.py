"""Is `auto` ever slower than this machine alone?  choice.py [--sizes N ...] [--pairs 10].

For each size of a cloud, pairs of whole processes, in turn: `hpcapp reconstruct` as it is typed,
and with the backend of one process. One line for each size and each way to ask: what was chosen,
and the median of the pairs' ratios, of wall time and of CPU time (all processes together).
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from big_cloud import write_cloud

from hpcapp.applications.surface.settings import THREADS_FROM_POINTS
from hpccomponent.limits import available_cores

SIZES = (1_000, 10_000, 100_000, 1_000_000)
WAYS = ((), ("--workers", "2"))
ENTRY = "import sys; from hpcapp.__main__ import main; sys.exit(main())"


@dataclass(frozen=True, slots=True)
class Run:
    """One process with its helpers.

    Parameters
    ----------
    wall_s, cpu_s : float
        In seconds.
    report : dict
        Of the job.
    """

    wall_s: float
    cpu_s: float
    report: dict[str, Any]


def run(cloud: Path, grid: int, *options: str) -> Run:
    """Reconstruct a cloud with the command, in a process of its own."""
    mesh = cloud.with_name("mesh.ply")
    words = ["reconstruct", str(cloud), "-o", str(mesh), "--grid", str(grid), "--json", *options]
    start = time.perf_counter()
    with subprocess.Popen(
        [sys.executable, "-P", "-c", ENTRY, *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    ) as process:
        assert process.stdout is not None
        told = process.stdout.read()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    wall_s = time.perf_counter() - start
    if process.returncode:
        raise SystemExit(f"hpcapp {' '.join(words)}: exit code {process.returncode}")
    return Run(wall_s, usage.ru_utime + usage.ru_stime, json.loads(told))


def local_backend(points: int) -> str:
    """Return the backend that one process has for so many points."""
    return "threads" if points >= THREADS_FROM_POINTS and available_cores() > 1 else "serial"


def compare(cloud: Path, points: int, grid: int, way: Sequence[str], pairs: int) -> dict[str, Any]:
    """Run pairs of `auto` and one process, each first as often as the other."""
    ours: list[Run] = []
    theirs: list[Run] = []
    for number in range(pairs):
        both = [(ours, tuple(way)), (theirs, ("--backend", local_backend(points)))]
        for found, options in both if number % 2 else reversed(both):
            found.append(run(cloud, grid, *options))
    wall = [a.wall_s / b.wall_s for a, b in zip(ours, theirs, strict=True)]
    cpu = [a.cpu_s / b.cpu_s for a, b in zip(ours, theirs, strict=True)]
    return {
        "points": points,
        "way": " ".join(way) or "(nothing)",
        "backends": sorted({one.report["backend"] for one in ours}),
        "workers": sorted({one.report["workers"] for one in ours}),
        "wall_s": median(one.wall_s for one in theirs),
        "cpu_s": median(one.cpu_s for one in theirs),
        "wall_ratio": median(wall),
        "wall_ratios": [min(wall), max(wall)],
        "cpu_ratio": median(cpu),
        "reason": ours[-1].report["choice"]["reason"],
    }


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=SIZES)
    parser.add_argument("--grid", type=int, default=256)
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="choice-") as room:
        folder = Path(room)
        print("load", np.round(os.getloadavg(), 1).tolist())
        rows = []
        for points in options.sizes:
            cloud = folder / f"{points}.ply"
            write_cloud(cloud, points)
            for way in WAYS:
                row = compare(cloud, points, options.grid, way, options.pairs)
                rows.append(row)
                least, most = row["wall_ratios"]
                print(
                    f"{points:>9} {row['way']:12} {'/'.join(row['backends'])} x{row['workers']} "
                    f"alone {row['wall_s']:.2f} s, {row['cpu_s']:.2f} CPU s; auto by alone: "
                    f"{row['wall_ratio']:.3f} ({least:.2f} to {most:.2f}), "
                    f"CPU {row['cpu_ratio']:.3f}",
                    flush=True,
                )
        print("load", np.round(os.getloadavg(), 1).tolist())
        if options.json:
            options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
