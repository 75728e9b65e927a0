"""What it takes to bring a cloud to disk and to clean it there: ingest.py FILE FOLDER.

Prints a line for each step: seconds, those of the processor, the most memory so far, and what is in
the folder. FOLDER is made, and removed in the end.
"""

from __future__ import annotations

import argparse
import os
import resource
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from hpcapp.applications.surface.estimates import probe_noise, sample_groups
from hpcapp.applications.surface.ingest import ingest_file
from hpcapp.applications.surface.region_cleaning import REGION_POINTS, clean_regions
from hpcapp.backends import open_executor
from hpcapp.io import open_points
from hpccomponent.surface.arranged_cloud import ArrangedCloud
from hpccomponent.surface.spacing import estimate_group_spacing

Result = TypeVar("Result")
UNIT = 1 if sys.platform == "darwin" else 1024  # of ru_maxrss, in bytes


def measure_spacing(cloud: ArrangedCloud) -> float:
    """Return the spacing, group by group."""
    return estimate_group_spacing(
        lambda: (positions for positions, _ in cloud.groups(REGION_POINTS)),
        len(cloud),
        cloud.low,
        cloud.high,
    )


def measure_noise(cloud: ArrangedCloud, spacing: float) -> float:
    """Return the noise, by a sample of all groups."""
    groups = lambda: cloud.groups(REGION_POINTS)  # noqa: E731
    return probe_noise(sample_groups(groups, len(cloud), cloud.low, spacing), spacing)


def run(path: Path, folder: Path, workers: int) -> None:
    """Take each step once, and print what it took."""

    def take(step: str, work: Callable[[], Result]) -> Result:
        began, began_cpu = time.perf_counter(), time.process_time()
        result = work()
        took, cpu = time.perf_counter() - began, time.process_time() - began_cpu
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * UNIT / 1e6
        held = sum(f.stat().st_size for f in folder.rglob("*") if f.is_file()) / 1e6
        spent = f"{took:8.1f} s {cpu:8.1f} CPU s"
        print(f"{step:10}{spent} {peak:8.0f} MB at most {held:8.0f} MB on disk", flush=True)
        return result

    for name in ("arranged", "cleaned"):
        (folder / name).mkdir(parents=True)
    take("import", lambda: None)
    ingested = take("ingest", lambda: ingest_file(open_points(path), folder / "arranged"))
    backend_name = "threads" if workers > 1 else "serial"
    with open_executor(backend_name, workers=workers) as backend:
        cloud, cleaned = take(
            "clean", lambda: clean_regions(ingested.cloud, folder / "cleaned", backend.workforce)
        )
    shutil.rmtree(folder / "arranged")
    spacing = take("spacing", lambda: measure_spacing(cloud))
    noise = take("noise", lambda: measure_noise(cloud, spacing))
    print(f"{len(cloud)} points in {len(cloud.keys)} blocks, {ingested.dropped}, {cleaned}")
    print(f"spacing {spacing:.3g}, noise {noise:.3g}, {os.path.getsize(path) / 1e6:.0f} MB read")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--workers", type=int, default=1)
    asked = parser.parse_args()
    try:
        run(asked.file, asked.folder, asked.workers)
    finally:
        shutil.rmtree(asked.folder, ignore_errors=True)
