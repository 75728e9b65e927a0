#!/usr/bin/env python3
"""Show what decides: the distributions that a number parts, each with its table.

    HPCAPP_DATA=DIR benchmarks/decisions.py TABLE [--only REGEX] [-o FILE]

``normals`` (`TORN`): of each scan with right normals, what `follows_place` sees of these, and of
the same normals turned to +z, to a camera, and to a place inside.

``handles`` (`BOX`): of each closed mesh of `tuning` and `lines`, made without normals, its handles,
those of the truth, and those that are left where small ones are cut, in boxes of half, once and
twice the edge.

``pieces`` (`SMALL`): of each scan, how many pieces its mesh has; how many of them are parts that
were scanned as a whole (a room and its table, a ground and its roofs), as the scan's maker knows;
the area of the least of these and of the largest other piece, as shares of the area of the largest
piece; and how many are small by half of `SMALL`, by itself and by its double. Of scans that fall
into shreds of every size (leaves, pipes, water, one view) nobody can say what a part is: they have
a 0 there.

``lines`` (`SHARE`): of groups of scans, the share of the points along lines among those that are
dense beside their gaps, cell by cell, as `keep_lines` compares it, by the share that is asked for.

``registration`` (`AGREEING`): two stands see half of the points of a shape each, from directions
that are 40 degrees apart, and one is moved in a random direction by so many spacings; which share
of their cells agrees. A dash: they share too few cells to tell.

`tests/benchmarks/test_decisions.py` holds the margins; what decides over readings is `readings.py`.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import numpy as np
from tables import Row, parser_of, write_table

import hpcapp
from hpcapp.api.mesh import unwrap_mesh
from hpcapp.applications.surface.cloud.arranged import arrange_cloud
from hpcapp.applications.surface.cloud.cloud_pass import MemoryPass
from hpcapp.applications.surface.cloud.measure import draw_boxes, measure_lines, measure_spacing
from hpcapp.applications.surface.cloud.spacing import estimate_spacing
from hpcapp.applications.surface.hierarchical import method
from hpcapp.applications.surface.normals.consistency import weigh_torn
from hpcapp.applications.surface.normals.patches import CELL
from hpcapp.applications.surface.reading.reach import drop_far
from hpcapp.applications.surface.reading.registration import AGREEING, compare_scans
from hpcapp.applications.surface.scale.scan_lines import SHARE, count_narrow, keep_lines
from hpcapp.applications.surface.stitching import handle_groups
from hpcapp.applications.surface.stitching.handle_groups import Mended, mend_handles
from hpcapp.applications.surface.stitching.handles import BOX
from hpcapp.applications.surface.stitching.surface import Surface
from hpcapp.applications.surface.stitching.topology import check_mesh
from hpcapp.geometry.lattice import lay_lattice
from hpcapp.geometry.mesh import Mesh
from hpcapp.geometry.pieces import SMALL
from hpcapp.geometry.points import FloatArray, PointCloud
from hpcapp.io import drop_unusable, open_points, read_whole
from hpcapp.mending.pieces import measure_pieces

PARTS = {
    "raw/objects/two_near.ply": 2,  # two balls
    "raw/rooms/furnished_z_up.ply": 2,  # the room, the table
    "raw/rooms/kitchen.ply": 3,  # the room, the table, the recess of a window
    "raw/rooms/facade.ply": 3,  # the house, a balcony, a window
    "raw/rooms/no_ceiling.ply": 1,
    "cases/table_ball.xyz": 2,  # the table, the ball
    "raw/airborne/town.laz": 15,  # the ground, 14 roofs
    "raw/airborne/town_dense.laz": 5,  # the ground, 4 roofs
    "kinect_table.ply": 0,
    "real/las/lion_takanawa.copc.laz": 0,
    "real/ply/pond.0.ply": 0,
    "real/e57/pumpAVisualReferenceImage.e57": 0,
}
UNSURE = ("kitchen",)
"""Rooms whose side is unsure, which is not what the pieces are to show."""
SHARES = (0.05, 0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85)
GROUPS = {
    "even": ("tuning/scans/*.ply", "closeup/scans/*.ply", "raw/objects/*.ply"),
    "flown": ("raw/airborne/*.laz",),
    "rooms, with rings": ("raw/rooms/*.ply", "lines/lines/hall.ply", "lines/lines/yard_*.ply"),
    "lines, crossing": ("lines/lines/*profiles*.ply",),
    "lines": ("lines/lines/*contours_[12]*.ply", "lines/lines/s*_[124]*.ply"),
}
SHAPES = ("bust", "torus", "knot", "gear", "box")
NOISES = (0.0, 0.3)  # spacings
REGISTERED, MOVED = (0.0, 0.1, 0.3), (3.5, 5.0, 10.0, 20.0, 40.0)
STAND_POINTS = 100_000
APART = np.radians(40.0)
LEAST_COSINE = 0.1  # of a normal and the direction of a stand
Random = np.random.Generator


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


def find_pieces(path: Path, parts: int) -> Row:
    """Return the row of a scan."""
    viewpoints = "inside" if path.stem in UNSURE else None
    mesh = hpcapp.reconstruct(path, attributes="none", viewpoints=viewpoints)
    areas = np.sort(measure_pieces(unwrap_mesh(mesh))[1])[::-1]
    shares = areas / areas[0]
    least = float(f"{shares[parts - 1]:.3g}") if parts else ""
    shred = float(f"{shares[parts]:.3g}") if 0 < parts < len(shares) else ""
    counts = [int((shares < factor * SMALL).sum()) for factor in (0.5, 1.0, 2.0)]
    return [path.name.split(".")[0], len(shares), parts, least, shred, *counts]


def count_lines(path: Path) -> FloatArray:
    """Return how many of a scan's points are kept as lines at each of `SHARES`."""
    points, _ = drop_unusable(read_whole(open_points(path)), path.name)
    cloud_pass = MemoryPass(arrange_cloud(drop_far(points)))
    _, boxes = measure_lines(cloud_pass)
    positions = cloud_pass.cloud.points.positions
    counted = count_narrow(positions, boxes)
    held = dict(zip(counted.keys.tolist(), counted.points.tolist(), strict=True))
    kept = [keep_lines(boxes, [counted], share).keys for share in SHARES]
    counts = np.array([sum(held[key] for key in keys.tolist()) for keys in kept])
    shares: FloatArray = counts / len(positions)
    return shares


def see(shape: str, noise: float, random: Random) -> list[tuple[FloatArray, FloatArray]]:
    """Return the points that each stand sees, and their normals."""
    cloud = hpcapp.simulate(shape, points=STAND_POINTS, views=0, normals="exact", seed=1)
    assert cloud.normals is not None
    spacing = estimate_spacing(cloud.positions)
    stands = ([0.8, 0.0, 0.6], [0.8 * np.cos(APART), 0.8 * np.sin(APART), 0.6])
    turn = random.permutation(len(cloud)) % 2
    scans = []
    for number, stand in enumerate(stands):
        is_seen = (turn == number) & (cloud.normals @ stand > LEAST_COSINE)
        errors = random.normal(0.0, noise * spacing, (int(is_seen.sum()), 3))
        scans.append((cloud.positions[is_seen] + errors, cloud.normals[is_seen].astype(float)))
    return scans


def compare(scans: list[tuple[FloatArray, FloatArray]], shift: float, random: Random) -> str:
    """Return the share of agreeing cells of two scans, one moved by so many spacings."""
    (first, sides), (second, others) = scans
    spacing = max(estimate_spacing(first), estimate_spacing(second))
    arm = random.normal(size=3)
    moved = second + shift * spacing * arm / np.linalg.norm(arm)
    pairs = compare_scans({0: (first, sides), 1: (moved, others)})
    return f"{pairs[0].agreeing / pairs[0].cells:.2f} of {pairs[0].cells}" if pairs else "-"


@dataclass(frozen=True)
class Decision:
    """A table: its title and columns, and what yields its rows of scans that match."""

    title: str
    columns: tuple[str, ...]
    measure: Callable[[Path, re.Pattern[str]], Iterator[Row]]


def measure_normals(data: Path, only: re.Pattern[str]) -> Iterator[Row]:
    """Yield the rows of the scans with normals."""
    for path in sorted(data.glob("tuning/scans/*.ply")):
        if only.search(path.stem):
            yield from find_torn(path)


def measure_handles(data: Path, only: re.Pattern[str]) -> Iterator[Row]:
    """Yield the rows of the scans of closed objects."""
    for path, genus in find_genera(data).items():
        if only.search(path.stem):
            yield from find_handles(path, genus)


def measure_parts(data: Path, only: re.Pattern[str]) -> Iterator[Row]:
    """Yield the rows of the scans whose parts are known."""
    for name in filter(only.search, PARTS):
        yield find_pieces(data / name, PARTS[name])


def measure_groups(data: Path, only: re.Pattern[str]) -> Iterator[Row]:
    """Yield the rows of the groups of scans with and without lines."""
    for group in filter(only.search, GROUPS):
        paths = [path for pattern in GROUPS[group] for path in sorted(data.glob(pattern))]
        shares = np.mean([count_lines(path) for path in paths], axis=0)
        yield [group, len(paths), *shares.round(3).tolist()]


def measure_stands(data: Path, only: re.Pattern[str]) -> Iterator[Row]:  # noqa: ARG001
    """Yield the rows of the shapes that are seen from two stands."""
    random = np.random.default_rng(0)
    for shape in filter(only.search, SHAPES):
        for noise in NOISES:
            scans = see(shape, noise, random)
            yield [shape, noise, *(compare(scans, one, random) for one in REGISTERED + MOVED)]


DECISIONS = {
    "normals": Decision(
        "Normals that follow a place: share that does, and opposite pairs across the sight",
        ("scan", "signed", "following", "pairs", "torn"), measure_normals,
    ),
    "handles": Decision(
        "Handles of closed meshes: before small ones are cut, in truth, and after",
        ("scan", "uncut", "true", "cut to half", "cut", "cut to twice"), measure_handles,
    ),
    "pieces": Decision(
        "Pieces of meshes: their parts, and the shreds beside them, by area of the largest",
        ("scan", "pieces", "parts", "least part", "largest shred", "in half", "in one", "in two"),
        measure_parts,
    ),
    "lines": Decision(
        f"Points that are taken for lines, by the share that is asked for ({SHARE})",
        ("scans", "number", *map(str, SHARES)), measure_groups,
    ),
    "registration": Decision(
        f"Share of cells that agree, by spacings that a scan is off (registered: {AGREEING})",
        ("shape", "noise", *map(str, REGISTERED + MOVED)), measure_stands,
    ),
}  # fmt: skip


def main() -> None:
    """Measure, print and write one table."""
    parser = parser_of(__doc__)
    parser.add_argument("table", choices=DECISIONS)
    parser.add_argument("--only", type=re.compile, default=re.compile(""), metavar="REGEX")
    asked = parser.parse_args()
    decision, rows = DECISIONS[asked.table], list[Row]()
    for row in decision.measure(Path(os.environ.get("HPCAPP_DATA", "")), asked.only):
        rows.append(row)
        print(*row, flush=True)
    write_table(asked.output, decision.title, decision.columns, rows)


if __name__ == "__main__":
    main()
