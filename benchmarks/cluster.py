"""Measure a cluster's life on the test bed: up, up again, a job, down, nothing left.

Run it as root, as ``python benchmarks/cluster.py [--points FILE] [--json FILE]``. All machines
share this one's cores: CPU seconds of the whole machine are published beside wall time, and so is
the load that others put on it before the start.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))

from testbed.cloud import TestBed
from testbed.sites import POINTS, Site, make_mesh, reason_to_skip
from testbed.wheels import pack_requirements_of

SMALL, LARGE = 3, 15  # workers, beside the head
ASKED_S = {"life of 4": 90.0, "up of 16": 180.0}


def busy_s() -> float:
    """Return the CPU seconds that this machine has spent since it booted."""
    with open("/proc/stat") as stat:
        user, nice, system, _idle, _wait, irq, softirq = map(int, stat.readline().split()[1:8])
    return (user + nice + system + irq + softirq) / os.sysconf("SC_CLK_TCK")


class Stopwatch:
    """Wall and CPU seconds by name."""

    def __init__(self) -> None:
        self.taken: dict[str, dict[str, float]] = {}

    def run(self, name: str, step: Callable[[], object]) -> None:
        """Measure one step, and print what it took."""
        wall, cpu = perf_counter(), busy_s()
        step()
        self.taken[name] = {"wall_s": perf_counter() - wall, "cpu_s": busy_s() - cpu}
        taken = self.taken[name]
        print(f"{name:24} {taken['wall_s']:7.1f} s wall {taken['cpu_s']:7.1f} s CPU", flush=True)


def measure_life(wheels: Path, workers: int, points: Path, watch: Stopwatch) -> None:
    """Measure one cluster from nothing to nothing."""
    size = workers + 1
    with tempfile.TemporaryDirectory() as name, TestBed(Path(name)) as bed:
        site = Site(bed, wheels)
        site.write(workers={"count": workers})
        watch.run(f"up of {size}", lambda: site.succeed("up", "-y"))
        calls = len(bed.cloud.calls)
        watch.run(f"up of {size}, again", lambda: site.succeed("up", "-y"))
        changing = [call.action for call in bed.cloud.calls[calls:] if call.changes]
        assert not changing, changing
        watch.run(f"job on {size}", lambda: site.succeed("submit", points, "-o", "mesh.ply"))
        mesh = (bed.home / "mesh.ply").read_bytes()
        watch.run(f"down of {size}", site.end)
        assert mesh == make_mesh(points, Path(name)), "not the local mesh"


def main() -> None:
    """Measure both clusters, and say what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--points", type=Path, default=POINTS)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    if reason := reason_to_skip():
        sys.exit(reason)
    load = os.getloadavg()[0]
    print(f"{os.cpu_count()} cores, load {load:.1f} before the start")
    watch = Stopwatch()
    with tempfile.TemporaryDirectory() as name:
        wheels = Path(name)
        pack_requirements_of("hpcapp", wheels)
        for workers in (SMALL, LARGE):
            measure_life(wheels, workers, asked.points.resolve(), watch)
    life = sum(watch.taken[f"{step} 4"]["wall_s"] for step in ("up of", "job on", "down of"))
    up = watch.taken["up of 16"]["wall_s"]
    for name, reached in (("life of 4", life), ("up of 16", up)):
        verdict = "reached" if reached < ASKED_S[name] else "missed"
        print(f"{name}: {reached:.1f} s, asked for {ASKED_S[name]:.0f}: {verdict}")
    if asked.json:
        asked.json.write_text(json.dumps({"load": load, "steps": watch.taken}, indent=2) + "\n")


if __name__ == "__main__":
    main()
