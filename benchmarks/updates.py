#!/usr/bin/env python3
"""Show what a scan costs that is added to nineteen others, beside a job of all twenty.

    benchmarks/updates.py [--points N] [-o FILE] WORK

A town seen from the air is cut into 5 x 4 scans that overlap by a tenth of their width; each has
three quarters of the points that lie in it. WORK is a folder for the scans and the meshes; scans
that are there are taken. One amid the others is added by ``--update``, and a job that has the frame
and no tile meshes all of them anew: what it writes is compared byte for byte.
"""

from __future__ import annotations

import filecmp
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from tables import Row, parser_of, write_table

import hpcapp
from hpcapp.geometry.points import PointCloud
from hpcapp.io import write_points

ACROSS, ALONG = 5, 4
ADDED = 9  # of the twenty: it has neighbours on all sides
_OVERLAP = 0.1
_SHARE = 0.75
_HPCAPP = [sys.executable, "-m", "hpcapp"]


def make_scans(folder: Path, points: int) -> list[Path]:
    """Cut a town into scans, unless they are there."""
    paths = [folder / f"scan-{index:02d}.ply" for index in range(ACROSS * ALONG)]
    if all(path.exists() for path in paths):
        return paths
    town = folder / "town.laz"
    words = ["simulate", "--scene", "town", "--scanner", "airborne", "-n", str(points)]
    subprocess.run([*_HPCAPP, *words, "-o", str(town)], check=True)
    cloud = hpcapp.read_points(town)
    random = np.random.default_rng(1)
    low = cloud.positions.min(axis=0)[:2]
    side = (cloud.positions.max(axis=0)[:2] - low) / (ACROSS, ALONG)
    for index, path in enumerate(paths):
        corner = low + side * divmod(index, ALONG)
        away = np.abs(cloud.positions[:, :2] - corner - 0.5 * side)
        inside = (away <= (0.5 + _OVERLAP) * side).all(axis=1)
        kept = inside & (random.random(len(inside)) < _SHARE)
        write_points(path, PointCloud(cloud.positions[kept], origin=cloud.origin))
    return paths


def run(scans: list[Path], mesh: Path, place: Path) -> dict[str, Any]:
    """Run a job; return its report, with the seconds that it took."""
    shutil.rmtree(mesh, ignore_errors=True)
    words = [str(path) for path in scans]
    # One process: what workers take is not told of those that are ended.
    where = ["-o", str(mesh), "--update", str(place), "--backend", "serial", "--json"]
    command = [*_HPCAPP, "reconstruct", *words, *where]
    before, began = os.times(), time.perf_counter()
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    wall, after = time.perf_counter() - began, os.times()
    cpu = sum(getattr(after, f"children_{one}") - getattr(before, f"children_{one}")
              for one in ("user", "system"))  # fmt: skip
    report: dict[str, Any] = json.loads(done.stdout)
    return {**report, "cpu": cpu, "wall": wall}


def are_same(one: Path, other: Path) -> bool:
    """Tell whether two folders hold the same files, byte for byte."""
    names = sorted(path.name for path in one.iterdir())
    if names != sorted(path.name for path in other.iterdir()):
        return False
    return filecmp.cmpfiles(one, other, names, shallow=False)[0] == names


def main() -> None:
    """Measure, and write the table."""
    parser = parser_of(__doc__)
    parser.add_argument("work", type=Path)
    parser.add_argument("--points", type=int, default=1_400_000)
    asked = parser.parse_args()
    asked.work.mkdir(parents=True, exist_ok=True)
    scans = make_scans(asked.work, asked.points)
    old = [path for index, path in enumerate(scans) if index != ADDED]
    place, fresh = asked.work / "place", asked.work / "fresh"
    for folder in (place, fresh):
        shutil.rmtree(folder, ignore_errors=True)
    run(old, asked.work / "old.tiles", place)
    fresh.mkdir(mode=0o700)
    shutil.copytree(place / "frames", fresh / "frames")
    now = [scans[ADDED], *old]
    made, updated = asked.work / "fresh.tiles", asked.work / "updated.tiles"
    anew, added = run(now, made, fresh), run(now, updated, place)

    def row(name: str, one: float, other: float) -> Row:
        return [name, f"{one:.1f}", f"{other:.1f}", f"{other / one:.2f}"]

    rows = [row(f"{name}, s", anew["stages"][name], spent)
            for name, spent in added["stages"].items() if anew["stages"][name] >= 0.5]  # fmt: skip
    rows += [row("wall, s", anew["wall"], added["wall"]), row("CPU, s", anew["cpu"], added["cpu"])]
    rows.append(["tiles", anew["tiles"], added["tiles"] - added["tiles_taken"], ""])
    same = "the same, byte for byte" if are_same(made, updated) else "NOT THE SAME"
    write_table(
        asked.output,
        "One scan added to nineteen: all anew, and with --update",
        ["", "anew", "updated", "share"],
        rows,
        [
            f"{anew['points']:,} points, {added['faces']:,} faces; the scan has a fourteenth of "
            "the area, with what it shares with its neighbours.",
            f"Both meshes: {same}.",
        ],
    )


if __name__ == "__main__":
    main()
