#!/usr/bin/env python3
"""Show what decides over normals and warnings: the distributions that each number parts.

    HPCAPP_DATA=DIR benchmarks/decisions.py [--only REGEX] [-o FOLDER]

Of each scan with right normals, what `follows_place` sees of these, and of the same normals turned
to +z, to a camera, and to a place inside (`decisions-normals.json`). Of each closed mesh of
`tuning` and `lines`, made without normals, its handles, those of the truth, and those that are left
where small ones are cut, in boxes of half, once and twice the edge (`decisions-handles.json`).
`tests/benchmarks/test_decisions.py` holds the margins; what decides over readings is `readings.py`.
"""

from __future__ import annotations

import argparse
import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import numpy as np
from tables import Row, write_table

import hpcapp
from hpcapp.applications.surface.cloud.arranged import arrange_cloud
from hpcapp.applications.surface.cloud.cloud_pass import MemoryPass
from hpcapp.applications.surface.cloud.measure import draw_boxes, measure_spacing
from hpcapp.applications.surface.hierarchical import method
from hpcapp.applications.surface.normals.consistency import weigh_torn
from hpcapp.applications.surface.normals.patches import CELL
from hpcapp.applications.surface.stitching import handle_groups
from hpcapp.applications.surface.stitching.handle_groups import Mended, mend_handles
from hpcapp.applications.surface.stitching.handles import BOX
from hpcapp.applications.surface.stitching.surface import Surface
from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.lattice import lay_lattice
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import open_points, read_whole

NORMALS = ["scan", "signed", "following", "pairs", "torn"]
HANDLES = ["scan", "uncut", "true", "cut to half", "cut", "cut to twice"]


def find_torn(path: Path) -> list[Row]:
    """Return rows of what the normals of a scan look like, as they are and turned."""
    scan = arrange_cloud(read_whole(open_points(path))).points
    assert scan.normals is not None
    low, high = scan.positions.min(axis=0), scan.positions.max(axis=0)
    middle = scan.positions.mean(axis=0)
    camera = middle + 1.2 * float(np.linalg.norm(high - low)) * np.array([0.3, 0.5, -0.8])
    arms = {
        "as they are": scan.normals,
        "to +z": np.broadcast_to([0.0, 0.0, 1.0], scan.normals.shape),
        "to a camera": camera - scan.positions,
        "to the middle": middle - scan.positions,
    }
    rows: list[Row] = []
    for name, towards in arms.items():
        along = np.einsum("ij,ij->i", scan.normals, towards)
        signed = PointCloud(
            scan.positions, scan.normals * np.where(along < 0.0, -1.0, 1.0)[:, None]
        )
        cloud_pass = MemoryPass(arrange_cloud(signed))
        spacing = measure_spacing(cloud_pass)
        edge = CELL * spacing
        places, normals = draw_boxes(cloud_pass, edge, len(scan) // 20_000 + 1)
        corner = lay_lattice(cloud_pass.cloud.low, edge)
        told = weigh_torn(places, normals, corner, edge, spacing)
        rows.append([path.stem, name, round(told.following, 3), told.pairs, round(told.torn, 3)])
    return rows


def find_genera(data: Path) -> dict[Path, int]:
    """Return how many handles the truth of the scans has that show a closed object."""
    lines = json.loads((data / "lines/expected.json").read_text())
    tuning = json.loads((data / "tuning/manifest.json").read_text())["meshes"]
    genera = {
        data / "lines" / name: told["genus"] for name, told in lines.items() if "genus" in told
    }
    for path in sorted(data.glob("tuning/scans/*.ply")):
        mesh = tuning[path.stem.split("__")[0]]
        if mesh["watertight"] and not path.stem.endswith("one_side"):
            genera[path] = mesh["genus"]
    return {path: genus for path, genus in genera.items() if genus is not None}


def find_handles(path: Path, genus: int) -> list[Row]:
    """Return a row of what cutting the small handles leaves; none where the mesh is open."""
    kept: list[tuple[Surface, Callable[[FloatArray], FloatArray]]] = []

    def keep(
        surface: Surface, suited_steps: Callable[[FloatArray], FloatArray]
    ) -> tuple[Surface, Mended]:
        kept.append((surface, suited_steps))
        return surface, Mended()

    with mock.patch.object(method, "mend_handles", keep):
        made = hpcapp.reconstruct(path, normals="estimate")
    mesh = Mesh(np.asarray(made.vertices, np.float64), np.asarray(made.faces, np.int64))
    found = check_mesh(mesh).genus
    if found is None:
        return []
    left: list[float] = []
    for factor in (0.5, 1.0, 2.0):
        with mock.patch.object(handle_groups, "BOX", factor * BOX):
            left.append((mend_handles(*kept[0])[0].check().genus or 0) if kept else 0)
    return [[path.stem, found, genus, *left]]


def main() -> None:
    """Measure all scans, and write two tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default=".")
    parser.add_argument("-o", "--output", type=Path, default=Path("benchmarks/results"))
    asked = parser.parse_args()
    data = Path(os.environ["HPCAPP_DATA"])
    normals: list[Row] = []
    for path in sorted(data.glob("tuning/scans/*.ply")):
        if re.search(asked.only, path.stem):
            normals += find_torn(path)
            print(normals[-4:], flush=True)
    handles: list[Row] = []
    for path, genus in find_genera(data).items():
        if re.search(asked.only, path.stem):
            handles += find_handles(path, genus)
            print(handles[-1:], flush=True)
    title = "Normals that follow a place: share that does, and opposite pairs across the sight"
    command = "HPCAPP_DATA=DIR benchmarks/decisions.py"
    write_table(asked.output / "decisions-normals.json", title, NORMALS, normals, command)
    title = "Handles of closed meshes: before small ones are cut, in truth, and after"
    write_table(asked.output / "decisions-handles.json", title, HANDLES, handles, command)


if __name__ == "__main__":
    main()
