#!/usr/bin/env python3
"""Show what decides over sides and warnings: the distributions that each number parts.

    HPCAPP_DATA=DIR benchmarks/decisions.py [--only REGEX] [-o FOLDER]

Of each scan of the folders `tuning`, `raw`, `lines` and `cases`, what its readings cost but for how
rare they are, as `readings` weighs them (`decisions-sides.json`). Of each scan with right normals,
what `follows_place` sees of these, and of the same normals turned to +z, to a camera, and to a
place inside (`decisions-normals.json`). Of each closed mesh of `tuning` and `lines`, made without
normals, its handles, those of the truth, and the small ones that `handles` finds in boxes of half,
once and twice the edge (`decisions-handles.json`). `tests/benchmarks/test_decisions.py` holds the
margins.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
from pathlib import Path

import numpy as np

import hpcapp
from hpcapp.applications.surface.cleaning.drive import drop_strays, thin_lines
from hpcapp.applications.surface.cloud.arranged import arrange_cloud
from hpcapp.applications.surface.cloud.cloud_pass import MemoryPass
from hpcapp.applications.surface.cloud.measure import draw_boxes, measure_spacing
from hpcapp.applications.surface.normals.consistency import weigh_torn
from hpcapp.applications.surface.normals.estimation import estimate_normals
from hpcapp.applications.surface.normals.evidence import areas_of
from hpcapp.applications.surface.normals.linked import LinkedPatches
from hpcapp.applications.surface.normals.patches import CELL, Links, Patches, find_patches
from hpcapp.applications.surface.normals.readings import (
    HABIT,
    Followed,
    choose,
    find_readings,
    follow_reading,
    lies_level,
)
from hpcapp.applications.surface.reading.reach import drop_far
from hpcapp.applications.surface.stitching.handles import BOX, find_small_handles
from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.lattice import lay_lattice
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import drop_unusable, open_points, read_whole
from hpcapp.io.meshes.mesh_stream import as_stream

# A scan is of the first group that names it.
GROUPS = {
    "on a table": ("tuning/scans/*one_side.ply", "raw/objects/*table.ply", "raw/objects/motor.ply"),
    "room, tunnel": (
        "tuning/scans/room*.ply",
        "raw/rooms/f[lu]*.ply",
        "raw/rooms/[kn]*.ply",
        "cases/room*.xyz",
        "cases/tunnel*.xyz",
    ),
    "street, yard": ("lines/lines/s*.ply", "lines/lines/yard*.ply"),
    "whole": ("tuning/scans/*.ply", "raw/objects/*.ply"),
    "view, terrain": (
        "raw/airborne/[cht]*",
        "raw/airborne/flat*",
        "raw/airborne/powerline*",
        "raw/rooms/*.ply",
        "cases/s[lt]*.xyz",
        "cases/terrain_z_up.xyz",
        "cases/odm*",
    ),
}
Row = list[str | float]
KINDS = ("outside", "inside", "camera")  # all other readings are sides
SAME = 0.8  # share of the area on which two readings agree that say the same
SIDES = ["scan", "group", "outside", "inside", "stand", "name of the side", "side", "habit",
         "level", "turned", "camera", "right"]  # fmt: skip
NORMALS = ["scan", "signed", "following", "pairs", "torn"]
HANDLES = ["scan", "genus", "true genus", "in half", "in one", "in two"]


def group_points(path: Path) -> tuple[Patches, Links, float, FloatArray]:
    """Return the patches of a scan, their links, its spacing, and where it has (0, 0, 0)."""
    points, _ = drop_unusable(read_whole(open_points(path)), path.name)
    bare = PointCloud(points.positions, origin=points.origin)
    cloud_pass = MemoryPass(arrange_cloud(drop_far(bare)))
    cloud_pass, _, scale = thin_lines(cloud_pass)
    cloud_pass, _, scale = drop_strays(cloud_pass, scale)
    positions, low = cloud_pass.cloud.points.positions, cloud_pass.cloud.low
    every, spacing = np.ones(len(positions), np.bool_), scale.spacing
    corner = lay_lattice(low, spacing)
    vectors = estimate_normals(positions, every, corner, spacing)
    patches, links = find_patches(positions, vectors, every, corner, spacing)
    return patches, links, spacing, -cloud_pass.cloud.origin


def find_sides(path: Path, group: str) -> Row:
    """Return a row of what the readings of a scan cost."""
    patches, links, spacing, zero = group_points(path)
    linked = LinkedPatches(patches, links)
    readings = find_readings(patches, linked, spacing, zero)
    found = [follow_reading(patches, linked, some) for some in readings]
    habits = [followed.reading.habit for followed in found]
    believed = found[choose([followed.cost for followed in found], habits)]
    named = {one.reading.kind: one for one in found if one.reading.kind in KINDS}
    sides = sorted(
        (one for one in found if one.reading.kind not in KINDS),
        key=lambda followed: followed.cost + (followed.reading.habit or 0.0),
    )
    named["side"] = sides[0]
    turned = [other for other in sides if agree(patches, other, sides[0]) < 1.0 - SAME]
    if turned:
        named["turned"] = turned[0]
    right = [name for name, one in named.items() if agree(patches, one, believed) > SAME]
    stand = named["outside"].reading.rare
    costs = {name: round(one.cost - one.reading.rare, 4) for name, one in named.items()}
    return [
        path.stem,
        group,
        costs["outside"],
        costs.get("inside", ""),
        stand,
        sides[0].reading.kind,
        costs["side"],
        round((sides[0].reading.habit or 0.0) / HABIT, 3),
        float(lies_level(patches)),
        costs.get("turned", ""),
        costs.get("camera", ""),
        " ".join(right),
    ]


def agree(patches: Patches, one: Followed, other: Followed) -> float:
    """Return the share of the area on which two readings agree."""
    areas = areas_of(patches)
    return float(areas[one.sides * other.sides > 0.0].sum() / areas.sum())


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
    """Return a row of the handles of a closed mesh; none where it is open."""
    made = hpcapp.reconstruct(path, normals="estimate")
    mesh = Mesh(np.asarray(made.vertices, np.float64), np.asarray(made.faces, np.int64))
    found = check_mesh(mesh).genus
    if found is None:
        return []
    stream = as_stream(mesh)
    counts = [find_small_handles(stream, factor * BOX).count for factor in (0.5, 1.0, 2.0)]
    return [[path.stem, found, genus, *counts]]


def write(
    folder: Path,
    name: str,
    title: str,
    columns: list[str],
    rows: list[Row],
    script: str = "benchmarks/decisions.py",
) -> None:
    """Write a table."""
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False
    ).stdout.strip()
    table = {
        "title": title,
        "machine": "virtual machine, 2 cores, shared with other work",
        "commit": commit,
        "command": f"HPCAPP_DATA=DIR {script}",
        "columns": columns,
        "rows": rows,
        "notes": [],
    }
    (folder / f"{name}.json").write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")


def main() -> None:
    """Measure all scans, and write three tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default=".")
    parser.add_argument("-o", "--output", type=Path, default=Path("benchmarks/results"))
    asked = parser.parse_args()
    data = Path(os.environ["HPCAPP_DATA"])
    groups: dict[Path, str] = {}
    for group, patterns in GROUPS.items():
        for pattern in patterns:
            for path in sorted(data.glob(pattern)):
                groups.setdefault(path, group)
    sides, normals = [], []
    for path, group in groups.items():
        if re.search(asked.only, path.stem):
            sides.append(find_sides(path, group))
            print(sides[-1], flush=True)
    for path in sorted(data.glob("tuning/scans/*.ply")):
        if re.search(asked.only, path.stem):
            normals += find_torn(path)
            print(normals[-4:], flush=True)
    handles = []
    for path, genus in find_genera(data).items():
        if re.search(asked.only, path.stem):
            handles += find_handles(path, genus)
            print(handles[-1:], flush=True)
    title = "What readings cost: shares of the area seen from behind, and by none"
    write(asked.output, "decisions-sides", title, SIDES, sides)
    title = "Normals that follow a place: share that does, and opposite pairs across the sight"
    write(asked.output, "decisions-normals", title, NORMALS, normals)
    title = "Handles of closed meshes: all, those of the truth, and the small ones that are found"
    write(asked.output, "decisions-handles", title, HANDLES, handles)


if __name__ == "__main__":
    main()
