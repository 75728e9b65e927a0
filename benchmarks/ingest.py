"""What it takes to bring a cloud to disk and to clean it there: ingest.py FILE FOLDER.

Prints a line for each step: seconds, those of the processor here and in the workers, the most
memory so far here, and what is in the folder. FOLDER is made, and removed in the end.
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

from hpcapp.applications.surface.cleaning.drive import drop_strays, mend_normals, thin_lines
from hpcapp.applications.surface.cloud.folder.folder_pass import FolderPass, make_cloud_folder
from hpcapp.applications.surface.cloud.measure import measure_cloud
from hpcapp.applications.surface.cloud.point_workers import PointWorkers
from hpcapp.applications.surface.methods.method import TILE_POINTS
from hpcapp.applications.surface.reading.drive import ingest_file
from hpcapp.applications.surface.resolution.estimates import choose_scale
from hpcapp.backends.selection import open_executor
from hpcapp.io import open_points

Result = TypeVar("Result")
UNIT = 1 if sys.platform == "darwin" else 1024  # of ru_maxrss, in bytes


def find_children() -> list[int]:
    """Return the processes below this one."""
    children: dict[int, list[int]] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue  # it has ended
        children.setdefault(int(fields[1]), []).append(int(stat.parent.name))
    found = [os.getpid()]
    for pid in found:
        found += children.get(pid, [])
    return found[1:]


def spend_elsewhere() -> float:
    """Return what the processes below this one have spent, in seconds."""
    total = 0.0
    for pid in find_children():
        try:
            fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            continue
        total += (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return total


def run(path: Path, folder: Path, backend_name: str, workers: int | None) -> None:
    """Take each step once, and print what it took."""
    totals = [0.0, 0.0, 0.0]

    def take(step: str, work: Callable[[], Result]) -> Result:
        began = time.perf_counter(), time.process_time(), spend_elsewhere()
        result = work()
        ended = time.perf_counter(), time.process_time(), spend_elsewhere()
        spent = [b - a for a, b in zip(began, ended, strict=True)]
        totals[:] = [a + b for a, b in zip(totals, spent, strict=True)]
        tell(step, spent)
        return result

    def tell(step: str, spent: list[float]) -> None:
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * UNIT / 1e6
        held = sum(f.stat().st_size for f in folder.rglob("*") if f.is_file()) / 1e6
        took = f"{spent[0]:8.2f} s {spent[1]:8.2f} CPU s {spent[2]:8.2f} in workers"
        print(f"{step:10}{took} {peak:8.0f} MB at most {held:8.0f} MB on disk", flush=True)

    arranged = make_cloud_folder(folder)
    with open_executor(backend_name, workers=workers) as backend:
        those = PointWorkers(backend.workforce, True, TILE_POINTS)
        source = open_points(path)
        ingested = take("ingest", lambda: ingest_file(source, arranged, those))
        read = FolderPass(ingested.cloud, folder, those)
        kept, _, scale = take("lines", lambda: thin_lines(read))
        kept, cleaned, scale = take("clean", lambda: drop_strays(kept, scale))
        kept, _ = take("mend", lambda: mend_normals(kept, scale.spacing))
        cloud = take("sample", lambda: measure_cloud(kept, scale)).cloud
        cells_of = take("noise", lambda: choose_scale(cloud.measured, 0.0, 1.0, 1.0))
        coarse = 16.0 * cells_of.cell_size
        cells, _ = take("cells", lambda: those.count_cells(cloud, cloud.low, coarse))
        tell("all", totals)
    print(f"{len(cloud)} points in {len(cloud.keys)} blocks, {ingested.dropped}, {cleaned}")
    print(f"{cells_of}, {len(cells)} cells, {os.path.getsize(path) / 1e6:.0f} MB read")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--backend", default="serial")
    parser.add_argument("--workers", type=int)
    asked = parser.parse_args()
    try:
        run(asked.file, asked.folder, asked.backend, asked.workers)
    finally:
        shutil.rmtree(asked.folder, ignore_errors=True)
