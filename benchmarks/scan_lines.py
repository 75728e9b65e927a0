#!/usr/bin/env python3
"""Show the two distributions that `scan_lines.SHARE` parts: even scans, and scans along lines.

    HPCAPP_DATA=DIR benchmarks/scan_lines.py

Of each scan of the folders `tuning`, `closeup`, `raw` and `lines`, the share of the points along
lines among those that are dense beside their gaps, cell by cell: as `keep_lines` compares it.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from hpcapp.applications.surface.cloud.arranged import arrange_cloud
from hpcapp.applications.surface.cloud.cloud_pass import MemoryPass
from hpcapp.applications.surface.cloud.measure import measure_lines
from hpcapp.applications.surface.reading.reach import drop_far
from hpcapp.applications.surface.scale.scan_lines import SHARE, count_narrow, keep_lines
from hpcapp.io import drop_unusable, open_points, read_whole

SHARES = np.arange(0.05, 1.0, 0.05)
GROUPS = {
    "even": ("tuning/scans/*.ply", "closeup/scans/*.ply", "raw/objects/*.ply"),
    "flown": ("raw/airborne/*.laz",),
    "rooms, with rings": ("raw/rooms/*.ply", "lines/lines/hall.ply", "lines/lines/yard_*.ply"),
    "lines, crossing": ("lines/lines/*profiles*.ply",),
    "lines": ("lines/lines/*contours_[12]*.ply", "lines/lines/s*_[124]*.ply"),
}


def measure(path: Path) -> np.ndarray:
    """Return how many of a scan's points are kept as lines at each of `SHARES`."""
    points, _ = drop_unusable(read_whole(open_points(path)), path.name)
    cloud_pass = MemoryPass(arrange_cloud(drop_far(points)))
    _, boxes = measure_lines(cloud_pass)
    positions = cloud_pass.cloud.points.positions
    counted = count_narrow(positions, boxes)
    held = dict(zip(counted.keys.tolist(), counted.points.tolist(), strict=True))
    kept = [keep_lines(boxes, [counted], share).keys for share in SHARES]
    return np.array([sum(held[key] for key in keys.tolist()) for keys in kept]) / len(positions)


def main() -> None:
    """Print, for each group, between which shares its points lie."""
    data = Path(os.environ["HPCAPP_DATA"])
    print(f"lines above {SHARE}; share of the points of a group that are lines above S")
    print(f"{'':20}{'scans':>6}" + "".join(f"{share:7.2f}" for share in SHARES))
    for group, patterns in GROUPS.items():
        paths = [path for pattern in patterns for path in sorted(data.glob(pattern))]
        found = np.mean([measure(path) for path in paths], axis=0)
        print(f"{group:20}{len(paths):6}" + "".join(f"{share:7.3f}" for share in found), flush=True)


if __name__ == "__main__":
    main()
