"""How many estimated normals are on the right side: normals.py SCANS [--only GLOB] [-o FILE].

SCANS is a folder of PLY files whose normals are right. They are thrown away, estimated and turned,
and compared with what was thrown away. With ``--peer`` Open3D does the same beside it.
"""

from __future__ import annotations

import argparse
import platform
import time
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
from tables import write_table

from hpcapp.applications.surface.cloud.arranged import arrange_cloud
from hpcapp.applications.surface.cloud.cloud_pass import MemoryPass
from hpcapp.applications.surface.cloud.measure import measure_spacing
from hpcapp.applications.surface.normals.drive import orient_normals
from hpcapp.applications.surface.normals.sensor import Sensor
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import open_points, read_whole

COLUMNS = ["scan", "points", "right, %", "sure, %", "right of the sure, %", "CPU s"]
PEER_COLUMNS = ["Open3D right, %", "Open3D CPU s"]
NEIGHBOURS = 20  # of Open3D's normals
SPANNED = 15  # neighbours along which Open3D turns them


def share_right(normals: FloatArray, truth: FloatArray) -> float:
    """Return the share of normals on the side of the true ones, in per cent."""
    return float(100.0 * np.mean(np.einsum("ij,ij->i", normals, truth) > 0.0))


def measure(path: Path, with_peer: bool) -> list[str | int | float]:
    """Throw the normals of a scan away, and return a row of the table."""
    arranged = arrange_cloud(read_whole(open_points(path)))
    scan = arranged.points
    if scan.normals is None:
        raise SystemExit(f"{path} has no normals to compare with")
    start = time.process_time()
    bare = MemoryPass(replace(arranged, points=PointCloud(scan.positions, origin=scan.origin)))
    given = measure_spacing(bare), Sensor()
    oriented, side, _ = orient_normals(bare, *given, keeps=False, attribute="confidence")
    spent = time.process_time() - start
    found = oriented.cloud.points
    assert found.normals is not None
    is_sure = found.attributes["confidence"] >= np.float32(0.3)
    row: list[str | int | float] = [
        path.stem,
        len(scan),
        round(share_right(found.normals, scan.normals), 2),
        round(100.0 * side.sure, 1),
        round(share_right(found.normals[is_sure], scan.normals[is_sure]), 2),
        round(spent, 2),
    ]
    return [*row, *(measure_peer(scan.positions, scan.normals) if with_peer else ())]


def measure_peer(positions: FloatArray, normals: FloatArray) -> list[float]:
    """Return what Open3D's normals come to."""
    import open3d

    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(positions))
    start = time.process_time()
    cloud.estimate_normals(open3d.geometry.KDTreeSearchParamKNN(NEIGHBOURS))
    cloud.orient_normals_consistent_tangent_plane(SPANNED)
    spent = time.process_time() - start
    right = share_right(
        np.asarray(cloud.normals), normals
    )  # as a whole it may be inside out: that is forgiven
    return [round(max(right, 100.0 - right), 2), round(spent, 2)]


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scans", type=Path)
    parser.add_argument("--only", default="*", metavar="GLOB")
    parser.add_argument("--peer", action="store_true", help="Open3D beside it")
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    rows = []
    for path in sorted(options.scans.glob("*.ply")):
        if fnmatch(path.stem, options.only):
            rows.append(measure(path, options.peer))
            print(*rows[-1], flush=True)
    if options.output is None:
        return
    write_table(
        options.output,
        "Normals estimated and oriented",
        COLUMNS + (PEER_COLUMNS if options.peer else []),
        rows,
        f"python benchmarks/normals.py SCANS --only '{options.only}'" + " --peer" * options.peer,
        ["Open3D's whole cloud may be inside out: that is forgiven."] * options.peer,
        f"{platform.machine()}, shared with other work",
    )


if __name__ == "__main__":
    main()
